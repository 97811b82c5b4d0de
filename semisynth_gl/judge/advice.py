"""The table of changes: which keys of a config raise or lower which measures.

The report takes its advice from this table, and `calibrate` sets each key by the measures that the key moves.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from semisynth_gl.judge.measures import MEASURES, Measure

_BUSY = ("jumps", "occluded")
_CALM = ("runs",)
_SHARP = ("octaves", "gradient")
_KINDS = ("cuboid", "plane", "room", "street")


@dataclass(frozen=True, slots=True)
class Change:
    """A key of the config, and the measures that it moves.

    Attributes:
        key: section and name, such as ``room.small``.
        up: keys of each `Measure` that rises with the key's value.
        down: keys of each `Measure` that falls when the key's value rises.
        kinds: kinds of background, by their keys in the section ``background``: the key counts only in scenes that may
            have one of them; empty for all scenes.
        more: advice for a larger value, where "raise KEY" is not possible.
        less: advice for a smaller value, where "lower KEY" is not possible.
        optional: whether the key is a section that a config may lack: only who lacks it can add it, and only who has it
            can leave it out.
    """

    key: str
    up: tuple[str, ...] = ()
    down: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    more: str = ""
    less: str = ""
    optional: bool = False


CHANGES: tuple[Change, ...] = (
    Change(
        "scenes",
        up=(*_BUSY, *_SHARP),
        down=(*_CALM, "flat"),
        more="in scenes, give more weight to recipes with many objects",
        less="in scenes, give more weight to recipes with few objects",
    ),
    Change("background.room", up=(*_CALM, "flat"), down=(*_BUSY, *_SHARP), kinds=("room",)),
    Change("background.street", up=(*_CALM, "flat", "slant"), down=(*_BUSY, *_SHARP), kinds=("street",)),
    Change("room.furniture", up=(*_BUSY, *_SHARP), down=_CALM, kinds=("room",)),
    Change("room.small", up=(*_BUSY, *_SHARP), down=(*_CALM, "flat"), kinds=("room",)),
    Change("room.pillars", up=("occluded", "disparity", "largest_disparity"), down=_CALM, kinds=("room",)),
    Change("street.tall", up=_BUSY, down=_CALM, kinds=("street",)),
    Change("street.low", up=_BUSY, down=_CALM, kinds=("street",)),
    Change("street.vehicles", up=("occluded", "disparity"), down=("slant",), kinds=("street",)),
    Change("street.houses", up=_CALM, down=_BUSY, kinds=("street",)),
    Change("particles.density", up=(*_BUSY, *_SHARP), down=(*_CALM, "flat")),
    Change("models.complex", up=(*_BUSY, *_SHARP), down=(*_CALM, "flat")),
    Change("particles.size_px", up=(*_CALM, "flat"), down=(*_BUSY, *_SHARP)),
    Change("particles.thinness", down=("jumps", "slant")),
    Change("structures.panels", up=_CALM, down=("jumps", "slant"), kinds=("cuboid", "plane")),
    Change("structures.panel_slant_deg", up=("slant",), kinds=("cuboid", "plane")),
    Change("disparity.target", up=("disparity", "largest_disparity")),
    Change("disparity.max_px", up=("largest_disparity",)),
    Change(
        "antialias",
        down=("border_hardness", "octaves", "gradient"),
        more="antialias: edges",
        less="antialias: none",
    ),
    Change("imperfections.blur_px", down=("border_hardness", "octaves", "gradient")),
    Change("textures.texels_per_pixel", up=("gradient",), down=("flat",)),
    Change("textures.min_texture", up=("gradient",), down=("flat",)),
    Change("imperfections.exposure_stops", up=("luminance", "contrast", "gradient"), down=("flat",)),
    Change("imperfections.gamma", down=("luminance",)),
    Change(
        "lens",
        optional=True,
        up=("border",),
        more="add lens, which calibrate writes from cameras before rectification",
        less="take photographs that are rectified as lens says, or rectify with a smaller alpha",
    ),
    Change(
        "lens",
        optional=True,
        down=("corners",),
        more="add lens, which calibrate writes from cameras before rectification",
        less="leave lens out, or lower camera.focal_px",
    ),
)
"""All changes, in order of effect, the largest first."""


def moved_by(*keys: str) -> tuple[Measure, ...]:
    """Return the measures that any of the keys moves, in the order of `MEASURES`."""
    moved = {each for change in CHANGES if change.key in keys for each in (*change.up, *change.down)}
    return tuple(measure for measure in MEASURES if measure.key in moved)


def advice(measure: Measure, recipes: Sequence[Mapping[str, Any]], *, more: bool) -> str:
    """Return what to change in a config for a larger or smaller value of a measure; "" where no key moves it.

    Keys that have no effect in the scenes of any recipe are not named, nor are settings that the config already has.

    Args:
        measure: the measure to move.
        recipes: the config of each recipe, in JSON's types; at least one.
        more: True for a larger value, False for a smaller one.
    """
    changes = [change for change in CHANGES if _counts(change, recipes)]
    raised = [
        each for each in changes if measure.key in (each.up if more else each.down) and _can(each, recipes, rise=True)
    ]
    lowered = [
        each for each in changes if measure.key in (each.down if more else each.up) and _can(each, recipes, rise=False)
    ]
    in_force = {f"{key}: {value}" for key, value in recipes[0].items() if isinstance(value, str)}
    said = [text for text in (*(each.more for each in raised), *(each.less for each in lowered)) if text]
    said = [text for text in said if text not in in_force]
    for verb, changes in (("raise", raised), ("lower", lowered)):
        keys = [each.key for each in changes if not each.more]
        if keys:
            said.append(f"{verb} {_either(keys)}")
    return "; ".join(said)


def _can(change: Change, recipes: Sequence[Mapping[str, Any]], *, rise: bool) -> bool:
    """Return whether a key can get a larger value, or a smaller one."""
    return not change.optional or rise == all(values.get(change.key) is None for values in recipes)


def _counts(change: Change, recipes: Sequence[Mapping[str, Any]]) -> bool:
    """Return whether a key has an effect in the scenes of any recipe."""
    if change.key == "scenes":
        return len(recipes) > 1
    return any(_counts_in(change, values) for values in recipes)


def _counts_in(change: Change, values: Mapping[str, Any]) -> bool:
    section, _, key = change.key.rpartition(".")
    weights, particles = values.get("background", {}), values.get("particles", {})
    kinds = {kind for kind in _KINDS if weights.get(kind, 0) > 0}
    if change.kinds and not kinds.intersection(change.kinds):
        return False
    if section == "background":
        return len(kinds) > 1  # the only weight above 0 is 1, whatever its value
    if change.key == "particles.density":
        return particles.get("layers") is None
    if change.key == "particles.size_px":
        return particles.get("size_m") is None
    if key == "panel_slant_deg":
        return values.get("structures", {}).get("panels", 0) not in (0, [0, 0])
    return True


def _either(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
