"""Writing a config for `generate` from a rig's calibration and photographs, by assets/calibrated.yaml.jinja."""

import json
import math
import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from semisynth_gl.calibration.arrays import Size
from semisynth_gl.calibration.disparity_range import DisparityRange, DisparitySource, disparity_range, farthest_px
from semisynth_gl.calibration.photographs import are_grey, check_sizes, patch_sides, photograph_sizes
from semisynth_gl.calibration.recipes import SceneRecipe, suitable_recipes
from semisynth_gl.calibration.rectification import Rectification, measure_rectification
from semisynth_gl.calibration.rig import Rig, median_size, rig_ranges
from semisynth_gl.calibration.style import Style
from semisynth_gl.config import Config
from semisynth_gl.config.load import Overrides, with_overrides
from semisynth_gl.config.scene_sections import BackgroundSection, TexturesSection
from semisynth_gl.frame.camera import Eye
from semisynth_gl.frame.raw_camera import vector_of
from semisynth_gl.inputs.errors import abbreviate
from semisynth_gl.inputs.templates import template_environment
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.layouts import find_layout
from semisynth_gl.lens.chain import LensChain
from semisynth_gl.textures.image_files import find_images, printable
from semisynth_gl.textures.subjects import of_subjects, photographed_subjects

PROPOSED_PAIRS = 1000
"""Number of pairs that `calibrate` proposes to generate."""

# Columns of the YAML.
_WIDTH = 100
# Diameters of particles as fractions of the image's width, as in the packaged configs: 60 and 420 px of 1500.
_SMALLEST_OF_WIDTH, _LARGEST_OF_WIDTH = 0.04, 0.28
# Rooms, and most halls, have no pixels farther than this.
_INDOOR_M = 20.0
# Shares of such far pixels: only indoor scenes suit up to the first, only outdoor scenes beyond the second.
_INDOOR_AT_MOST, _OUTDOOR_FROM = 0.005, 0.05
# Ratio of the largest to the smallest depth up to which a street or an open ground would not fit.
_DEPTH_OF_FLAT = 3.0
# Back walls have the disparities of this farthest share of the wanted pixels. Particles can hide a wall that is too
# far, but not one that is too near.
_WALL_UP_TO = 0.05
# Ends of the far plane's disparities, as fractions of the way from the farthest possible disparity to min_px.
_PLANE_OF_MIN = (0.1, 0.7)
_SOURCES_SHOWN = 5
_USUAL_PATCH_PX = TexturesSection().patch_px


