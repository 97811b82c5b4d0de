"""From a rig's calibration and photographs to a config that `generate` takes as it is, with comments on its numbers."""

import json
import math
import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from semisynth_gl.calibration.disparity_range import DisparityRange, DisparitySource, disparity_range, farthest_px
from semisynth_gl.calibration.photographs import are_grey, check_sizes, large_side, photograph_sizes
from semisynth_gl.calibration.recipes import SceneRecipe, suitable_recipes
from semisynth_gl.calibration.rectification import Rectification, measure_rectification
from semisynth_gl.calibration.rig import Rig, Size, median_size, rig_ranges
from semisynth_gl.calibration.style import Style
from semisynth_gl.config import Config
from semisynth_gl.config.scene_sections import BackgroundSection
from semisynth_gl.errors import abbreviate
from semisynth_gl.layouts import find_layout
from semisynth_gl.textures.image_files import find_images, printable
from semisynth_gl.textures.subjects import of_subjects, photographed_subjects
from semisynth_gl.user_files import expanded

PROPOSED_PAIRS = 1000
"""Number of pairs that `calibrate` proposes to generate."""

_WIDTH = 100
# Of the image's width, as in the packaged configs: 60 and 420 px of 1500.
_SMALLEST_OF_WIDTH, _LARGEST_OF_WIDTH = 0.04, 0.28
# A place with pixels farther than this is no room, and hardly a hall.
_INDOOR_M = 20.0
_INDOOR_AT_MOST, _OUTDOOR_FROM = 0.005, 0.05
# The back wall has the far end of the histogram alone: particles can hide a wall that is too far, not one too near.
_WALL_UP_TO = 0.05
# Place of the far plane between the farthest possible disparity and min_px.
_PLANE_OF_MIN = (0.1, 0.7)
_SOURCES_SHOWN = 5


