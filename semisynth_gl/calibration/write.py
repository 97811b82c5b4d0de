"""A draft as a config: its values as a mapping, and as YAML with comments."""

import math
import sys
import textwrap
from collections.abc import Mapping
from io import StringIO
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.scalarstring import DoubleQuotedScalarString

from semisynth_gl.calibration.disparity_range import farthest_px
from semisynth_gl.calibration.draft import Draft
from semisynth_gl.config import Config
from semisynth_gl.config.load import overridden, parse_values
from semisynth_gl.config.scene_sections import BackgroundSection
from semisynth_gl.frame.raw_camera import vector_of
from semisynth_gl.inputs.errors import InputError, abbreviate
from semisynth_gl.textures.image_files import printable

# Columns of the comments and of the values, and the column of comments beside values.
_WIDTH, _LONGEST_LINE, _BESIDE = 100, 120, 28
# Ratios of fy to fx nearer to 1 are rounding.
_SQUARE = 1e-6
# Diameters of particles as fractions of the image's width, as in the packaged configs: 60 and 420 px of 1500.
_SMALLEST_OF_WIDTH, _LARGEST_OF_WIDTH = 0.04, 0.28
# Back walls have the disparities of this farthest share of the wanted pixels. Particles can hide a wall that is too
# far, but not one that is too near.
_WALL_UP_TO = 0.05
# Ends of the far plane's disparities, as fractions of the way from the farthest possible disparity to min_px.
_PLANE_OF_MIN = (0.1, 0.7)
_SOURCES_SHOWN = 5
# Comments beside keys, by section and key.
_COMMENTS: dict[tuple[str, ...], str] = {
    ("camera", "fy_over_fx"): "fy / fx",
    ("camera", "doffs_px"): "cx of the right camera minus cx of the left one",
    ("camera", "colour"): "as all photographs are",
    ("disparity", "signed"): "0 and below are disparities",
    ("disparity", "max_px"): "hard limit: sets the near plane",
    ("background", "wall_disparity_px"): "the back wall: the farthest 5% of the pixels",
    ("background", "wall_turn_deg"): "more would spread a wall over several bins of the target",
    ("background", "plane_disparity_px"): "the far plane: between infinity and min_px",
    ("particles", "size_px"): "in proportion to the width, as in the packaged configs",
    ("textures", "large_px"): "the largest squares of photographs, whole, where a patch would repeat",
    ("imperfections", "blur_px"): "as soft as the photographs are",
}


def make_config(draft: Draft) -> Config:
    """Return the draft's config; raises InputError where its numbers make no valid one."""
    try:
        return parse_values(config_values(draft), f"{draft.name}.yaml", draft.overrides)
    except InputError as error:
        raise InputError(f"the numbers make no valid config:\n{error}") from None


def write(draft: Draft) -> str:
    """Return the draft's config as YAML with comments."""
    values = overridden(config_values(draft), draft.overrides)
    yaml, stream = YAML(), StringIO()
    # Escaped names may not be folded: ruamel.yaml adds spaces to some.
    yaml.width = _LONGEST_LINE if all(map(str.isprintable, draft.images)) else sys.maxsize
    yaml.indent(mapping=2, sequence=4, offset=2)
    meanings: dict[tuple[str, ...], str] = {
        ("scenes", recipe.name, "recipe"): recipe.meaning for recipe in draft.style.recipes
    }
    tree = _node(values, (), _COMMENTS | meanings)
    tree.yaml_set_start_comment(_wrapped(f"{draft.name}: written by semisynth-gl calibrate."))
    above = {
        "camera": f"From {abbreviate([*dict.fromkeys(rig.source for rig in draft.rigs)], _SOURCES_SHOWN)}.",
        "lens": "The cameras before rectification: images get their borders and softness.",
        "disparity": draft.disparity.origin,
        "scenes": draft.style.mix_origin,
        "textures": f"Photographs: {draft.photographs} when this was written. {draft.style.look_origin}",
    }
    for name in values:
        if name != "name":
            tree.yaml_set_comment_before_after_key(name, before=f"\n{_wrapped(above.get(name, ''))}")
    yaml.dump(tree, stream)
    return stream.getvalue()