@dataclass(frozen=True, slots=True, eq=False)
class ConfigFacts:
    """The facts that a config is written from.

    Attributes:
        rigs: the rigs, scaled by ``scale`` if that is given.
        scale: the user's scale of images and maps against the calibrated size.
        disparity: range and wanted histogram of disparity.
        images: the user's sources of photographs, as absolute paths.
        photograph_count: number of photographs.
        subject_count: number of subjects that they show.
        large_px: side of large patches.
        grey: whether all photographs are grey.
        rectification: deviations that were measured in pairs; None without pairs.
        fitting_count: number of photographs with a calibrated size; 0 where sizes were not compared.
        layout: the layout that suits the rigs, see `suited_layout`; None for the default.
        lenses: each eye's way through its lens; None without a calibration of the cameras before rectification.
        patch_px: side of patches.
        overrides: keys that the user sets, as `load_config` takes them.
    """

    rigs: Sequence[Rig]
    scale: float | None
    disparity: DisparityRange
    images: Sequence[str]
    photograph_count: int
    subject_count: int
    large_px: int
    grey: bool = False
    rectification: Rectification | None = None
    fitting_count: int = 0
    layout: str | None = None
    lenses: Mapping[Eye, LensChain] | None = None
    patch_px: int = _USUAL_PATCH_PX
    overrides: Overrides = ()

    @property
    def photographs(self) -> str:
        """Text with the number of photographs and, if that differs, the number of their subjects."""
        return f"{self.photograph_count}{of_subjects(self.photograph_count, self.subject_count)}"

    @property
    def size(self) -> Size:
        """Size of the config's images: the median over the rigs."""
        return median_size(self.rigs)

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Least and largest value over the rigs, by key of the section ``camera``; see `rig_ranges`."""
        return rig_ranges(self.rigs)

    @property
    def fy_over_fx(self) -> float:
        """Ratio of the focal lengths in y and x, in the middle of the rigs' range: a config has one."""
        return sum(self.ranges["fy_over_fx"]) / 2

    @property
    def far_share(self) -> float:
        """Share of the wanted pixels that are farther than 20 m, for the middle of the rigs' ranges."""
        ranges = self.ranges
        focal_px, baseline_m = (math.sqrt(math.prod(ranges[key])) for key in ("focal_px", "baseline_m"))
        far_px = focal_px * baseline_m / _INDOOR_M - sum(ranges["doffs_px"]) / 2
        return float(self.disparity.target.cumulative(far_px))

    @property
    def flat(self) -> bool:
        """Whether the view ends so soon behind the nearest things that a wall has to close it, even outdoors."""
        disparity, doffs_px = self.disparity, sum(self.ranges["doffs_px"]) / 2
        return disparity.max_px + doffs_px < _DEPTH_OF_FLAT * (disparity.min_px + doffs_px)

    @property
    def scenes_origin(self) -> str:
        """The reason for the kinds of scenes."""
        if self.flat:
            return f"the farthest pixels are less than {_DEPTH_OF_FLAT:g} times as far as the nearest"
        return f"{self.far_share:.1%} of the wanted pixels are farther than {_INDOOR_M:g} m"

    @property
    def scenes(self) -> tuple[str, ...]:
        """The kinds of scenes that suit `far_share` and `flat`: ``indoor``, ``outdoor`` or both."""
        suitable = {
            "indoor": self.far_share <= _OUTDOOR_FROM or self.flat,
            "outdoor": self.far_share > _INDOOR_AT_MOST and not self.flat,
        }
        return tuple(kind for kind in suitable if suitable[kind])

    @property
    def recipes(self) -> tuple[SceneRecipe, ...]:
        """The recipes that suit the scenes."""
        doffs_px = sum(self.ranges["doffs_px"]) / 2
        return suitable_recipes(self.scenes, self.disparity, self.size.width_px, doffs_px)


def config_facts(
    rigs: Sequence[Rig],
    images: Sequence[str],
    disparity: DisparitySource,
    *,
    scale: float | None = None,
    other_camera: bool = False,
    pairs: Sequence[tuple[Path, Path]] = (),
    lenses: Mapping[Eye, LensChain] | None = None,
    overrides: Overrides = (),
) -> ConfigFacts:
    """Gather the facts for a config, and check that they fit together.

    Args:
        rigs: the rigs as calibrated, before scaling.
        images: sources of photographs: files, folders and globs.
        disparity: the source of the range and the histogram of disparity.
        scale: scale of images and maps against the calibrated size.
        other_camera: whether another camera took the photographs, so that they may have any size.
        pairs: left and right photographs of the rig, to match.
        lenses: each eye's way through its lens, if the config is to have it.
        overrides: keys that the user sets, as `load_config` takes them.

    Raises:
        InputError: where something is missing or does not fit together.
        ReadError: where a map cannot be read.
    """
    photographs = find_images(images)
    sizes = photograph_sizes(photographs)
    fitting_count = 0 if other_camera else check_sizes(sizes, [rig.size for rig in rigs], scale)
    if scale is not None:
        rigs = [rig.scaled(scale) for rig in rigs]
    patch_px, large_px = patch_sides(sizes, median_size(rigs).width_px)
    return ConfigFacts(
        rigs,
        scale,
        disparity_range(disparity, rigs),
        [str(expanded(path).absolute()) for path in images],
        len(photographs),
        len(photographed_subjects(photographs)),
        large_px,
        are_grey(photographs),
        measure_rectification(pairs, rigs) if pairs else None,
        fitting_count,
        lenses=lenses,
        patch_px=patch_px,
        overrides=overrides,
    )


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


