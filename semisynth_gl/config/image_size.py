"""How a config's other keys change with the size of its images.

Invalid values are passed on unchanged, for the config's checks to refuse.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, TypeGuard

from semisynth_gl.config.fields import LARGEST, Range, is_number
from semisynth_gl.config.layers import Values
from semisynth_gl.config.model import Config

# The sections whose keys ending in _px are in pixels of an image; other sections state pixels of patches.
_OF_IMAGES = ("camera", "disparity", "background", "structures", "particles", "rig", "lens", "imperfections")
_TEXELS = "texels_per_pixel"
_SIDES = ("width_px", "height_px", "raw_width_px", "raw_height_px")
_POINTS = {"cx_left_px": "width_px", "cx_right_px": "width_px", "cy_px": "height_px"}
_OF_POINTS = {*_POINTS, "cx_px"}


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

    def moved(camera: Values) -> Values:
        return {key: _mapped(value, partial(beside_middle, key)) for key, value in camera.items()}

    def beside_middle(key: str, at: float) -> float:
        old, new = (sides.get(_POINTS.get(key, "")) for sides in (before, after))
        if _is_possible(old) and _is_possible(new) and old != new and key not in stated:
            return (new - 1) / 2 + growth * (at - (old - 1) / 2)
        return at

    return _with_sections(below, {"camera": moved})


def scaled(values: Values, factor: float) -> Values:
    """Return a config's values for the same images at another resolution, ``factor`` times as many pixels per side.

    Ranges in pixels that are left at their defaults are scaled too, and so are written out in the result.
    """

    def of_images(section: Values) -> Values:
        return {key: _scaled(key, value, factor) for key, value in section.items()}

    def of_textures(section: Values) -> Values:
        return section | {_TEXELS: _mapped(section[_TEXELS], lambda x: x / factor)} if _TEXELS in section else section

    full = dict(values)
    for name in (*_OF_IMAGES, "textures"):
        fields = getattr(Config.model_fields[name].annotation, "model_fields", {})
        ranges = {key: field.default for key, field in fields.items() if isinstance(field.default, Range)}
        stated = {key: [each.low, each.high] for key, each in ranges.items() if key.endswith("_px") or key == _TEXELS}
        given = values.get(name, {})
        if isinstance(given, dict) and stated:
            full[name] = stated | given
    return _with_sections(full, dict.fromkeys(_OF_IMAGES, of_images) | {"textures": of_textures})


def _with_sections(values: Values, changes: Mapping[str, Callable[[Values], Values]]) -> Values:
    """Return the values with the functions ``changes`` applied to their sections, in recipes too."""

    def changed(sections: Values) -> Values:
        return {
            key: changes[key](value) if key in changes and isinstance(value, dict) else value
            for key, value in sections.items()
        }

    recipes = values.get("scenes")
    if not isinstance(recipes, list):
        return changed(values)
    return changed(values) | {"scenes": [changed(each) if isinstance(each, dict) else each for each in recipes]}


def _scaled(key: str, value: Any, factor: float) -> Any:  # noqa: ANN401 - any YAML value
    if isinstance(value, dict):
        return {below: _scaled(below, child, factor) for below, child in value.items()}
    if not key.endswith("_px"):
        return [_scaled(key, child, factor) for child in value] if isinstance(value, list) else value
    if key in _SIDES:
        return _mapped(value, lambda x: max(round(x * factor), 1))
    # Principal points count from the first pixel's centre, and the image's border lies half a pixel before that.
    border = 0.5 if key in _OF_POINTS else 0.0
    return _mapped(value, lambda x: (x + border) * factor - border)


def _focal_px(camera: Values) -> float | None:
    """Return the middle of the range of focal lengths; None where it cannot be computed."""
    focal = _middle(camera.get("focal_px"))
    if focal is not None:
        return focal
    focal_mm, sensor_mm, width = (_middle(camera.get(key)) for key in ("focal_mm", "sensor_width_mm", "width_px"))
    return focal_mm / sensor_mm * width if focal_mm and sensor_mm and width else None


def _middle(value: Any) -> float | None:  # noqa: ANN401 - any YAML value
    ends = value if isinstance(value, list) else [value]
    return sum(ends) / len(ends) if ends and all(map(_is_possible, ends)) else None


def _mapped(value: Any, function: Callable[[float], float]) -> Any:  # noqa: ANN401 - any YAML value
    if isinstance(value, list):
        return [_mapped(end, function) for end in value]
    return function(value) if _is_possible(value) else value


def _is_possible(value: object) -> TypeGuard[float]:
    """Return whether a value is a number that a config may have."""
    return is_number(value) and -LARGEST <= value <= LARGEST
