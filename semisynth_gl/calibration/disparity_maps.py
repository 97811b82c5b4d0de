"""Measuring the disparities of maps, true or predicted, dense or sparse."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.calibration.arrays import Size
from semisynth_gl.calibration.rig import Rig, median_size
from semisynth_gl.codecs.disparity_map import read_disparity_map
from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.histogram import Histogram, PixelCount
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.judge.place import disparity_of_depths

# Width of the fine bins: narrow enough for quantiles, and a divisor of all bins of round width from 1 px on.
_FINE_PX = 1 / 16
# Largest ratios of a map's shape and width to the rig's; beyond these, the map is hardly one of this rig.
_MOST_SHAPE, _MOST_SCALE = 1.5, 16.0
# Share of a map's pixels: a number that more pixels have exactly may be a mark for missing values.
_MARK = 0.001


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredMaps:
    """The disparities of several maps, each with the same weight whatever its number of values.

    Attributes:
        histogram: distribution of disparity in fine bins, px at the rigs' median width.
        pixels: number of pixels of all maps.
        valid: number of pixels with a disparity.
        scaled: sizes of the maps whose disparities were scaled to the rigs' median width.
    """

    histogram: Histogram
    pixels: int
    valid: int
    scaled: tuple[Size, ...] = ()


def measure_maps(
    paths: Sequence[Path], rigs: Sequence[Rig], png_scale: float = KITTI_DISPARITY.steps, *, depths: bool = False
) -> MeasuredMaps:
    """Measure the disparities of one or more maps; `read_values` says which numbers mark missing values.

    Disparities are in proportion to the width of the image. If a map's size is not that of any rig, its disparities are
    multiplied by the ratio of the rigs' median width to the map's width. ``png_scale`` is the number of levels per
    pixel of disparity in a 16-bit PNG. With ``depths``, the maps hold depths of the first rig instead. Raises
    InputError where a map does not fit the rigs or has no value, and ReadError where it cannot be read.
    """
    sizes, median = {rig.size for rig in rigs}, median_size(rigs)
    widest = max(width for width, _ in sizes)
    # Bins begin at 0, or at infinity's disparity where that is below 0.
    first_px = -max(0.0, *(rig.camera.doffs_px for rig in rigs))
    edges = np.arange(math.floor(first_px / _FINE_PX), round(widest / _FINE_PX) + 1) * _FINE_PX
    shares = np.zeros(len(edges) - 1)
    pixels = valid = 0
    scaled = list[Size]()
    for path in paths:
        disparity = disparity_of_depths(path, rigs[0].camera) if depths else read_values(path, rigs, png_scale)
        size = Size(*disparity.shape[::-1])
        has_value = np.isfinite(disparity)
        count = int(has_value.sum())
        if count == 0:
            raise InputError(f"{path}: holds no disparity: all of its {size} values are 0 or below, inf or nan")
        largest = float(disparity[has_value].max())
        if largest > size.width_px:
            raise InputError(
                f"{path}: holds disparities up to {largest:g} px in an image {size.width_px} px wide: expected "
                f"disparities up to the width. If a PNG has not {png_scale:g} levels per pixel, give its "
                "scale; if the map holds depths, give it as a depth map"
            )
        if size not in sizes:
            disparity = disparity * np.float32(_scale_to(median, size, path))
            scaled.append(size)
        counted = PixelCount(edges)
        counted.add(disparity)
        shares += counted.histogram.shares
        pixels += disparity.size
        valid += count
    return MeasuredMaps(Histogram.from_counts(edges, shares), pixels, valid, tuple(scaled))


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


def _scale_to(rig: Size, size: Size, path: Path) -> float:
    """Return the factor that scales a map's disparities; raises InputError where shape or width differ too much."""
    scale = rig.width_px / size.width_px
    shape = (rig.width_px / rig.height_px) / (size.width_px / size.height_px)
    if not 1 / _MOST_SHAPE <= shape <= _MOST_SHAPE:
        problem = (
            f"its shape differs by a factor of {max(shape, 1 / shape):.3g}, and at most {_MOST_SHAPE:g} is expected"
        )
    elif not 1 / _MOST_SCALE <= scale <= _MOST_SCALE:
        problem = f"its width by a factor of {max(scale, 1 / scale):.3g}, and at most {_MOST_SCALE:g} is expected"
    else:
        return scale
    raise InputError(
        f"{path}: has {size} pixels, but the images of the calibration have {rig}: {problem}. Disparities are scaled "
        "by the ratio of the widths, which is right for one view at several resolutions: give maps of this rig"
    )