def config_text(name: str, facts: ConfigFacts, style: Style) -> str:
    """Write the config as YAML, with comments that say where its numbers came from."""
    environment = template_environment()
    environment.filters |= {"comment": _comment, "flow": _flow, "number": _number, "quoted": _quoted, "range": _range}
    environment.filters |= {"degrees": math.degrees, "vector": vector_of}
    shares = [f"{max(share, 0.0):.4f}".rstrip("0").rstrip(".") for share in facts.disparity.target.shares]
    smallest, largest = (round(part * facts.size.width_px) for part in (_SMALLEST_OF_WIDTH, _LARGEST_OF_WIDTH))
    text = environment.get_template("calibrated.yaml.jinja").render(
        name=name,
        facts=facts,
        style=style,
        camera_origin=_camera_origin(facts),
        shares=textwrap.fill(", ".join(shares), _WIDTH - 14),
        wall_px=_wall_px(facts),
        wall_share=_WALL_UP_TO,
        turn_deg=_turn_deg(facts),
        usual_turn_deg=BackgroundSection().wall_turn_deg,
        usual_patch_px=_USUAL_PATCH_PX,
        plane_px=_plane_px(facts),
        size_px=(max(smallest, 1), max(largest, 2)),
    )
    return with_overrides(text, facts.overrides) if facts.overrides else text


def config_name(stem: str) -> str:
    """Return a name for a config, of letters, digits and hyphens, made from any text such as a file's stem."""
    return re.sub(r"[^A-Za-z0-9]+", "-", stem).strip("-") or "calibrated"


def _camera_origin(facts: ConfigFacts) -> str:
    rigs, scale = facts.rigs, facts.scale
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


def _wall_px(facts: ConfigFacts) -> tuple[float, float]:
    disparity = facts.disparity
    deep_px = float(f"{disparity.target.quantile(_WALL_UP_TO) - disparity.min_px:.2g}")
    return disparity.min_px, disparity.min_px + deep_px


def _turn_deg(facts: ConfigFacts) -> float:
    """Return the turn, degrees, at which a wall's disparities at the image's side and middle differ by one bin.

    For a wall of disparity d turned by a, d + doffs becomes (d + doffs) (1 + tan(a) x / f) at x px from the middle.
    """
    disparity, ranges = facts.disparity, facts.ranges
    steepest = facts.size.width_px / 2 / ranges["focal_px"][0]
    far_px = max(disparity.min_px + sum(ranges["doffs_px"]) / 2, disparity.bin_px)
    return float(f"{math.degrees(math.atan(disparity.bin_px / far_px / steepest)):.2g}")


def _plane_px(facts: ConfigFacts) -> tuple[float, float]:
    """Return the far plane's range of disparity, below min_px and above that of infinity for the least doffs."""
    min_px = facts.disparity.min_px
    farthest = farthest_px(facts.ranges["doffs_px"][0], signed=facts.disparity.signed)
    low, high = (farthest + float(f"{part * (min_px - farthest):.2g}") for part in _PLANE_OF_MIN)
    return low, high


def _flow(value: Any) -> str:  # noqa: ANN401 - whatever a recipe sets
    """Return a value as one line of YAML."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_flow(each)}" for key, each in value.items()) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"[{', '.join(map(_flow, value))}]"
    return value if isinstance(value, str) else _number(value)


def _comment(text: str) -> str:
    lines = textwrap.wrap(printable(text), _WIDTH - 2, break_long_words=False, break_on_hyphens=False)
    return "".join(f"# {line}\n" for line in lines)


def _range(ends: tuple[float, float]) -> str:
    low, high = (_number(end) for end in ends)
    return low if low == high else f"[{low}, {high}]"


def _number(value: float) -> str:
    # Ten digits are enough for any calibration, and leave out the rounding errors of binary numbers.
    return f"{float(f'{value:.10g}') + 0.0:.10g}"


def _quoted(text: str) -> str:
    """Return any text as a YAML string: JSON's, with YAML's escape for characters that cannot be printed."""
    quoted = json.dumps(text, ensure_ascii=False)
    return "".join(letter if letter.isprintable() else f"\\U{ord(letter):08X}" for letter in quoted)
