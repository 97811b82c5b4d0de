"""The recipes of a calibrated config, which depend only on the wanted disparities and the kind of scenes."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from semisynth_gl.calibration.disparity_range import DisparityRange
from semisynth_gl.scene.rig import BEYOND_NEAR

# Number of particles in scenes that mostly show other objects. With two to six, views were either empty or full.
_FLOATING = [12, 40]
# Ends of ranges of disparity, as quantiles of the wanted distribution: of these particles, of walls, of panels.
_NEAR = (0.4, 0.98)
_ROOM_ENDS = (0.1, 0.4)
_PANELS = (0.1, 0.8)
# Where still things must be able to come as near as this quantile of the wanted distribution.
_STILL_UP_TO = 0.9
# Sides of panels, as fractions of the image's width.
_PANEL_OF_WIDTH = (0.3, 1.0)


@dataclass(frozen=True, slots=True)
class SceneRecipe:
    """A recipe of the mix.

    ``meaning`` says what its scenes show, for a comment; ``keys`` are the keys that it changes, by section.
    """

    name: str
    meaning: str
    keys: Mapping[str, Mapping[str, Any]]


def suitable_recipes(
    disparity: DisparityRange, width_px: int, doffs_px: float = 0.0, *, outdoors: bool
) -> tuple[SceneRecipe, ...]:
    """Return the recipes that suit a place.

    Recipes of furnished, open and still scenes state their particles as layers, since their walls, ground and panels
    already lie at the wanted disparities. Where the range is so narrow that walls cannot reach these, there are no such
    recipes. The last two recipes, of which the last is clutter, are solved for the part of the wanted distribution that
    the other recipes leave.

    Args:
        disparity: the wanted disparities, px.
        width_px: width of the config's images.
        doffs_px: the rig's cx_right - cx_left.
        outdoors: whether the place is outdoors.
    """
    # Rounded as in the written config, so that ranges lie within its limits.
    least, most = (float(f"{limit:.10g}") for limit in (disparity.min_px, disparity.max_px))

    def between(shares: tuple[float, float]) -> list[float]:
        ends = (float(f"{disparity.target.quantile(share):.3g}") for share in shares)
        return [min(max(end, least), most) for end in ends]

    floating_things: dict[str, Any] = {"layers": [{"disparity_px": between(_NEAR), "count": _FLOATING}]}
    panels: dict[str, Any] = {
        "panels": [3, 6],
        "panel_disparity_px": between(_PANELS),
        "panel_size_px": [float(round(share * width_px)) for share in _PANEL_OF_WIDTH],
        "panel_slant_deg": [0, 45],
    }
    # Walls and panels keep a distance from the near plane.
    reached = (most + doffs_px) / BEYOND_NEAR - doffs_px >= disparity.target.quantile(_STILL_UP_TO)
    recipes = list[SceneRecipe]()

    def add(name: str, meaning: str, background: Mapping[str, Any], **keys: Any) -> None:  # noqa: ANN401 - of sections
        keys = {"background": {"cuboid": 0, "plane": 0, **background}, **keys, "particles": floating_things}
        recipes.append(SceneRecipe(name, meaning, keys))

    if reached and not outdoors:
        room = {"room": 1, "wall_disparity_px": between(_ROOM_ENDS)}
        add("room", "furnished rooms", room)
        add("bare-room", "rooms with little in them", room, room={"furniture": [0, 3], "small": [2, 10]})
        add("still", "walls and panels, and little before them", {"cuboid": 1}, structures=panels)
    if reached and outdoors:
        add("street", "open scenes along a road", {"street": 1})
        ground = {"ground": 1, **panels}
        add("still-outdoors", "ground and panels, and little before them", {"plane": 1}, structures=ground)
    recipes.append(SceneRecipe("sparse", "fewer and larger floating things", {"particles": {"density": "sparse"}}))
    recipes.append(SceneRecipe("clutter", "many floating things", {}))
    return tuple(recipes)
