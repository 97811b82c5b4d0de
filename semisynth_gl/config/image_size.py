"""How a config's other keys change with the size of its images.

Invalid values are passed on unchanged, for the config's checks to refuse.
"""

from collections.abc import Callable
from typing import Any

from semisynth_gl.config.fields import Range, is_number, written_range
from semisynth_gl.config.layers import Values
from semisynth_gl.config.model import Config

# The sections whose keys ending in _px are in pixels of an image; other sections state pixels of patches.
_OF_IMAGES = ("camera", "disparity", "background", "structures", "particles", "rig", "lens", "imperfections")
_TEXELS = "texels_per_pixel"
_SIDES = ("width_px", "height_px", "raw_width_px", "raw_height_px")
_POINTS = {"cx_left_px": "width_px", "cx_right_px": "width_px", "cy_px": "height_px"}

# What becomes of a value, by the name of its section and its key.
Change = Callable[[str, str, float], float]


def recentred(below: Values, above: Values) -> Values:
    """Return the values ``below`` with principal points moved to fit the image size that ``above`` states.

    ``above`` holds the values that will be merged over ``below``. Images of another size are cropped or extended about
    their middle, so a principal point keeps its distance from the middle; the distance grows with the focal length
    where ``above`` changes that too. Principal points that ``above`` states itself are not moved.
    """
    before, stated = below.get("camera"), above.get("camera")
    if not (isinstance(before, dict) and isinstance(stated, dict)):
        return below
    after = {**before, **stated}
    focal_px, new_focal_px = _focal_px(before), _focal_px(after)
    growth = new_focal_px / focal_px if focal_px and new_focal_px else 1.0

    def beside_middle(section: str, key: str, at: float) -> float:
        old, new = (sides.get(_POINTS.get(key, "")) for sides in (before, after))
        if section == "camera" and is_number(old) and is_number(new) and old != new and key not in stated:
            return (new - 1) / 2 + growth * (at - (old - 1) / 2)
        return at

    return _with_recipes(below, beside_middle)


def scaled(values: Values, factor: float) -> Values:
    """Return a config's values for the same images at another resolution, ``factor`` times as many pixels per side.

    Ranges in pixels that are left at their defaults are scaled too, and so are written out in the result.
    """

    def at_scale(section: str, key: str, value: float) -> float:
        if key == _TEXELS:
            return value / factor
        if section not in _OF_IMAGES or not key.endswith("_px"):
            return value
        if key in _SIDES:
            return max(round(value * factor), 1)
        # Principal points count from the first pixel's centre, and the image's border lies half a pixel before that.
        border = 0.5 if key in (*_POINTS, "cx_px") else 0.0
        return (value + border) * factor - border

    full = dict(values)
    for name in (*_OF_IMAGES, "textures"):
        fields = getattr(Config.model_fields[name].annotation, "model_fields", {})
        ranges = {key: field.default for key, field in fields.items() if isinstance(field.default, Range)}
        stated = {key: written_range(each) for key, each in ranges.items() if key.endswith("_px") or key == _TEXELS}
        given = values.get(name, {})
        if isinstance(given, dict) and stated:
            full[name] = stated | given
    return _with_recipes(full, at_scale)


def _with_recipes(values: Values, change: Change) -> Values:
    """Return the values with all numbers of their sections changed, in recipes too."""
    changed = {name: _changed(name, "", each, change) for name, each in values.items()}
    if isinstance(recipes := values.get("scenes"), list):
        changed["scenes"] = [_with_recipes(each, change) if isinstance(each, dict) else each for each in recipes]
    return changed


def _changed(section: str, key: str, value: Any, change: Change) -> Any:  # noqa: ANN401 - any YAML value
    """Return a value with all numbers in it changed; ``key`` is the nearest key above them."""
    if isinstance(value, dict):
        return {name: _changed(section, name, each, change) for name, each in value.items()}
    if isinstance(value, list):
        return [_changed(section, key, each, change) for each in value]
    return change(section, key, value) if is_number(value) else value


def _focal_px(camera: Values) -> float | None:
    """Return the middle of the range of focal lengths; None where it cannot be computed."""
    focal = _middle(camera.get("focal_px"))
    if focal is not None:
        return focal
    focal_mm, sensor_mm, width = (_middle(camera.get(key)) for key in ("focal_mm", "sensor_width_mm", "width_px"))
    return focal_mm / sensor_mm * width if focal_mm and sensor_mm and width else None


def _middle(value: Any) -> float | None:  # noqa: ANN401 - any YAML value
    ends = value if isinstance(value, list) else [value]
    return sum(ends) / len(ends) if ends and all(map(is_number, ends)) else None