def config_values(draft: Draft) -> dict[str, Any]:
    """Return the values of a draft's config, before the user's overrides: sections and keys in the YAML's order."""
    style, disparity, ranges, width_px = draft.style, draft.disparity, draft.ranges, draft.size.width_px
    fy_over_fx = sum(ranges.pop("fy_over_fx")) / 2
    smallest, largest = (round(part * width_px) for part in (_SMALLEST_OF_WIDTH, _LARGEST_OF_WIDTH))
    turn_deg = _turn_deg(draft)
    values = {
        "name": draft.name,
        "camera": {
            "width_px": width_px,
            "height_px": draft.size.height_px,
            **ranges,
            "fy_over_fx": fy_over_fx if abs(fy_over_fx - 1) > _SQUARE else None,
            "colour": "grey" if draft.grey else None,
        },
        **_lens(draft),
        "disparity": {
            "signed": disparity.signed or None,
            "min_px": disparity.min_px,
            "max_px": disparity.max_px,
            "target": {
                "form": "histogram",
                "bin_px": disparity.bin_px,
                "first_px": float(disparity.target.edges_px[0]),
                "shares": [round(max(float(share), 0.0), 4) for share in disparity.target.shares],
            },
        },
        "background": {"cuboid": 0, "plane": 1, "plane_disparity_px": _plane_px(draft)}
        if draft.outdoors
        else {
            "cuboid": 1,
            "plane": 0,
            "wall_disparity_px": _wall_px(draft),
            "wall_turn_deg": turn_deg if turn_deg < BackgroundSection().wall_turn_deg else None,
        },
        "particles": {"size_px": (max(smallest, 1), max(largest, 2))},
        "scenes": [
            {"recipe": recipe.name, "weight": weight, **recipe.keys}
            for recipe, weight in zip(style.recipes, style.weights, strict=True)
        ],
        "textures": {
            "texels_per_pixel": style.texels_per_pixel,
            "large_px": draft.large_px,
            "source": "images",
            "images": list(draft.images),
        },
        "imperfections": {"blur_px": style.blur_px},
    }
    made: dict[str, Any] = _rounded(values)
    return made


def _lens(draft: Draft) -> dict[str, Any]:
    if not draft.lenses:
        return {}
    eyes: dict[str, Any] = {
        eye: {
            **{key: getattr(chain.raw, key) for key in ("fx_px", "fy_px", "cx_px", "cy_px")},
            "distortion": list(chain.raw.distortion),
            "rotation_deg": [math.degrees(each) for each in vector_of(chain.raw.rotation)],
        }
        for eye, chain in draft.lenses.items()
    }
    raw = draft.lenses["left"].raw
    lens = {"model": raw.model, "raw_width_px": raw.width_px, "raw_height_px": raw.height_px, **eyes}
    return {"lens": lens, "outputs": ["visibility", "valid"]}


def _wall_px(draft: Draft) -> tuple[float, float]:
    disparity = draft.disparity
    deep_px = float(f"{disparity.target.quantile(_WALL_UP_TO) - disparity.min_px:.2g}")
    return disparity.min_px, disparity.min_px + deep_px


def _turn_deg(draft: Draft) -> float:
    """Return the turn, degrees, at which a wall's disparities at the image's side and middle differ by one bin.

    For a wall of disparity d turned by a, d + doffs becomes (d + doffs) (1 + tan(a) x / f) at x px from the middle.
    """
    disparity, ranges = draft.disparity, draft.ranges
    steepest = draft.size.width_px / 2 / ranges["focal_px"][0]
    far_px = max(disparity.min_px + draft.doffs_px, disparity.bin_px)
    return float(f"{math.degrees(math.atan(disparity.bin_px / far_px / steepest)):.2g}")


def _plane_px(draft: Draft) -> tuple[float, float]:
    """Return the far plane's range of disparity, below min_px and above that of infinity for the least doffs."""
    min_px = draft.disparity.min_px
    farthest = farthest_px(draft.ranges["doffs_px"][0], signed=draft.disparity.signed)
    low, high = (farthest + float(f"{part * (min_px - farthest):.2g}") for part in _PLANE_OF_MIN)
    return low, high


def _rounded(value: Any) -> Any:  # noqa: ANN401 - any value of a config
    """Return a value without keys that are None, with numbers of ten digits, and ranges of equal ends as numbers."""
    # Ten digits are enough for any calibration, and leave out the rounding errors of binary numbers.
    match value:
        case bool() | int() | str():
            return value
        case float():
            rounded = float(f"{value:.10g}") + 0.0
            return int(rounded) if rounded.is_integer() else rounded
        case (low, high) if isinstance(value, tuple) and low == high:
            return _rounded(low)
        case Mapping():
            return {key: _rounded(each) for key, each in value.items() if each is not None}
        case _:
            return [_rounded(each) for each in value]


def _node(value: Any, key: tuple[str, ...], comments: Mapping[tuple[str, ...], str]) -> Any:  # noqa: ANN401 - any value
    """Return a value as ruamel.yaml writes it with comments: recipes' sections and lists of numbers on one line."""
    if isinstance(value, Mapping):
        tree = CommentedMap({name: _node(each, (*key, str(name)), comments) for name, each in value.items()})
        if key[:1] == ("scenes",) and len(key) > 2:
            tree.fa.set_flow_style()
        for name in value:
            if text := comments.get((*key, str(name))):
                tree.yaml_add_eol_comment(text, name, column=_BESIDE)
        return tree
    if isinstance(value, list):
        names = (str(each.get("recipe")) if isinstance(each, Mapping) else "" for each in value)
        items = CommentedSeq(_node(each, (*key, name), comments) for each, name in zip(value, names, strict=True))
        if not any(isinstance(each, str | Mapping) for each in value) or key == ("outputs",):
            items.fa.set_flow_style()
        return items
    # Plain, a line break of Unicode in a file's name would be read as a space.
    return DoubleQuotedScalarString(value) if isinstance(value, str) and not value.isprintable() else value


def _wrapped(text: str) -> str:
    """Return a comment in lines of the YAML's width, without letters that cannot be printed."""
    return textwrap.fill(printable(text), _WIDTH - 2, break_long_words=False, break_on_hyphens=False)
