"""Cuts squares out of images, reduces them to patches, measures them, and finds duplicates."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from semisynth_gl.textures.borders import Rectangle

FINGERPRINT_NORM = 1000
"""Euclidean length of a `fingerprint`, up to rounding."""

LUMINANCE = (299, 587, 114)
"""Thousandths of red, green and blue in luminance, by ITU-R BT.601."""
LUMINANCE_PARTS = np.array(LUMINANCE) / 1000
"""The weights of `LUMINANCE`, which add up to 1, (3,) float64."""

# Number of cells along each side of a patch, in which texture and fingerprints are measured.
_GRID_CELLS = 8


class Square(NamedTuple):
    """A square of an upright image: column and row of its upper left pixel, and its side.

    ``source`` is the image's path relative to the folder that all images share, or the name of a picture. A clip has
    the path of its first frame.
    """

    source: str
    left_px: int
    top_px: int
    side_px: int


def cover(source: str, part: Rectangle, patch_px: int, scales: Sequence[float]) -> list[Square]:
    """Return squares that cover a part of an image once for each scale, by increasing side, then by row and column.

    A scale is a number of image pixels per patch pixel, 1 or more. Along each axis, the smallest possible number of
    squares is spread evenly from border to border. A scale whose square does not fit gives no squares.
    """
    return [
        Square(source, part.left_px + left, part.top_px + top, side)
        for side in sorted({round(scale * patch_px) for scale in scales})
        if side <= min(part.height_px, part.width_px)
        for top in _positions(part.height_px, side)
        for left in _positions(part.width_px, side)
    ]


def _positions(extent: int, side: int) -> list[int]:
    count = -(-extent // side)
    gaps = max(count - 1, 1)
    # In integers, so that the last square ends exactly at the border and there are no gaps between squares.
    return [(i * (extent - side) + gaps // 2) // gaps for i in range(count)]


def cut_crop(image: NDArray[np.uint8], square: Square, patch_px: int) -> NDArray[np.uint8]:
    """Cut a square out of an image (H, W, 3) uint8; return a new array, a patch (patch_px, patch_px, 3) uint8.

    A square of ``patch_px`` is copied bit for bit. A larger square is averaged over areas: for integer factors, each
    patch pixel is the rounded mean of factor x factor image pixels. A smaller square is interpolated.
    """
    _, left, top, side = square
    cut = image[top : top + side, left : left + side]
    if side == patch_px:
        return cut.copy()
    factor, rest = divmod(side, patch_px)
    if rest:
        filtered = Image.Resampling.BOX if side > patch_px else Image.Resampling.BICUBIC
        return np.array(Image.fromarray(cut).resize((patch_px, patch_px), filtered))
    # Pillow's reduce is off by one level in some pixels unless the factor is a power of two. NumPy's sums over so short
    # axes take four times as long as adding row by row and column by column.
    rows = sum((cut[row::factor] for row in range(1, factor)), cut[::factor].astype(np.uint32))
    sums = sum((rows[:, column::factor] for column in range(1, factor)), rows[:, ::factor])
    means: NDArray[np.uint8] = ((2 * sums + factor**2) // (2 * factor**2)).astype(np.uint8)
    return means


def texture_measure(patch: NDArray[np.uint8]) -> float:
    """Return how much texture a patch has: the median contrast of a grid of 8 x 8 cells, from 0 to 127.5.

    The contrast of a cell is the standard deviation of its luminance (0.299 R + 0.587 G + 0.114 B) in 8-bit levels. For
    a high median, half of the patch must have texture: one strong edge across a blank wall has little effect. Patches
    below 16 pixels have fewer cells, of 2 pixels or more.

    The patch is an image of any size, (H, W, 3) RGB or (H, W) grey.
    """
    luminance = _luminance(patch)
    heights, widths = (np.diff(_cell_edges(extent)) for extent in luminance.shape)
    counts = np.multiply.outer(heights, widths)
    # Sums are integers, so that a flat cell has a deviation of exactly zero.
    means = (_cell_sums(luminance, np.int64) / counts).repeat(heights, axis=0).repeat(widths, axis=1)
    squares = _cell_sums(np.square(luminance - means), np.float64)
    return float(np.median(np.sqrt(squares / counts))) / 1000.0


def least_texture(images: Iterable[NDArray[np.uint8]]) -> float:
    """Return the smallest `texture_measure` of several images, from every second pixel of every second row."""
    return min(texture_measure(np.ascontiguousarray(image[::2, ::2])) for image in images)


def sharpness_measure(patch: NDArray[np.uint8]) -> float:
    """Return how sharp a patch is: the contrast of its finest octave divided by that of the third octave.

    Octave k is the difference between the means over squares with sides of 2^(k - 1) pixels and the means over 2 x 2 of
    these squares (a Haar decomposition). Its contrast is the root mean square. A blur lowers the finest octave first.

    The measure is 0.25 for a gradient; 0.26 to 0.33 after a Gaussian blur of 2 pixels; 0.34 to 1.5 for sharp
    photographs; 4 for white noise; infinite if the third octave has no contrast. The patch is (P, P, 3) uint8 with P of
    8 or more; rows and columns beyond the last multiple of 8 are ignored.
    """
    rows, columns = (extent // 8 * 8 for extent in patch.shape[:2])
    # In integers throughout, so that the measure is the same on every machine.
    sums = _luminance(patch[:rows, :columns]).astype(np.int64)
    energies = []
    for octave in range(3):
        finer, pairs = sums, sums[::2] + sums[1::2]
        sums = pairs[:, ::2] + pairs[:, 1::2]
        energy = 4 * int(np.square(finer).sum()) - int(np.square(sums).sum())
        # The squares of sums are 16^octave times those of means, and there are 4^octave times fewer of them.
        energies.append(energy / 4 ** (octave + 1))
    finest, _, third = energies
    if third == 0:
        return np.inf
    return float(np.sqrt(finest / third))


def fingerprint(patch: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return a patch's fingerprint: the changes of luminance between neighbouring cells of an 8 x 8 grid.

    The difference of two patches is 1 - a b / `FINGERPRINT_NORM`^2, one minus the correlation of their fingerprints. It
    is 0 if only brightness or contrast differ, about 0.01 after strong JPEG, and about 1 for unrelated patches.

    The patch is (P, P, 3) uint8 with P of 16 or more. Its fingerprint is (112,) float32 of whole numbers, whose
    products and sums are exact in any order.
    """
    sizes = np.diff(_cell_edges(len(patch)))
    means = np.rint(_cell_sums(_luminance(patch), np.int64) / np.multiply.outer(sizes, sizes))
    changes = np.concatenate([np.diff(means, axis=axis).ravel() for axis in (0, 1)])
    length = np.sqrt(np.square(changes).sum())
    rounded: NDArray[np.float32] = np.rint(changes * (FINGERPRINT_NORM / max(length, 1.0))).astype(np.float32)
    return rounded


