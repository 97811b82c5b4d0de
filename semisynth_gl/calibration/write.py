"""A draft as a config: its values as a mapping, and as YAML with comments that say where they come from."""

import math
import sys
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from io import StringIO
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.scalarstring import DoubleQuotedScalarString

from semisynth_gl.calibration.disparity_range import farthest_px
from semisynth_gl.calibration.draft import Draft
from semisynth_gl.calibration.rig import Rig
from semisynth_gl.config import Config
from semisynth_gl.config.load import overridden, parse_values
from semisynth_gl.config.scene_sections import BackgroundSection, TexturesSection
from semisynth_gl.frame.raw_camera import vector_of
from semisynth_gl.inputs.errors import InputError, abbreviate
from semisynth_gl.layouts import find_layout
from semisynth_gl.textures.image_files import printable

# Columns of the comments and of the values.
_WIDTH, _LONGEST_LINE = 100, 120
# Column of comments beside values.
_BESIDE = 28
# Diameters of particles as fractions of the image's width, as in the packaged configs: 60 and 420 px of 1500.
_SMALLEST_OF_WIDTH, _LARGEST_OF_WIDTH = 0.04, 0.28
# Back walls have the disparities of this farthest share of the wanted pixels. Particles can hide a wall that is too
# far, but not one that is too near.
_WALL_UP_TO = 0.05
# Ends of the far plane's disparities, as fractions of the way from the farthest possible disparity to min_px.
_PLANE_OF_MIN = (0.1, 0.7)
_SOURCES_SHOWN = 5

Key = tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ConfigValues:
    """A config's values, and comments by key.

    Attributes:
        values: sections and their keys, in the order of the YAML.
        above: comments above keys.
        beside: comments beside keys.
    """

    values: dict[str, Any] = field(default_factory=dict)
    above: dict[str, str] = field(default_factory=dict)
    beside: dict[Key, str] = field(default_factory=dict)

    def section(self, name: str, values: Mapping[str, Any], above: str = "", **beside: str) -> None:
        """Add a section with its keys that are not None, a comment above it, and comments beside its keys."""
        self.values[name] = {key: _rounded(value) for key, value in values.items() if value is not None}
        self.above[name] = above
        self.beside.update({(name, key): text for key, text in beside.items()})


def make_config(draft: Draft) -> Config:
    """Return the draft's config; raises InputError where its numbers make no valid one."""
    try:
        return parse_values(config_values(draft).values, f"{draft.name}.yaml", draft.overrides)
    except InputError as error:
        raise InputError(f"the numbers make no valid config:\n{error}") from None


def write(draft: Draft) -> str:
    """Return the draft's config as YAML with comments."""
    written = config_values(draft)
    values = overridden(written.values, draft.overrides)
    yaml, stream = YAML(), StringIO()
    # Escaped names may not be folded: ruamel.yaml adds spaces to some.
    yaml.width = _LONGEST_LINE if all(map(str.isprintable, draft.images)) else sys.maxsize
    yaml.indent(mapping=2, sequence=4, offset=2)
    tree = _node(values, (), written.beside)
    tree.yaml_set_start_comment(_wrapped(f"{draft.name}: written by semisynth-gl calibrate."))
    for name in values:
        if name != "name":
            above = written.above.get(name, "")
            tree.yaml_set_comment_before_after_key(name, before=f"\n{_wrapped(above)}" if above else "\n")
    yaml.dump(tree, stream)
    return stream.getvalue()


def config_values(draft: Draft) -> ConfigValues:
    """Return the values of a draft's config, before the user's overrides, with comments."""
    made, style = ConfigValues(), draft.style
    made.values["name"] = draft.name
    if draft.layout is not None:
        made.values["layout"] = draft.layout
        made.beside["layout",] = "as the calibration's; without, the number of pairs decides"
    _camera(made, draft)
    rectification = draft.rectification
    if rectification and rectification.ranges:
        made.section("rig", rectification.ranges, rectification.origin)
    _lens(made, draft)
    _disparity(made, draft)
    _background(made, draft)
    size_px = (round(part * draft.size.width_px) for part in (_SMALLEST_OF_WIDTH, _LARGEST_OF_WIDTH))
    smallest, largest = size_px
    in_proportion = f"In proportion to the width of {draft.size.width_px} px, as in the packaged configs."
    made.section("particles", {"size_px": (max(smallest, 1), max(largest, 2))}, in_proportion)
    parts = zip(style.recipes, style.weights, strict=True)
    made.values["scenes"] = [
        {"recipe": recipe.name, "weight": _rounded(weight), **_rounded(recipe.keys)} for recipe, weight in parts
    ]
    made.above["scenes"] = style.mix_origin
    made.beside.update({("scenes", str(k), "recipe"): each.meaning for k, each in enumerate(style.recipes)})
    made.section(
        "textures",
        {
            "texels_per_pixel": style.texels_per_pixel,
            "patch_px": draft.patch_px if draft.patch_px != TexturesSection().patch_px else None,
            "large_px": draft.large_px,
            "source": "images",
            "images": list(draft.images),
        },
        f"Photographs: {draft.photographs} when this was written. {style.look_origin}",
        patch_px="half of the photographs have no larger squares",
        large_px="the largest squares of photographs, whole, where a patch would repeat",
    )
    made.section(
        "imperfections",
        {"blur_px": style.blur_px},
        "As soft as the photographs are, see textures.",
    )
    return made


