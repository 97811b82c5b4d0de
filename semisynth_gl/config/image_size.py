"""Another size of images than a config was written for: what becomes of its other keys.

`recentred` is for a size that an override or an extending config states: the images are a part of those before, or
reach beyond them. `scaled` is for another resolution of the same images. What is no number, or none that a config may
have, is left as it is, for the config's checks to refuse.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, TypeGuard

from semisynth_gl.config.fields import LARGEST, Range, is_number
from semisynth_gl.config.model import Config

Values = dict[str, Any]

# The sections whose keys count pixels of an image; other sections count pixels of patches.
_OF_IMAGES = ("camera", "disparity", "background", "structures", "particles", "imperfections")
_TEXELS = "texels_per_pixel"
_SIDES = ("width_px", "height_px")
_POINTS = {"cx_left_px": "width_px", "cx_right_px": "width_px", "cy_px": "height_px"}


def recentred(below: Values, above: Values) -> Values:
    """Return the values of a config with its principal points in images of the size that goes over it.

    A point keeps its distance from the image's middle; where the focal length changes too, so does the distance.

    Args:
        below: of the config, in YAML's types.
        above: what goes over it; may have another ``camera.width_px`` or ``height_px``. Points that it states stay.
    """
    before, stated = below.get("camera"), above.get("camera")
    if not (isinstance(before, dict) and isinstance(stated, dict)):
        return below
    after = {**before, **stated}
    focal_px, new_focal_px = _focal_px(before), _focal_px(after)
    growth = new_focal_px / focal_px if focal_px and new_focal_px else 1.0
    moves: dict[str, Callable[[float], float]] = {}
    for point, side in _POINTS.items():
        old, new = before.get(side), after.get(side)
        if _is_possible(old) and _is_possible(new) and old != new and point not in stated:
            moves[point] = partial(_beside_middle, old, new, growth)

    def moved(camera: Values) -> Values:
        return {key: _mapped(value, moves[key]) if key in moves else value for key, value in camera.items()}

    return _with_sections(below, {"camera": moved}) if moves else below


def _beside_middle(old_side: float, new_side: float, growth: float, at: float) -> float:
    return (new_side - 1) / 2 + growth * (at - (old_side - 1) / 2)


def scaled(values: Values, factor: float) -> Values:
    """Return the values of a config whose images are so many times as wide and high, and show the same scenes.

    Args:
        values: of a config, in YAML's types; the result states the defaults that are in pixels, too.
        factor: how many times.
    """

    def with_defaults(name: str) -> Values:
        fields = getattr(Config.model_fields[name].annotation, "model_fields", {})
        ranges = {key: field.default for key, field in fields.items() if isinstance(field.default, Range)}
        stated = {key: [each.low, each.high] for key, each in ranges.items() if key.endswith("_px") or key == _TEXELS}
        given = values.get(name, {})
        return {name: {**stated, **given}} if isinstance(given, dict) and stated else {}

    def of_images(section: Values) -> Values:
        return {key: _scaled(key, value, factor) for key, value in section.items()}

    def of_textures(section: Values) -> Values:
        return section | {_TEXELS: _mapped(section[_TEXELS], lambda x: x / factor)} if _TEXELS in section else section

    full = dict(values)
    for name in (*_OF_IMAGES, "textures"):
        full |= with_defaults(name)
    return _with_sections(full, dict.fromkeys(_OF_IMAGES, of_images) | {"textures": of_textures})


def _with_sections(values: Values, changes: Mapping[str, Callable[[Values], Values]]) -> Values:
    """Return the values with some sections changed, in recipes too."""

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
    # The centre of the first pixel is at 0, and the image's border half a pixel before it.
    border = 0.5 if key in _POINTS else 0.0
    return _mapped(value, lambda x: (x + border) * factor - border)


def _focal_px(camera: Values) -> float | None:
    """Return the middle of the focal lengths; None where something of it is missing or no number."""
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
