"""The range and the wanted histogram of disparity: measured from maps, or wide and smooth over a known range."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.calibration.kinds import Size
from semisynth_gl.calibration.rig import Rig, median_size
from semisynth_gl.codecs.disparity_map import read_disparity_map
from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.histogram import Histogram, PixelCount
from semisynth_gl.inputs.errors import InputError, abbreviate, counted

# Quantiles between which the range lies: predictions and lidar have a few values that are far off.
_LOWEST, _HIGHEST = 0.001, 0.999
# Ratio of max_px to the largest measured disparity: the near plane lies at max_px, and objects need room behind it.
_HEADROOM = 1.1
# Largest number of bins. Objects extend in depth, so their disparities cannot follow much narrower bins.
_MOST_BINS = 22
# Round widths of bins, to be multiplied by a power of ten.
_STEPS = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)
# Least width of a range: a config's bins are at least 1e-6 px wide.
_LEAST_PX = _MOST_BINS * 1e-6
# Lower end of a chosen range where it is unknown, as a fraction of the way to the upper end.
_LOW_OF_HIGH = 0.02
# A chosen histogram has an even part, of this share, and a hump with its peak at this fraction of the range.
_EVEN_PART = 0.25
_HUMP = 1 / 6
# Largest number of maps that the sentence on the origin names.
_NAMED = 3
# Width of the fine bins: narrow enough for quantiles, and a divisor of all bins of round width from 1 px on.
_FINE_PX = 1 / 16
# Largest ratios of a map's shape and width to the rig's; beyond these, the map is hardly one of this rig.
_MOST_SHAPE, _MOST_SCALE = 1.5, 16.0
# Share of a map's pixels: a number that more pixels have exactly may be a mark for missing values.
_MARK = 0.001


@dataclass(frozen=True, slots=True, eq=False)
class DisparityRange:
    """The values of the section ``disparity``.

    ``target`` is the wanted histogram, in bins of width ``bin_px`` from ``min_px`` on. ``origin`` is a sentence on the
    origin of the values.
    """

    min_px: float
    max_px: float
    bin_px: float
    target: Histogram
    origin: str = ""

    @property
    def signed(self) -> bool:
        """Whether the range includes disparities of 0 or below."""
        return self.min_px <= 0


def disparity_range(
    rigs: Sequence[Rig],
    maps: Sequence[Path] = (),
    *,
    png_scale: float = KITTI_DISPARITY.steps,
    range_px: tuple[float, float] | None = None,
    range_m: tuple[float, float] | None = None,
) -> DisparityRange:
    """Return the range and the histogram of disparity, with their origin: the bounds in the calibrations by default.

    Args:
        rigs: the rigs.
        maps: the user's maps, one for each scene.
        png_scale: number of levels per pixel in 16-bit PNG maps.
        range_px: least and largest disparity, instead of maps.
        range_m: least and largest distance, instead of ``range_px``.

    Raises:
        InputError: where no source gives a range or it does not fit the rigs.
        ReadError: where a map cannot be read.
    """
    least_doffs_px = min(rig.camera.doffs_px for rig in rigs)
    if maps:
        names = abbreviate([str(path) for path in maps], _NAMED)
        found = measured_range(measure_maps(maps, rigs, png_scale), least_doffs_px)
        return replace(found, origin=f"Measured from {counted(len(maps), 'disparity map')}: {names}.")
    low_px: float | None
    if range_px is not None:
        low_px, high_px = range_px
        origin = "the range given"
    elif range_m is not None:
        near_m, far_m = range_m
        if not 0 < near_m < far_m:
            raise InputError(
                f"expected two distances above 0, the nearer one first, got {near_m:g} {far_m:g}", argument="range_m"
            )
        low_px = min(rig.camera.focal_baseline / far_m - rig.camera.doffs_px for rig in rigs)
        high_px = max(rig.camera.focal_baseline / near_m - rig.camera.doffs_px for rig in rigs)
        origin = f"distances from {near_m:g} to {far_m:g} m"
    else:
        low_px, high_px = _calibrated_bounds(rigs)
        origin = "the calibration's bounds"
    return replace(
        chosen_range(low_px, high_px, least_doffs_px),
        origin=f"A wide and smooth histogram over {origin}, not measured.",
    )


def _calibrated_bounds(rigs: Sequence[Rig]) -> tuple[float | None, float]:
    """Return both ends of the range of disparity that calibrations state; an unknown low is None."""
    largest = [px for rig in rigs if (px := rig.bounds.ndisp or rig.bounds.vmax_px) is not None and px > 0]
    if not largest:
        camera = rigs[0].camera
        raise InputError(
            f"the range of disparity is not known: {rigs[0].source} states none, as ndisp or vmax; give disparity "
            "maps, or the range in pixels or metres: at a distance of Z m, this rig has "
            f"{camera.focal_baseline:.4g} / Z - {camera.doffs_px:.4g} px"
        )
    # A vmin of 0 stands for an unknown one, and a vmin beyond infinity is not valid.
    named = [(rig.bounds.vmin_px, -rig.camera.doffs_px) for rig in rigs]
    least = [vmin_px for vmin_px, infinity_px in named if vmin_px and vmin_px > min(infinity_px, 0.0)]
    # The least vmin is a bound for all rigs only if every rig has one.
    return min(least) if len(least) == len(rigs) else None, max(largest)


def measure_maps(paths: Sequence[Path], rigs: Sequence[Rig], png_scale: float = KITTI_DISPARITY.steps) -> Histogram:
    """Measure the disparities of one or more maps, in fine bins, px at the rigs' median width.

    Each map has the same weight, whatever its number of values; `read_values` says which numbers mark missing values.
    Disparities are in proportion to the width of the image. If a map's size is not that of any rig, its disparities are
    multiplied by the ratio of the rigs' median width to the map's width. ``png_scale`` is the number of levels per
    pixel of disparity in a 16-bit PNG. Raises InputError where a map does not fit the rigs or has no value, and
    ReadError where it cannot be read.
    """
    sizes, median = {rig.size for rig in rigs}, median_size(rigs)
    widest = max(width for width, _ in sizes)
    # Bins begin at 0, or at infinity's disparity where that is below 0.
    first_px = -max(0.0, *(rig.camera.doffs_px for rig in rigs))
    edges = np.arange(math.floor(first_px / _FINE_PX), round(widest / _FINE_PX) + 1) * _FINE_PX
    shares = np.zeros(len(edges) - 1)
    for path in paths:
        disparity = read_values(path, rigs, png_scale)
        size = Size(*disparity.shape[::-1])
        if not np.isfinite(disparity).any():
            raise InputError(f"{path}: holds no disparity: all of its {size} values are 0 or below, inf or nan")
        largest = float(np.nanmax(disparity))
        if largest > size.width_px:
            raise InputError(
                f"{path}: holds disparities up to {largest:g} px in an image {size.width_px} px wide. If a PNG has not "
                f"{png_scale:g} levels per pixel, give its scale"
            )
        if size not in sizes:
            scale = median.width_px / size.width_px
            shape = scale * size.height_px / median.height_px
            if not (1 / _MOST_SHAPE <= shape <= _MOST_SHAPE and 1 / _MOST_SCALE <= scale <= _MOST_SCALE):
                raise InputError(
                    f"{path}: has {size} pixels, but the images of the calibration have {median}: expected maps of "
                    f"this rig, of nearly the same shape, at most {_MOST_SCALE:g} times as wide or narrow"
                )
            disparity = disparity * np.float32(scale)
        count = PixelCount(edges)
        count.add(disparity)
        shares += count.histogram.shares
    return Histogram.from_counts(edges, shares)


def read_values(path: Path, rigs: Sequence[Rig], png_scale: float = KITTI_DISPARITY.steps) -> NDArray[np.float32]:
    """Read a disparity map of one of several rigs: (H, W) float32, px, nan where a value is missing.

    In 16-bit grey .png, 0 marks a missing value; there ``png_scale`` is the number of levels per pixel of disparity. In
    .pfm and .npy, inf and nan mark missing values. If no rig has a positive doffs, so do 0 and all negative numbers.

    With a positive doffs, far points have disparities between -doffs and 0. Then all numbers at or below -doffs are
    missing values. 0 and the map's least number, if negative, also mark them where more than a thousandth of the pixels
    have exactly that number.

    Raises ReadError where the file has another format, or not one value per pixel.
    """
    values = read_disparity_map(path, png_scale)
    # The disparity of infinity, at the map's resolution.
    infinity_px = -max(rig.camera.doffs_px * values.shape[1] / rig.size.width_px for rig in rigs)
    finite = np.isfinite(values)
    known = finite & (values > min(infinity_px, 0.0))
    if infinity_px < 0 and finite.any():
        for mark in {np.float32(0), values[finite].min()}:
            marked = values == mark
            if mark <= 0 and np.mean(marked) > _MARK:
                known &= ~marked
    return np.where(known, values, np.float32(np.nan))


def farthest_px(least_doffs_px: float, *, signed: bool = False) -> float:
    """Return the lower limit of all disparities, px: d > -doffs, and also d > 0 unless disparities are signed."""
    return -least_doffs_px if signed else max(0.0, -least_doffs_px)


def measured_range(histogram: Histogram, least_doffs_px: float = 0.0) -> DisparityRange:
    """Return the range without the lowest and highest thousandth of the disparities, and the histogram in its bins.

    The range has a tenth of room above the largest of these disparities. ``histogram`` has fine bins, as that of
    `measure_maps`. ``least_doffs_px`` is the least cx_right - cx_left of the rigs. Raises InputError where disparities
    lie beyond infinity.
    """
    low, high = histogram.quantile(_LOWEST), histogram.quantile(_HIGHEST)
    _check_before_infinity(low, least_doffs_px, "a thousandth of the measured disparities lies below")
    first = _rounded_down(low, farthest_px(least_doffs_px, signed=low <= 0))
    edges, bin_px = _bins(first, max(high * _HEADROOM, high + (_HEADROOM - 1) * (high - first)))
    return DisparityRange(first, float(edges[-1]), bin_px, histogram.rebinned(edges))


def chosen_range(low_px: float | None, high_px: float, least_doffs_px: float = 0.0) -> DisparityRange:
    """Return a known range with a wide and smooth histogram.

    If ``low_px`` is None, the range begins a fiftieth of the way from `farthest_px` to ``high_px``. ``least_doffs_px``
    is the least cx_right - cx_left of the rigs. Raises InputError where the range is empty or reaches infinity.
    """
    farthest = farthest_px(least_doffs_px)
    low = farthest + _LOW_OF_HIGH * (high_px - farthest) if low_px is None else low_px
    if not (low < high_px < math.inf and (low > 0 or least_doffs_px > 0)):
        above = "" if least_doffs_px > 0 else ", both above 0"
        raise InputError(f"the range of disparity is {low:g} to {high_px:g} px: expected low < high{above}")
    _check_before_infinity(low, least_doffs_px, "the range of disparity begins at")
    edges, bin_px = _bins(low, high_px)
    inside = np.clip((np.clip(edges, low, high_px) - low) / (high_px - low), 0, 1)
    # The integral of x exp(-x / h), a gamma distribution of shape 2.
    hump = 1 - (1 + inside / _HUMP) * np.exp(-inside / _HUMP)
    cumulative = _EVEN_PART * inside + (1 - _EVEN_PART) * hump / hump[-1]
    return DisparityRange(low, high_px, bin_px, Histogram.from_counts(edges, np.diff(cumulative)))


def _bins(low: float, high: float) -> tuple[NDArray[np.float64], float]:
    """Return the edges of up to 22 bins from a range's low end to its high end or beyond, and their round width."""
    if high - low < _LEAST_PX:
        raise InputError(
            f"the range of disparity is {low} to {high} px: expected ends that differ by {_LEAST_PX:g} px or more"
        )
    least = (high - low) / (_MOST_BINS - 1)  # rounding up the end may add a bin
    power = 10.0 ** math.floor(math.log10(least))
    bin_px = next(step * power for step in (*_STEPS, 10.0) if step * power >= least)
    bin_px = float(f"{bin_px:.6g}")  # 3 x 0.1 is 0.30000000000000004
    return np.round(low + np.arange(math.ceil((high - low) / bin_px) + 1) * bin_px, 9), bin_px


def _check_before_infinity(low_px: float, least_doffs_px: float, what: str) -> None:
    if low_px + least_doffs_px <= 0:
        raise InputError(
            f"{what} {low_px:g} px, but with doffs = {least_doffs_px:g} px (cx_right - cx_left) the disparity of "
            f"infinity is {-least_doffs_px:g} px: expected larger disparities, of this rig alone"
        )


def _rounded_down(value: float, above: float) -> float:
    """Round a value down to two digits, but keep at least half of its distance above the limit ``above``.

    Where rounding the value would lose more, its distance above the limit is rounded down to two digits instead.
    """
    rounded = _two_digits(value) if value > 0 else above
    return rounded if rounded - above >= (value - above) / 2 else above + _two_digits(value - above)


def _two_digits(value: float) -> float:
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.floor(value / step) * step:.6g}")