@dataclass(frozen=True, slots=True, eq=False)
class ConfigFacts:
    """The facts that a config is written from.

    Attributes:
        rigs: the rigs, at least one, scaled.
        scale: scale of the images against the calibrated size, where the user gave one.
        disparity: range and histogram of the disparities.
        images: files, folders and globs of the photographs, absolute.
        photograph_count: number of photographs.
        subject_count: number of subjects that they show.
        large_px: side of large patches.
        grey: whether all photographs are grey.
        rectification: how far pairs of photographs are off rectified; None where there are none to match.
        fitting_count: number of photographs with the size of a calibration; 0 where sizes were not compared.
        layout: layout of the config's datasets, see `suited_layout`.
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

    @property
    def photographs(self) -> str:
        """How many photographs there are and, where it is not the same number, of how many subjects."""
        return f"{self.photograph_count}{of_subjects(self.photograph_count, self.subject_count)}"

    @property
    def size(self) -> Size:
        """Size of the images."""
        return median_size(self.rigs)

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """The ranges over the rigs, see `rig_ranges`."""
        return rig_ranges(self.rigs)

    @property
    def far_share(self) -> float:
        """Share of the wanted pixels that are farther than 20 m: near 0 px but for doffs."""
        ranges = self.ranges
        focal_px, baseline_m = (math.sqrt(math.prod(ranges[key])) for key in ("focal_px", "baseline_m"))
        far_px = focal_px * baseline_m / _INDOOR_M - sum(ranges["doffs_px"]) / 2
        return float(self.disparity.target.cumulative(far_px))

    @property
    def scenes(self) -> tuple[str, ...]:
        """The scenes that suit the far share: ``indoor``, ``outdoor`` or both."""
        suitable = {"indoor": self.far_share <= _OUTDOOR_FROM, "outdoor": self.far_share > _INDOOR_AT_MOST}
        return tuple(kind for kind in suitable if suitable[kind])

    @property
    def recipes(self) -> tuple[SceneRecipe, ...]:
        """The recipes that suit the scenes."""
        return suitable_recipes(self.scenes, self.disparity, self.size.width_px)


def config_facts(
    rigs: Sequence[Rig],
    images: Sequence[str],
    disparity: DisparitySource,
    *,
    scale: float | None = None,
    other_camera: bool = False,
    pairs: Sequence[tuple[Path, Path]] = (),
) -> ConfigFacts:
    """Gather the facts for a config, and check that they fit together.

    Args:
        rigs: at least one, as calibrated.
        images: photographs: files, folders and globs.
        disparity: disparity maps, or a range.
        scale: scale of images and maps against the calibrated size.
        other_camera: True if photographs may have other sizes than the rig's images.
        pairs: left and right photographs of the rig, to match.

    Raises:
        InputError: where anything is missing or does not fit together, or pairs cannot be matched.
        ReadError: where a map cannot be read.
    """
    photographs = find_images(images)
    sizes = photograph_sizes(photographs)
    fitting_count = 0 if other_camera else check_sizes(sizes, [rig.size for rig in rigs], scale)
    if scale is not None:
        rigs = [rig.scaled(scale) for rig in rigs]
    return ConfigFacts(
        rigs,
        scale,
        disparity_range(disparity, rigs),
        [str(expanded(path).absolute()) for path in images],
        len(photographs),
        len(photographed_subjects(photographs)),
        large_side(sizes, median_size(rigs).width_px),
        are_grey(photographs),
        measure_rectification(pairs, rigs) if pairs else None,
        fitting_count,
    )


def suited_layout(config: Config, rigs: Sequence[Rig]) -> str | None:
    """Return the layout of the calibrations' benchmark; None where they have no benchmark, or several.

    Nor is it taken where it cannot hold the disparities of a config, or its loaders refuse what `generate` makes of it.

    Args:
        config: the config for the rigs.
        rigs: at least one.
    """
    names = {rig.layout for rig in rigs}
    name = names.pop() if len(names) == 1 else None
    if name is None:
        return None
    layout = find_layout(name)
    codec = layout.encodings_for(config).disparity
    holds = config.disparity.max_px <= codec.limit_px and (codec.signed or not config.disparity.signed)
    return name if holds and not layout.advice(PROPOSED_PAIRS, config, "train") else None


def config_text(name: str, facts: ConfigFacts, style: Style) -> str:
    """Write the config as YAML, with comments that say where its numbers came from.

    Args:
        name: name of the config.
        facts: rigs, disparities and photographs.
        style: mix of the recipes, and look of the surfaces.
    """
    ranges, disparity = facts.ranges, facts.disparity
    width_px, height_px = facts.size
    camera = {key: _range(ends) for key, ends in ranges.items()}
    camera["doffs_px"] = f"{camera['doffs_px']:<20} # cx of the right camera minus cx of the left one"
    lines = [*_comment(f"{name}: written by semisynth-gl calibrate."), f"name: {_quoted(name)}"]
    if facts.layout is not None:
        lines.append(f"layout: {facts.layout:<19} # as the calibration's; without, the number of pairs decides")
    lines.append("")
    lines += _comment(_camera_origin(facts))
    lines += [
        "camera:",
        f"  width_px: {width_px}",
        f"  height_px: {height_px}",
        *(f"  {key}: {text}" for key, text in camera.items()),
    ]
    if facts.grey:
        lines.append("  colour: grey              # as all photographs are")
    lines.append("")
    if facts.rectification is not None and facts.rectification.ranges:
        lines += _comment(facts.rectification.origin)
        lines += ["rig:", *(f"  {key}: {_range(ends)}" for key, ends in facts.rectification.ranges.items()), ""]
    lines += _comment(disparity.origin)
    shares = [f"{max(share, 0.0):.4f}".rstrip("0").rstrip(".") for share in disparity.target.shares]
    listed = textwrap.wrap(", ".join(shares), _WIDTH - 14)
    lines += [
        "disparity:",
        *(["  signed: true              # 0 and below are disparities"] if disparity.signed else []),
        f"  min_px: {_number(disparity.min_px)}",
        f"  max_px: {_number(disparity.max_px):<20} # hard limit: sets the near plane",
        f"  target: # mean {disparity.target.mean_px:.2f} px",
        "    form: histogram",
        f"    bin_px: {_number(disparity.bin_px)}",
        f"    first_px: {_number(float(disparity.target.edges_px[0]))}",
        "    shares: [" + ("\n" + 13 * " ").join(listed) + "]",
        "",
    ]
    lines += _comment(
        f"{facts.far_share:.1%} of the wanted pixels are farther than {_INDOOR_M:g} m: {' and '.join(facts.scenes)} "
        "scenes."
    )
    indoor, outdoor = "indoor" in facts.scenes, "outdoor" in facts.scenes
    lines += ["background:", f"  cuboid: {indoor:d}", f"  plane: {outdoor:d}"]
    if indoor:
        deep_px = float(f"{disparity.target.quantile(_WALL_UP_TO) - disparity.min_px:.2g}")
        walls = _range((disparity.min_px, disparity.min_px + deep_px))
        lines.append(f"  wall_disparity_px: {walls:<11} # the back wall: the farthest {_WALL_UP_TO:.0%} of the pixels")
        # Turned by a, a wall at the disparity d has (d + doffs) (1 + tan(a) x / f) at x from the middle of the image.
        # At this turn its disparity at the side of the image differs from that in the middle by a bin.
        steepest = width_px / 2 / ranges["focal_px"][0]
        far_px = max(disparity.min_px + sum(ranges["doffs_px"]) / 2, disparity.bin_px)
        turn = float(f"{math.degrees(math.atan(disparity.bin_px / far_px / steepest)):.2g}")
        if turn < BackgroundSection().wall_turn_deg:
            lines.append(f"  wall_turn_deg: {turn:<15g} # more would spread a wall over several bins of the target")
    if outdoor:
        # Below min_px, and above the disparity of infinity for the least doffs.
        farthest = farthest_px(ranges["doffs_px"][0], signed=disparity.signed)
        low, high = (farthest + float(f"{part * (disparity.min_px - farthest):.2g}") for part in _PLANE_OF_MIN)
        planes = _range((low, high))
        lines.append(f"  plane_disparity_px: {planes:<10} # the far plane: between infinity and min_px")
    sizes = (round(_SMALLEST_OF_WIDTH * width_px), round(_LARGEST_OF_WIDTH * width_px))
    lines += [
        "",
        *_comment(f"In proportion to the width of {width_px} px, as in the packaged configs."),
        "particles:",
        f"  size_px: {_range((float(max(sizes[0], 1)), float(max(sizes[1], 2))))}",
        "",
        *_comment(style.mix_origin),
        "scenes:",
        *chain.from_iterable(map(_recipe, style.recipes, style.weights)),
        "",
        *_comment(f"Photographs: {facts.photographs} when this was written. {style.look_origin}"),
        "textures:",
        f"  texels_per_pixel: {_range(style.texels_per_pixel)}",
        f"  flat_share: {_number(style.flat_share)}",
        f"  large_px: {facts.large_px:<15} # the largest squares of photographs, whole, where a patch would repeat",
        "  source: images",
        "  images:",
        *(f"    - {_quoted(path)}" for path in facts.images),
        "",
        "# As soft as the photographs are, see textures.",
        "imperfections:",
        f"  blur_px: {_number(style.blur_px)}",
    ]
    if style.exposure_stops:
        stops = _number(style.exposure_stops)
        lines.append(f"  exposure_stops: {stops:<9} # surfaces of photographs of several exposures meet in one image")
    return "\n".join(lines) + "\n"


def config_name(stem: str) -> str:
    """Return the name of a config from a file's: letters, digits and hyphens."""
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


