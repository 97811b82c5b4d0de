"""The YAML of a calibrated config, with comments that say where each number came from."""

import json
import math
import re
import textwrap
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from semisynth_gl.calibration.rig import Rig, Size
from semisynth_gl.calibration.target import DisparityRange, farthest_px

_WIDTH = 100
# Of the image's width, as in the packaged configs: 60 and 420 px of 1500.
_SMALLEST_OF_WIDTH, _LARGEST_OF_WIDTH = 0.04, 0.28
# Seen farther than this, a place is no room; and hardly a hall.
_INDOOR_M = 20.0
_INDOOR_AT_MOST, _OUTDOOR_FROM = 0.005, 0.05
# The back wall shows the far end of the histogram alone: particles can hide what is too far, but not what is too near.
_WALL_UP_TO = 0.05
# The default of the config.
_WALL_TURN_DEG = 15.0
# Where the far plane is, on the way from the farthest disparity that there can be to min_px.
_PLANE_OF_MIN = (0.1, 0.7)


@dataclass(frozen=True, slots=True)
class Ranges:
    """The least and the largest value of each quantity over the rigs.

    Attributes:
        size: of the images.
        focal_px: focal length.
        baseline_m: baseline.
        cx_left_px: left principal point.
        doffs_px: cx_right - cx_left.
        cy_px: y of both.
        sizes: how many sizes the rigs have; of several ``size`` is the median, and principal points are moved with the
            centre.
    """

    size: Size
    focal_px: tuple[float, float]
    baseline_m: tuple[float, float]
    cx_left_px: tuple[float, float]
    doffs_px: tuple[float, float]
    cy_px: tuple[float, float]
    sizes: int

    @property
    def doffs_mean_px(self) -> float:
        """The middle of its range."""
        return sum(self.doffs_px) / 2


