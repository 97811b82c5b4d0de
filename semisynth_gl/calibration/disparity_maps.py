"""Counting the disparities of maps, true or predicted, dense or sparse."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.calibration.rig import Rig, Size, median_size
from semisynth_gl.codecs.disparity_map import read_disparity_map
from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.histogram import Histogram, PixelCount
from semisynth_gl.inputs.errors import InputError

# Fine enough for any quantile, and for bins of any round width from 1 px.
_FINE_PX = 1 / 16
# Of a map against the rig: beyond it the two are hardly one place, such as a street in a room's shape.
_MOST_SHAPE, _MOST_SCALE = 1.5, 16.0
# A number that more of a map's pixels have, to the last bit, says that there is no disparity.
_MARK = 0.001


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredMaps:
    """The disparities of several maps, each counting the same whatever its number of values.

    ``histogram`` has fine bins, ``valid`` counts pixels with a disparity, and ``scaled`` has the sizes of maps whose
    disparities were scaled to the rig's width.
    """

    histogram: Histogram
    pixels: int
    valid: int
    scaled: tuple[Size, ...] = ()


def measure_maps(paths: Sequence[Path], rigs: Sequence[Rig], png_scale: float = KITTI_DISPARITY.steps) -> MeasuredMaps:
    """Count the disparities of one or more maps; `read_values` says which numbers mark missing values.

    The disparities of a view are in proportion to the width of its image, so those of a map that has no rig's size are
    scaled by the ratio of its width to the rigs' median one. ``png_scale`` is levels of a PNG per pixel of disparity.
    Raises InputError where a map does not fit the rigs or has no value, and ReadError where it cannot be read.
    """
    sizes, median = {rig.size for rig in rigs}, median_size(rigs)
    widest = max(width for width, _ in sizes)
    # Nothing is farther than infinity.
    first_px = -max(0.0, *(rig.camera.doffs_px for rig in rigs))
    edges = np.arange(math.floor(first_px / _FINE_PX), round(widest / _FINE_PX) + 1) * _FINE_PX
    shares = np.zeros(len(edges) - 1)
    pixels = valid = 0
    scaled = list[Size]()
    for path in paths:
        disparity = read_values(path, rigs, png_scale)
        size = Size(*disparity.shape[::-1])
        has_value = np.isfinite(disparity)
        count = int(has_value.sum())
        if count == 0:
            raise InputError(f"{path}: holds no disparity: all of its {size} values are 0 or below, inf or nan")
        largest = float(disparity[has_value].max())
        if largest > size.width_px:
            raise InputError(
                f"{path}: holds disparities up to {largest:g} px in an image {size.width_px} px wide: expected pixels. "
                f"For a PNG with other levels than {png_scale:g} per pixel, give their number as `png_scale`"
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

    In .pfm and .npy, inf and nan mark missing values. Without a positive doffs, 0 and negative numbers do too. With
    one, far points have such disparities, down to -doffs; then only 0 and the map's least number mark missing values,
    and only where more than a thousandth of the pixels have exactly that number. In 16-bit grey .png, 0 marks them.
    Raises ReadError where the file has another format, or not one value per pixel.
    """
    values = read_disparity_map(path, png_scale)
    # At the map's own resolution.
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
    """Return the factor that scales a map of another size to the rig's width; refuse maps of another shape or scale."""
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