def _recipe(recipe: SceneRecipe, weight: float) -> list[str]:
    lines = [f"  - recipe: {recipe.name:<15} # {recipe.meaning}", f"    weight: {_number(weight)}"]
    return lines + [f"    {section}: {_flow(keys)}" for section, keys in recipe.keys.items()]


def _flow(value: Any) -> str:  # noqa: ANN401 - whatever a recipe sets
    """Return a value in one line of YAML."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_flow(each)}" for key, each in value.items()) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"[{', '.join(map(_flow, value))}]"
    return value if isinstance(value, str) else _number(value)


def _comment(text: str) -> list[str]:
    lines = textwrap.wrap(printable(text), _WIDTH - 2, break_long_words=False, break_on_hyphens=False)
    return [f"# {line}" for line in lines]


def _range(ends: tuple[float, float]) -> str:
    low, high = (_number(end) for end in ends)
    return low if low == high else f"[{low}, {high}]"


def _number(value: float) -> str:
    # All digits of a calibration, without the noise of the last binary digits.
    return f"{float(f'{value:.10g}') + 0.0:.10g}"


def _quoted(text: str) -> str:
    """Return any text as a YAML string: JSON's, except for YAML's escape for code points beyond 16 bits."""
    quoted = json.dumps(text, ensure_ascii=False)
    return "".join(letter if letter.isprintable() else f"\\U{ord(letter):08X}" for letter in quoted)
