"""The recipes that a calibrated config mixes, from the wanted disparities and the kind of scenes alone."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from semisynth_gl.calibration.disparity_range import DisparityRange

_FLOATING = [12, 40]
"""Floating things of scenes that are mostly something else. With two to six, pairs were either empty or heaps."""
_NEAR = (0.4, 0.98)
"""Where these are: the nearer part of the disparities."""
_ROOM_ENDS = (0.1, 0.4)
_PANELS = (0.1, 0.8)
_PANEL_OF_WIDTH = (0.3, 1.0)
_SLANT_DEG = [0, 45]


@dataclass(frozen=True, slots=True)
class SceneRecipe:
    """A recipe of the mix.

    Attributes:
        name: its name.
        meaning: what its scenes show, for the comment beside it.
        keys: the keys that it changes, by section.
    """

    name: str
    meaning: str
    keys: Mapping[str, Mapping[str, Any]]


def suitable_recipes(scenes: Sequence[str], disparity: DisparityRange, width_px: int) -> tuple[SceneRecipe, ...]:
    """Return the recipes that suit a place.

    Those of furnished, open and still scenes state their floating things: walls, ground and panels stand where the
    wanted disparities are. The two of floating things are solved for what the others leave of the wanted distribution.

    Args:
        scenes: "indoor", "outdoor" or both.
        disparity: the wanted disparities.
        width_px: width of the images.
    """
    # As the config states them.
    least, most = (float(f"{limit:.10g}") for limit in (disparity.min_px, disparity.max_px))

    def between(shares: tuple[float, float]) -> list[float]:
        ends = (float(f"{disparity.target.quantile(share):.3g}") for share in shares)
        return [min(max(end, least), most) for end in ends]

    floating_things = {"layers": [{"disparity_px": between(_NEAR), "count": _FLOATING}]}
    panels = {
        "panels": [3, 6],
        "panel_disparity_px": between(_PANELS),
        "panel_size_px": [float(round(share * width_px)) for share in _PANEL_OF_WIDTH],
        "panel_slant_deg": _SLANT_DEG,
    }
    floating = {"indoor": ("cuboid", {}), "outdoor": ("plane", {"ground": 1})}
    empty = {"cuboid": 0, "plane": 0}
    recipes = list[SceneRecipe]()
    if "indoor" in scenes:
        room = empty | {"room": 1, "wall_disparity_px": between(_ROOM_ENDS)}
        recipes += [
            SceneRecipe("room", "furnished rooms", {"background": room, "particles": floating_things}),
            SceneRecipe(
                "bare-room",
                "rooms with little in them",
                {"background": room, "room": {"furniture": [0, 3], "small": [2, 10]}, "particles": floating_things},
            ),
        ]
    if "outdoor" in scenes:
        street = empty | {"street": 1}
        recipes += [
            SceneRecipe("street", "open scenes along a road", {"background": street, "particles": floating_things}),
        ]
    for kind in scenes:
        background, structures = floating[kind]
        name = "still" if kind == "indoor" else "still-outdoors"
        recipes.append(
            SceneRecipe(
                name,
                f"{'walls' if kind == 'indoor' else 'ground'} and panels, and little before them",
                {
                    "background": empty | {background: 1},
                    "structures": structures | panels,
                    "particles": floating_things,
                },
            )
        )
    recipes += [
        SceneRecipe("sparse", "fewer and larger floating things", {"particles": {"density": "sparse"}}),
        SceneRecipe("clutter", "many floating things", {}),
    ]
    return tuple(recipes)