class DuplicateFinder:
    """Finds crops that differ less than ``min_difference`` from an earlier crop; see `fingerprint`."""

    def __init__(self, min_difference: float) -> None:
        self._least_alike = (1 - min_difference) * FINGERPRINT_NORM**2
        self._fingerprints = np.empty((0, 2 * _GRID_CELLS * (_GRID_CELLS - 1)), np.float32)

    def find(self, patches: Sequence[NDArray[np.uint8]]) -> list[int]:
        """Return the indices of the duplicates among the crops of an image.

        A crop is a duplicate if it looks like an earlier crop of this image, or of an image given before.
        """
        if not patches:
            return []
        fingerprints = np.array([fingerprint(patch) for patch in patches])
        known = (fingerprints @ self._fingerprints.T > self._least_alike).any(axis=1)
        alike = fingerprints @ fingerprints.T > self._least_alike
        unique = list[int]()
        for number in np.flatnonzero(~known).tolist():
            if not alike[number, unique].any():
                unique.append(number)
        self._fingerprints = np.concatenate([self._fingerprints, fingerprints[unique]])
        return [number for number in range(len(patches)) if number not in unique]


def _luminance(image: NDArray[np.uint8]) -> NDArray[np.int32]:
    """Return the luminance (H, W) of (H, W, 3) RGB, or of (H, W) grey, in thousandths of a level."""
    if image.ndim == 2:
        return image.astype(np.int32) * sum(LUMINANCE)
    red, green, blue = (image[..., channel].astype(np.int32) * part for channel, part in enumerate(LUMINANCE))
    return red + green + blue


def _cell_sums(values: NDArray[Any], dtype: type[np.number[Any]]) -> NDArray[Any]:
    """Return the sums of values (H, W) over the cells."""
    rows, columns = (_cell_edges(extent)[:-1] for extent in values.shape)
    sums: NDArray[Any] = np.add.reduceat(np.add.reduceat(values, rows, axis=0, dtype=dtype), columns, axis=1)
    return sums


def _cell_edges(extent: int) -> NDArray[np.int64]:
    """Return the first pixel of each cell along a side, and the side's length."""
    cells = max(1, min(_GRID_CELLS, extent // 2))
    return np.arange(cells + 1, dtype=np.int64) * extent // cells
