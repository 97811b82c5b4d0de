"""Adjusts the values of a config to a different image size; the checks of the config refuse invalid values later."""

from collections.abc import Callable
from typing import Any

from semisynth_gl.config.explain import config_keys
from semisynth_gl.config.fields import Range, is_number, range_to_yaml
from semisynth_gl.config.layers import Values, merged

# Keys that end in _px are in pixels of a pattern or a patch in these sections, and elsewhere in pixels of an image.
_OTHER_PIXELS = {"projector", "textures"}
_TEXELS = "texels_per_pixel"
_SIDES = ("width_px", "height_px", "raw_width_px", "raw_height_px")
_POINTS = {"cx_left_px": "width_px", "cx_right_px": "width_px", "cy_px": "height_px"}

# Returns the new value of a number, given the keys around the number, such as ("camera", "focal_px").
Change = Callable[[tuple[str, ...], float], float]


def recentred(below: Values, above: Values) -> Values:
    """Return the values ``below`` with principal points moved to fit the image size that ``above`` states.

    ``above`` will be merged over ``below``. A new size crops or extends images around their middle, so a principal
    point keeps its distance from the middle. Principal points that ``above`` states are not moved.
    """
    before, stated = below.get("camera"), above.get("camera")
    if not (isinstance(before, dict) and isinstance(stated, dict)):
        return below

    def moved(keys: tuple[str, ...], at: float) -> float:
        side = _POINTS.get(keys[-1])
        old, new = before.get(side), stated.get(side)
        is_replaced = keys[0] == "camera" and keys[-1] in stated
        if "camera" in keys and not is_replaced and is_number(old) and is_number(new) and old != new:
            return (new - 1) / 2 + (at - (old - 1) / 2)
        return at

    return dict(_changed(below, moved))


def scaled(values: Values, factor: float) -> Values:
    """Return a config's values for the same images with ``factor`` times as many pixels per side.

    Defaults in pixels are scaled too, so the result states them.
    """

    def at_scale(keys: tuple[str, ...], value: float) -> float:
        key = keys[-1]
        if key == _TEXELS:
            return value / factor
        if not key.endswith("_px") or _OTHER_PIXELS.intersection(keys):
            return value
        if key in _SIDES:
            return max(round(value * factor), 1)
        # Principal points are measured from the centre of the first pixel, half a pixel inside the image's border.
        border = 0.5 if key in (*_POINTS, "cx_px") else 0.0
        return (value + border) * factor - border

    defaults: Values = {}
    for dotted, field in config_keys().items():
        section, _, key = dotted.rpartition(".")
        if isinstance(field.default, Range) and (key.endswith("_px") or key == _TEXELS):
            defaults.setdefault(section, {})[key] = range_to_yaml(field.default)
    return dict(_changed(merged(defaults, values), at_scale))


def _changed(value: Any, change: Change, keys: tuple[str, ...] = ()) -> Any:  # noqa: ANN401 - any YAML value
    """Return a value with all numbers inside it changed; ``keys`` are the keys around it."""
    if isinstance(value, dict):
        return {name: _changed(each, change, (*keys, name)) for name, each in value.items()}
    if isinstance(value, list):
        return [_changed(each, change, keys) for each in value]
    return change(keys, value) if is_number(value) else value
