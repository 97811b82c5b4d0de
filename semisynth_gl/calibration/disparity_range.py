"""The range and the wanted histogram of disparity: measured in maps, or a smooth histogram over a given range."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.calibration.rig import RectifiedRig
from semisynth_gl.calibration.sizes import ImageSize
from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.config.fields import LARGEST
from semisynth_gl.histogram import Histogram, count_pixels
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.judge.place import read_map

# The range follows from these quantiles: predictions and lidar have a few outliers.
_LOWEST, _HIGHEST = 0.001, 0.999
# Least ratio of max_px to the higher quantile. The near plane is at max_px, and objects must not reach it.
_HEADROOM = 1.1
# Maximum number of bins. Objects extend in depth, so scenes cannot match much narrower bins.
_MOST_BINS = 22
# Widths of bins, times a power of ten.
_STEPS = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
_LEAST_PX = _MOST_BINS * 1e-6  # minimum width of a range: a config's bins are at least 1e-6 px wide
# Over a given range, this share of the pixels is uniform. The others form a hump, with its peak at this fraction.
_EVEN_PART, _HUMP = 0.25, 1 / 6
# Width of the fine bins: narrow enough for quantiles, and it divides all widths of bins from 1 px on.
_FINE_PX = 1 / 16
# Maximum ratio of the aspect ratios of a map and the rig's images: beyond it, the map belongs to a different rig.
_MOST_RATIO = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class DisparityDistribution:
    """Values of the section ``disparity``: its limits, and a histogram whose bins of ``bin_px`` begin at min_px."""

    min_px: float
    max_px: float
    bin_px: float
    target: Histogram


def disparity_range(
    rig: RectifiedRig,
    maps: Sequence[Path] = (),
    *,
    png_scale: float = KITTI_DISPARITY.steps,
    range_px: tuple[float, float] | None = None,
    range_m: tuple[float, float] | None = None,
) -> DisparityDistribution:
    """Return the range and the histogram of disparity, from maps, a range of disparities or a range of distances.

    16-bit PNG maps have ``png_scale`` levels per pixel. Raises InputError if none of the three is given, or they do not
    fit the rig, and ReadError if a map cannot be read.
    """
    focal_baseline, doffs_px = rig.camera.focal_baseline, rig.camera.doffs_px
    if maps:
        return measured_range(measure_maps(maps, rig.size, png_scale), doffs_px)
    if range_px is not None:
        return chosen_range(*range_px, doffs_px)
    if range_m is None:
        raise InputError(
            "missing: give a range of disparities or of distances, or disparity maps; at a distance of Z m, the "
            f"disparity of this rig is {focal_baseline:.4g} / Z - {doffs_px:.4g} px",
            argument="range_px",
        )
    near_m, far_m = range_m
    if not 0 < near_m < far_m <= LARGEST:
        text = f"expected two distances above 0 and up to {LARGEST:g} m, the nearer one first, got {near_m:g} {far_m:g}"
        raise InputError(text, argument="range_m")
    return chosen_range(focal_baseline / far_m - doffs_px, focal_baseline / near_m - doffs_px, doffs_px)


def measure_maps(paths: Sequence[Path], size: ImageSize, png_scale: float = KITTI_DISPARITY.steps) -> Histogram:
    """Measure the positive disparities of one or more maps, in fine bins, px in images of ``size``.

    Each map has the same weight. If a map has a different size, its disparities are multiplied by the ratio of the
    widths. Raises InputError if a map does not fit the rig or has no value, and ReadError if it cannot be read.
    """
    edges = np.arange(round(size.width_px / _FINE_PX) + 1) * _FINE_PX
    shares = np.zeros(len(edges) - 1)
    for path in paths:
        disparity = read_map(path, png_scale)
        own = ImageSize(*disparity.shape[::-1])
        largest = np.max(disparity, initial=-np.inf, where=np.isfinite(disparity))
        ratio = own.height_px / own.width_px * size.width_px / size.height_px
        if not (-np.inf < largest <= own.width_px and 1 / _MOST_RATIO <= ratio <= _MOST_RATIO):
            raise InputError(
                f"{path}: has {own} pixels, and a largest disparity of {largest:g} px: expected about the aspect ratio "
                f"of the rig's images, {size}, and disparities above 0 and below the map's width. If a PNG does not "
                f"have {png_scale:g} levels per pixel, give its scale"
            )
        counts = count_pixels(disparity * np.float32(size.width_px / own.width_px), edges)
        shares += Histogram.from_counts(edges, counts).shares
    return Histogram.from_counts(edges, shares)


def measured_range(histogram: Histogram, doffs_px: float = 0.0) -> DisparityDistribution:
    """Return the range of the disparities in a histogram with fine bins, such as that of `measure_maps`.

    It begins at the 0.001 quantile, rounded down, and ends at 1.1 times the 0.999 quantile, rounded up to whole bins.
    ``doffs_px`` is cx_right - cx_left. Raises InputError if the range reaches -doffs, the disparity of infinity.
    """
    low, high = histogram.quantile(_LOWEST), histogram.quantile(_HIGHEST)
    _check(low, high + _LEAST_PX, doffs_px)
    # Round min_px down: its distance from ``farthest``, the disparity of infinity or 0, has two digits.
    farthest = max(0.0, -doffs_px)
    step = 10.0 ** (math.floor(math.log10(low - farthest)) - 1)
    first = farthest + float(f"{math.floor((low - farthest) / step) * step:.6g}")
    edges, bin_px = _bins(first, high * _HEADROOM)
    return DisparityDistribution(first, float(edges[-1]), bin_px, histogram.rebinned(edges))


def chosen_range(low_px: float, high_px: float, doffs_px: float = 0.0) -> DisparityDistribution:
    """Return a given range with a smooth histogram; raises InputError if it is empty or reaches infinity.

    ``doffs_px`` is cx_right - cx_left.
    """
    _check(low_px, high_px, doffs_px)
    edges, bin_px = _bins(low_px, high_px)
    inside = np.clip((np.clip(edges, low_px, high_px) - low_px) / (high_px - low_px), 0, 1)
    # Proportional to the integral of x exp(-x / h): a gamma distribution of shape 2.
    hump = 1 - (1 + inside / _HUMP) * np.exp(-inside / _HUMP)
    cumulative = _EVEN_PART * inside + (1 - _EVEN_PART) * hump / hump[-1]
    return DisparityDistribution(low_px, high_px, bin_px, Histogram.from_counts(edges, np.diff(cumulative)))


def _bins(low: float, high: float) -> tuple[NDArray[np.float64], float]:
    """Return the edges of up to 22 bins from ``low`` to at least ``high``, and the bins' width."""
    least = (high - low) / (_MOST_BINS - 1)  # rounding up the end may add a bin
    power = 10.0 ** math.floor(math.log10(least))
    # Rounded: 3 x 0.1 is 0.30000000000000004.
    bin_px = float(f"{next(step * power for step in _STEPS if step * power >= least):.6g}")
    return np.round(low + np.arange(math.ceil((high - low) / bin_px) + 1) * bin_px, 9), bin_px


def _check(low_px: float, high_px: float, doffs_px: float) -> None:
    if not -doffs_px < low_px <= high_px - _LEAST_PX < LARGEST:
        raise InputError(
            f"the range of disparity is {low_px:g} to {high_px:g} px: expected ends that differ by {_LEAST_PX:g} px or "
            f"more, both below {LARGEST:g} px and above {-doffs_px:g} px, the disparity of infinity for this rig"
        )