def ranges_of(rigs: Sequence[Rig]) -> Ranges:
    """Return the range of each quantity over one or more rigs."""
    cameras = [rig.camera for rig in rigs]
    width_px, height_px = (sorted(sides)[len(rigs) // 2] for sides in zip(*(rig.size for rig in rigs), strict=True))

    def ends(values: Sequence[float]) -> tuple[float, float]:
        return min(values), max(values)

    return Ranges(
        size=(width_px, height_px),
        focal_px=ends([camera.focal_px for camera in cameras]),
        baseline_m=ends([camera.baseline_m for camera in cameras]),
        cx_left_px=ends([camera.cx_left_px + (width_px - camera.width_px) / 2 for camera in cameras]),
        doffs_px=ends([camera.doffs_px for camera in cameras]),
        cy_px=ends([camera.cy_px + (height_px - camera.height_px) / 2 for camera in cameras]),
        sizes=len({rig.size for rig in rigs}),
    )


@dataclass(frozen=True, slots=True)
class Background:
    """Which background suits a histogram.

    Attributes:
        cuboid: weight of indoor scenes.
        plane: weight of outdoor scenes.
        far_share: share of the pixels farther than 20 m.
    """

    cuboid: int
    plane: int
    far_share: float

    @property
    def scenes(self) -> str:
        """``indoor``, ``outdoor`` or both."""
        return " and ".join(kind for kind, weight in (("indoor", self.cuboid), ("outdoor", self.plane)) if weight)


def background_of(ranges: Ranges, disparity: DisparityRange) -> Background:
    """Choose indoor or outdoor scenes, or both, by how much lies farther than 20 m: near 0 px but for doffs."""
    middle = [math.sqrt(low * high) for low, high in (ranges.focal_px, ranges.baseline_m)]
    far_px = middle[0] * middle[1] / _INDOOR_M - ranges.doffs_mean_px
    share = float(disparity.target.cumulative(far_px))
    return Background(int(share <= _OUTDOOR_FROM), int(share > _INDOOR_AT_MOST), share)


def document(
    name: str,
    rigs: Sequence[Rig],
    disparity: DisparityRange,
    *,
    scale: float | None,
    disparity_from: str,
    images: Sequence[str],
    images_from: str,
) -> str:
    """Write the config.

    Args:
        name: the config's.
        rigs: at least one.
        disparity: range and histogram.
        scale: what ``--scale`` said; the rigs are scaled already.
        disparity_from: where range and histogram came from, a sentence.
        images: files, folders and globs, absolute.
        images_from: how many photographs those are, a sentence.
    """
    ranges = ranges_of(rigs)
    background = background_of(ranges, disparity)
    width_px, height_px = ranges.size
    lines = [*_comment(f"{name}: written by semisynth-gl calibrate."), f"name: {_quoted(name)}", ""]
    lines += _comment(_camera_from(rigs, ranges, scale))
    lines += [
        "camera:",
        f"  width_px: {width_px}",
        f"  height_px: {height_px}",
        f"  focal_px: {_range(ranges.focal_px)}",
        f"  baseline_m: {_range(ranges.baseline_m)}",
        f"  cx_left_px: {_range(ranges.cx_left_px)}",
        f"  doffs_px: {_range(ranges.doffs_px):<20} # cx of the right camera minus cx of the left one",
        f"  cy_px: {_range(ranges.cy_px)}",
        "",
    ]
    lines += _comment(disparity_from)
    shares = [f"{max(share, 0.0):.4f}".rstrip("0").rstrip(".") for share in disparity.target.shares]
    listed = textwrap.wrap(", ".join(shares), _WIDTH - 14)
    lines += [
        "disparity:",
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
        f"{background.far_share:.1%} of the wanted pixels are farther than {_INDOOR_M:g} m: {background.scenes} scenes."
    )
    lines += ["background:", f"  cuboid: {background.cuboid}", f"  plane: {background.plane}"]
    if background.cuboid:
        deep_px = float(f"{disparity.target.quantile(_WALL_UP_TO) - disparity.min_px:.2g}")
        walls = _range((disparity.min_px, disparity.min_px + deep_px))
        lines.append(f"  wall_disparity_px: {walls:<11} # the back wall: the farthest {_WALL_UP_TO:.0%} of the pixels")
        turn = _wall_turn_deg(ranges, disparity)
        if turn < _WALL_TURN_DEG:
            lines.append(f"  wall_turn_deg: {turn:<15g} # more would spread a wall over several bins of the target")
    if background.plane:
        planes = _range(_plane_px(ranges, disparity))
        lines.append(f"  plane_disparity_px: {planes:<10} # the far plane: between infinity and min_px")
    sizes = (round(_SMALLEST_OF_WIDTH * width_px), round(_LARGEST_OF_WIDTH * width_px))
    lines += [
        "",
        *_comment(f"In proportion to the width of {width_px} px, as in the packaged configs."),
        "particles:",
        f"  size_px: {_range((float(max(sizes[0], 1)), float(max(sizes[1], 2))))}",
        "",
        *_comment(images_from),
        "textures:",
        "  source: images",
        "  images:",
        *(f"    - {_quoted(path)}" for path in images),
    ]
    return "\n".join(lines) + "\n"


def _plane_px(ranges: Ranges, disparity: DisparityRange) -> tuple[float, float]:
    """Range of the far plane: below min_px, and above what lies at infinity for the rig of the least doffs."""
    farthest = farthest_px(ranges.doffs_px[0])
    low, high = (farthest + float(f"{part * (disparity.min_px - farthest):.2g}") for part in _PLANE_OF_MIN)
    return low, high


def _wall_turn_deg(ranges: Ranges, disparity: DisparityRange) -> float:
    """The turn by which a back wall's disparity differs by a bin between the middle of the image and its side.

    Turned by a, a wall at the disparity d has (d + doffs) (1 + tan(a) x / f) at x from the middle.
    """
    steepest = ranges.size[0] / 2 / ranges.focal_px[0]
    far_px = max(disparity.min_px + ranges.doffs_mean_px, disparity.bin_px)
    return float(f"{math.degrees(math.atan(disparity.bin_px / far_px / steepest)):.2g}")


def name_of(stem: str) -> str:
    """Return a config's name like a file's: letters, digits and hyphens."""
    name = re.sub(r"[^A-Za-z0-9]+", "-", stem).strip("-")
    return name or "calibrated"


def shown_range(ends: tuple[float, float], unit: str) -> str:
    """Return a range as a person reads it, such as ``994.978 px`` or ``0.16 to 0.38 m``."""
    low, high = ends
    return f"{low:.6g} {unit}" if f"{low:.6g}" == f"{high:.6g}" else f"{low:.6g} to {high:.6g} {unit}"


def _camera_from(rigs: Sequence[Rig], ranges: Ranges, scale: float | None) -> str:
    sources = list(dict.fromkeys(rig.source for rig in rigs))
    text = f"From {_some(sources)}"
    if scale is not None:
        text += f", scaled by {scale:g} (a position c in pixels becomes (c + 0.5) {scale:g} - 0.5)"
    if len(rigs) > 1:
        text += f"; of {len(rigs)} rigs the least and the largest of each value"
    if ranges.sizes > 1:
        seen = Counter(rig.size for rig in rigs)
        smallest, largest = min(seen), max(seen)
        text += (
            f"; their {ranges.sizes} sizes run from {smallest[0]} x {smallest[1]} to {largest[0]} x {largest[1]}: the "
            "median is taken, and principal points keep their distance to the centre"
        )
    return text + "."


def _some(names: Sequence[str], most: int = 5) -> str:
    shown = ", ".join(_printable(name) for name in names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"


def _comment(text: str) -> list[str]:
    lines = textwrap.wrap(_printable(text), _WIDTH - 2, break_long_words=False, break_on_hyphens=False)
    return [f"# {line}" for line in lines]


def _printable(text: str) -> str:
    """Names of files may hold line breaks, which would end a comment."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def _range(ends: tuple[float, float]) -> str:
    low, high = (_number(end) for end in ends)
    return low if low == high else f"[{low}, {high}]"


def _number(value: float) -> str:
    # What calibrations hold, without the noise of the last binary digits.
    return f"{float(f'{value:.10g}') + 0.0:.10g}"


def _quoted(text: str) -> str:
    """Return a YAML string, whatever it holds: JSON's, but that YAML has an escape of its own beyond 16 bits."""
    quoted = json.dumps(text, ensure_ascii=False)
    return "".join(letter if letter.isprintable() else f"\\U{ord(letter):08X}" for letter in quoted)