def suited_layout(config: Config, rigs: Sequence[Rig]) -> str | None:
    """Return the name of the layout of the benchmark that all rigs come from; None if they come from several or none.

    Returns None too where the layout cannot hold the config's disparities.
    """
    name, *others = {rig.layout for rig in rigs}
    if name is None or others:
        return None
    layout = find_layout(name)
    codec = layout.encodings_for(config).disparity
    holds = config.disparity.max_px <= codec.limit_px and (codec.signed or not config.disparity.signed)
    return name if holds else None


def _camera(made: ConfigValues, draft: Draft) -> None:
    ranges = draft.ranges
    made.section(
        "camera",
        {
            "width_px": draft.size.width_px,
            "height_px": draft.size.height_px,
            **{key: ends for key, ends in ranges.items() if key != "fy_over_fx"},
            "fy_over_fx": None if draft.square else draft.fy_over_fx,
            "colour": "grey" if draft.grey else None,
        },
        _camera_origin(draft),
        fy_over_fx="fy / fx",
        doffs_px="cx of the right camera minus cx of the left one",
        colour="as all photographs are",
    )


def _lens(made: ConfigValues, draft: Draft) -> None:
    if not draft.lenses:
        return
    eyes: dict[str, Any] = {
        eye: {
            **{key: getattr(chain.raw, key) for key in ("fx_px", "fy_px", "cx_px", "cy_px")},
            "distortion": chain.raw.distortion,
            "rotation_deg": [math.degrees(each) for each in vector_of(chain.raw.rotation)],
        }
        for eye, chain in draft.lenses.items()
    }
    raw = draft.lenses["left"].raw
    sizes = {"raw_width_px": raw.width_px, "raw_height_px": raw.height_px}
    origin = "The cameras before rectification, from the same calibration: images get their borders and softness."
    made.section("lens", {"model": raw.model, **sizes, **eyes}, origin)
    made.values["outputs"] = ["visibility", "valid"]


def _disparity(made: ConfigValues, draft: Draft) -> None:
    disparity = draft.disparity
    target = {
        "form": "histogram",
        "bin_px": disparity.bin_px,
        "first_px": float(disparity.target.edges_px[0]),
        "shares": [round(max(float(share), 0.0), 4) for share in disparity.target.shares],
    }
    made.section(
        "disparity",
        {
            "signed": disparity.signed or None,
            "min_px": disparity.min_px,
            "max_px": disparity.max_px,
            "target": target,
        },
        disparity.origin,
        signed="0 and below are disparities",
        max_px="hard limit: sets the near plane",
        target=f"mean {disparity.target.mean_px:.2f} px",
    )


def _background(made: ConfigValues, draft: Draft) -> None:
    scenes, reason = draft.scenes
    indoor, outdoor = "indoor" in scenes, "outdoor" in scenes
    turn_deg = _turn_deg(draft)
    made.section(
        "background",
        {
            "cuboid": int(indoor),
            "plane": int(outdoor),
            "wall_disparity_px": _wall_px(draft) if indoor else None,
            "wall_turn_deg": turn_deg if indoor and turn_deg < BackgroundSection().wall_turn_deg else None,
            "plane_disparity_px": _plane_px(draft) if outdoor else None,
        },
        f"{' and '.join(scenes).capitalize()} scenes: {reason}.",
        wall_disparity_px=f"the back wall: the farthest {_WALL_UP_TO:.0%} of the pixels",
        wall_turn_deg="more would spread a wall over several bins of the target",
        plane_disparity_px="the far plane: between infinity and min_px",
    )


def _camera_origin(draft: Draft) -> str:
    rigs, scale = draft.rigs, draft.scale
    sources = list(dict.fromkeys(rig.source for rig in rigs))
    text = f"From {abbreviate(sources, _SOURCES_SHOWN)}"
    if scale is not None:
        text += f", scaled by {scale:g} (a position c in pixels becomes (c + 0.5) {scale:g} - 0.5)"
    if len(rigs) > 1:
        text += f"; of {len(rigs)} rigs the least and the largest of each value"
    sizes = sorted({rig.size for rig in rigs})
    if len(sizes) > 1:
        text += (
            f"; their {len(sizes)} sizes run from {sizes[0]} to {sizes[-1]}: the median is taken, and principal points "
            "keep their distance to the centre"
        )
    return text + "."


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
    """Return a value with numbers of ten digits, and with a range of equal ends as one number."""
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
            return {key: _rounded(each) for key, each in value.items()}
        case _:
            return [_rounded(each) for each in value]


def _node(value: Any, key: Key, beside: Mapping[Key, str]) -> Any:  # noqa: ANN401 - any value of a config
    """Return a value as ruamel.yaml writes it with comments: recipes' sections and lists of numbers on one line."""
    if isinstance(value, Mapping):
        tree = CommentedMap({name: _node(each, (*key, str(name)), beside) for name, each in value.items()})
        if key[:1] == ("scenes",) and len(key) > 2:
            tree.fa.set_flow_style()
        for name in value:
            if text := beside.get((*key, str(name))):
                tree.yaml_add_eol_comment(text, name, column=_BESIDE)
        return tree
    if isinstance(value, list):
        items = CommentedSeq(_node(each, (*key, str(number)), beside) for number, each in enumerate(value))
        if not any(isinstance(each, str | Mapping) for each in value) or key == ("outputs",):
            items.fa.set_flow_style()
        return items
    # Plain, a line break of Unicode in a file's name would be read as a space.
    return DoubleQuotedScalarString(value) if isinstance(value, str) and not value.isprintable() else value


def _wrapped(text: str) -> str:
    """Return a comment in lines of the YAML's width, without letters that cannot be printed."""
    return textwrap.fill(printable(text), _WIDTH - 2, break_long_words=False, break_on_hyphens=False)
