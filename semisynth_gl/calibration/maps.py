"""Disparity maps, true or guessed, dense or sparse: finding, reading and counting them."""

import struct
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.calibration.rig import Size
from semisynth_gl.errors import InputError
from semisynth_gl.histogram import Histogram, PixelCount
from semisynth_gl.read.disparity import KITTI_PNG_SCALE, MAP_EXTENSIONS, read_disparity
from semisynth_gl.textures.image_files import find_files

# Fine enough for any quantile, and for bins of any round width from 1 px.
_FINE_PX = 1 / 16


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What the maps say together, each counting the same whatever its number of values.

    Attributes:
        histogram: in fine bins, from 0.
        maps: how many.
        pixels: how many they have, all together.
        valid: how many of these have a disparity.
    """

    histogram: Histogram
    maps: int
    pixels: int
    valid: int


def find_maps(sources: Sequence[str | Path]) -> list[Path]:
    """Return the disparity maps of files, folders and globs: .pfm, .npy and 16-bit grey .png.

    In folders and globs, PNG files of other kinds are passed over: images and masks lie beside disparity maps.

    Raises:
        InputError: where a source matches none.
    """
    found: list[Path] = []
    for source in sources:
        maps = find_files([source], MAP_EXTENSIONS)
        if not Path(source).expanduser().is_file():
            maps = [path for path in maps if path.suffix.lower() != ".png" or _is_grey16(path)]
        if not maps:
            raise InputError(
                f"--disparity {source}: no disparity map there: expected .pfm, .npy or 16-bit grey .png, or a folder "
                "or glob of them"
            )
        found += [path for path in maps if path not in found]
    return found


def read_map(path: Path, png_scale: float = KITTI_PNG_SCALE) -> NDArray[np.float32]:
    """Read a disparity map.

    Args:
        path: .pfm (inf, nan, 0 and below say that there is no value), .npy (likewise) or 16-bit grey .png (0 does).
        png_scale: levels of a PNG per pixel of disparity.

    Returns:
        (H, W) float32, px, nan where there is no value.

    Raises:
        ReadError: where it is none of these, or not one value per pixel.
    """
    values = read_disparity(path, png_scale)
    return np.where(np.isfinite(values) & (values > 0), values, np.float32(np.nan))


def measure(paths: Sequence[Path], sizes: Collection[Size], png_scale: float = KITTI_PNG_SCALE) -> Measured:
    """Count the disparities of all maps.

    Args:
        paths: at least one.
        sizes: that maps may have, width and height of the rigs' images.
        png_scale: see `read_map`.

    Raises:
        InputError: with the numbers, where a map has another size, no value at all, or values beyond its width.
        ReadError: where one cannot be read.
    """
    widest = max(width for width, _ in sizes)
    edges = np.arange(round(widest / _FINE_PX) + 1) * _FINE_PX
    shares = np.zeros(len(edges) - 1)
    pixels = valid = 0
    for path in paths:
        disparity = read_map(path, png_scale)
        height, width = disparity.shape
        if (width, height) not in sizes:
            wanted = " or ".join(f"{w} x {h}" for w, h in sorted(set(sizes)))
            raise InputError(
                f"{path}: has {width} x {height} pixels, but the calibration is for {wanted}. Disparities count pixels "
                "of their own size: give maps of the calibration's size, or --scale if all of them are reduced alike"
            )
        has_value = np.isfinite(disparity)
        count = int(has_value.sum())
        if count == 0:
            raise InputError(
                f"{path}: holds no disparity: all of its {width} x {height} values are 0 or below, inf or nan"
            )
        largest = float(disparity[has_value].max())
        if largest > width:
            raise InputError(
                f"{path}: holds disparities up to {largest:g} px in an image {width} px wide: expected pixels. Of a "
                f"PNG with other levels than {png_scale:g} per pixel, say how many with --png-scale"
            )
        counted = PixelCount(edges)
        counted.add(disparity)
        shares += counted.histogram.shares
        pixels += disparity.size
        valid += count
    return Measured(Histogram.of(edges, shares), len(paths), pixels, valid)


def _is_grey16(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            head = file.read(26)
    except OSError:
        return False
    return len(head) == 26 and head[12:16] == b"IHDR" and struct.unpack(">BB", head[24:26]) == (16, 0)
