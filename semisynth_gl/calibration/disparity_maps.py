"""Disparity maps, true or predicted, dense or sparse: counting them."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from semisynth_gl.calibration.rig import Size
from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.comparison.maps import read_map
from semisynth_gl.errors import InputError
from semisynth_gl.histogram import Histogram, PixelCount

# Fine enough for any quantile, and for bins of any round width from 1 px.
_FINE_PX = 1 / 16


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredMaps:
    """The disparities of several maps, each counting the same whatever its number of values.

    Attributes:
        histogram: mean of the maps' histograms, in fine bins, from 0.
        pixels: number of pixels of all maps.
        valid: number of pixels with a disparity.
    """

    histogram: Histogram
    pixels: int
    valid: int


def measure_maps(
    paths: Sequence[Path], sizes: Collection[Size], png_scale: float = KITTI_DISPARITY.steps
) -> MeasuredMaps:
    """Count the disparities of all maps.

    Args:
        paths: the maps, at least one.
        sizes: sizes that maps may have, those of the rigs' images.
        png_scale: levels of a PNG per pixel of disparity.

    Raises:
        InputError: with the numbers, where a map has another size, no value at all, or values beyond its width.
        ReadError: where a map cannot be read.
    """
    widest = max(width for width, _ in sizes)
    edges = np.arange(round(widest / _FINE_PX) + 1) * _FINE_PX
    shares = np.zeros(len(edges) - 1)
    pixels = valid = 0
    for path in paths:
        disparity = read_map(path, png_scale)
        size = Size(*disparity.shape[::-1])
        if size not in sizes:
            wanted = " or ".join(map(str, sorted(set(sizes))))
            raise InputError(
                f"{path}: has {size} pixels, but the calibration is for {wanted}. Disparities count pixels of their "
                "own size: give maps of the calibration's size, or --scale if all of them are reduced alike"
            )
        has_value = np.isfinite(disparity)
        count = int(has_value.sum())
        if count == 0:
            raise InputError(f"{path}: holds no disparity: all of its {size} values are 0 or below, inf or nan")
        largest = float(disparity[has_value].max())
        if largest > size.width_px:
            raise InputError(
                f"{path}: holds disparities up to {largest:g} px in an image {size.width_px} px wide: expected pixels. "
                f"For a PNG with other levels than {png_scale:g} per pixel, give their number with --png-scale"
            )
        counted = PixelCount(edges)
        counted.add(disparity)
        shares += counted.histogram.shares
        pixels += disparity.size
        valid += count
    return MeasuredMaps(Histogram.from_counts(edges, shares), pixels, valid)
