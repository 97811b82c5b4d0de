"""Disparity maps, true or predicted, dense or sparse: finding, reading and counting them."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.calibration.rig import Size
from semisynth_gl.codecs.disparity_map import MAP_EXTENSIONS, is_disparity_map, read_disparity_map
from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.errors import InputError
from semisynth_gl.histogram import Histogram, PixelCount
from semisynth_gl.textures.image_files import find_files
from semisynth_gl.user_files import expanded

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


def find_maps(sources: Sequence[str | Path]) -> list[Path]:
    """Return the disparity maps of files, folders and globs: .pfm, .npy and 16-bit grey .png.

    In folders and globs, PNG files of other kinds are passed over: images and masks lie beside disparity maps.

    Args:
        sources: files, folders and globs.

    Raises:
        InputError: where a source matches no map.
        ReadError: where a PNG of a folder or glob cannot be read.
    """
    paths: dict[Path, None] = {}
    for source in sources:
        maps = find_files([source], MAP_EXTENSIONS)
        if not expanded(source).is_file():
            maps = [path for path in maps if is_disparity_map(path)]
        if not maps:
            raise InputError(
                f"--disparity {source}: no disparity map there: expected .pfm, .npy or 16-bit grey .png, or a folder "
                "or glob of them"
            )
        paths |= dict.fromkeys(maps)
    return list(paths)


def read_map(path: Path, png_scale: float = KITTI_DISPARITY.steps) -> NDArray[np.float32]:
    """Read a disparity map.

    Args:
        path: .pfm or .npy, in which inf, nan, 0 and negative numbers stand for no value, or 16-bit grey .png, in which
            0 does.
        png_scale: levels of a PNG per pixel of disparity.

    Returns:
        (H, W) float32, px, nan where there is no value.

    Raises:
        ReadError: where the file has another format, or not one value per pixel.
    """
    values = read_disparity_map(path, png_scale)
    return np.where(np.isfinite(values) & (values > 0), values, np.float32(np.nan))


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
