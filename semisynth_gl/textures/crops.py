"""Crops: squares of an image, cut and reduced to patches, their measures, and the duplicates among them."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from semisynth_gl.inputs.errors import InputError

FINGERPRINT_NORM = 1000
"""Length of a fingerprint, up to rounding."""

LUMINANCE = (299, 587, 114)
"""Thousandths of red, green and blue in luminance, by ITU-R BT.601."""
LUMINANCE_PARTS = np.array(LUMINANCE) / 1000
"""The same as parts, (3,) float64."""

# `least_texture` looks at every second pixel of every second row, and the proof at every fourth of these.
_EVERY, _PART = 2, 4

# First pixel and size of each cell along a side.
_Cells = tuple[NDArray[np.int64], NDArray[np.int64]]
# The cells of rows, then of columns.
_Grid = Sequence[_Cells]

# Cells along each side of a patch in which texture and fingerprints are measured.
_GRID_CELLS = 8
_FINGERPRINT_LENGTH = 2 * _GRID_CELLS * (_GRID_CELLS - 1)


class CropBox(NamedTuple):
    """A square of an upright image, from the column and the row of its first pixel on."""

    left_px: int
    top_px: int
    side_px: int


class Square(NamedTuple):
    """A `CropBox` of a named image.

    The ``source`` is the image's path relative to the folder that all images share; of an image sequence, of its first
    frame.
    """

    source: str
    left_px: int
    top_px: int
    side_px: int

    @property
    def box(self) -> CropBox:
        """The square without the name of its image."""
        return CropBox(*self[1:])


def crop_boxes(height: int, width: int, patch_px: int, scales: Sequence[float]) -> list[CropBox]:
    """Return squares that together cover an image, once for each scale, by increasing side, then by row and column.

    At scale s, of image pixels per patch pixel, the side is round(s * patch_px); s is at least 1, since crops are
    reduced, never enlarged. Along each axis stand as few squares as cover it, evenly spread from border to border,
    overlapping as much as that needs. A scale whose square does not fit gives none.
    """
    return [
        CropBox(left, top, side)
        for side in sorted({round(scale * patch_px) for scale in scales})
        if side <= min(height, width)
        for top in _positions(height, side)
        for left in _positions(width, side)
    ]


def _positions(extent: int, side: int) -> list[int]:
    count = -(-extent // side)
    gaps = max(count - 1, 1)
    # In whole numbers, so that the last square ends exactly at the border and neighbours never leave a gap.
    return [(i * (extent - side) + gaps // 2) // gaps for i in range(count)]


def cut_crop(image: NDArray[np.uint8], box: CropBox, patch_px: int) -> NDArray[np.uint8]:
    """Cut a square out of an image (H, W, 3), as a patch (patch_px, patch_px, 3) with its own memory.

    A square of ``patch_px`` is copied bit for bit. A larger one is averaged over areas: for whole factors each patch
    pixel is the mean of its factor x factor image pixels, rounded; for other factors, image pixels on the border
    between two patch pixels have a part in both.

    Raises:
        InputError: where the box leaves the image or is smaller than a patch.
    """
    left, top, side = box
    height, width = image.shape[:2]
    if not (0 <= left <= width - side and 0 <= top <= height - side):
        raise InputError(f"a crop must lie inside its image of {width} x {height} pixels, got {box}")
    if side < patch_px:
        raise InputError(f"a crop must have at least {patch_px} pixels along a side, got {side}: none is enlarged")
    square = image[top : top + side, left : left + side]
    if side == patch_px:
        return square.copy()
    factor, rest = divmod(side, patch_px)
    if rest:
        return np.array(Image.fromarray(square).resize((patch_px, patch_px), Image.Resampling.BOX))
    # Not Pillow's reduce: for factors other than powers of two it is off by one level in some pixels.
    # One addition for each row and column of a patch pixel: numpy's sums over such short axes take four times as long.
    rows = square[::factor].astype(np.uint32)
    for row in range(1, factor):
        rows += square[row::factor]
    sums = rows[:, ::factor].copy()
    for column in range(1, factor):
        sums += rows[:, column::factor]
    means: NDArray[np.uint8] = ((2 * sums + factor**2) // (2 * factor**2)).astype(np.uint8)
    return means


def texture_measure(patch: NDArray[np.uint8]) -> float:
    """Return how much texture a patch has: the median over a grid of 8 x 8 cells of the contrast in a cell.

    The contrast of a cell is the standard deviation of its luminance (0.299 R + 0.587 G + 0.114 B) in 8-bit levels.
    The median makes it a statement about half of the patch: one strong edge across a blank wall does not count for
    much, and slow shading only as far as it changes within a cell. Patches below 16 pixels have fewer cells, of 2
    pixels or more. The measure goes from 0, every pixel equal in half of the cells, to 127.5.

    The patch is (H, W, 3) RGB or (H, W) grey, and may be an image of any shape.
    """
    grid = [_cells(extent) for extent in patch.shape[:2]]
    return _median_contrast(_squares(_luminance(patch), grid), grid)


def least_texture(images: Iterable[NDArray[np.uint8]]) -> float:
    """Return the `texture_measure` of the flattest of several images, by every second pixel of every second row.

    That takes a share of the time, and shows texture of a pixel's size, too.
    """
    return min(texture_measure(np.ascontiguousarray(image[::_EVERY, ::_EVERY])) for image in images)


def surely_has_texture(images: Iterable[NDArray[np.uint8]], least: float) -> bool:
    """Return True where a sixteenth of the pixels proves that `least_texture` is not below a limit; False says nothing.

    About its own mean, a part of a cell's pixels has at most the sum of squares that all of them have about theirs.
    """
    return all(_texture_bound(image) >= least for image in images)


def _texture_bound(image: NDArray[np.uint8]) -> float:
    """Return a lower bound of an image's `least_texture`; 0 where the image is too small for one."""
    grid = [_cells(-(-extent // _EVERY)) for extent in image.shape[:2]]
    ends = [-(-np.append(starts, starts[-1] + sizes[-1]) // _PART) for starts, sizes in grid]
    parts = [(end[:-1], np.diff(end)) for end in ends]
    if any(sizes.min() == 0 for _, sizes in parts):
        return 0.0
    step = _EVERY * _PART
    squares = _squares(_luminance(np.ascontiguousarray(image[::step, ::step])), parts)
    # Less what both measures may round.
    return _median_contrast(squares, grid) * (1 - 1e-9)


def sharpness_measure(patch: NDArray[np.uint8]) -> float:
    """Return how sharp a patch is: the contrast of its finest octave against that of the third.

    The contrast of octave k is the root of the mean square that luminance loses where the means over squares of
    2^(k - 1) pixels are averaged by 2 x 2 once more (a Haar decomposition). Photographs have about the same contrast in
    each octave, a little less in the finest; a blur takes the finest away first, whatever the contrast of the whole.

    It is 0.25 for a smooth patch such as a gradient; 0.26 to 0.33 after a Gaussian blur of 2 pixels; 0.34 to 1.5 for
    sharp photographs; 4 for white noise; infinite where the third octave has no contrast that could be blurred. The
    patch is (P, P, 3), P at least 8; rows and columns beyond the last multiple of 8 do not count.
    """
    rows, columns = (extent // 8 * 8 for extent in patch.shape[:2])
    # Whole numbers all through, so that the measure is the same on every machine.
    sums = _luminance(patch[:rows, :columns]).astype(np.int64)
    energies = []
    for octave in range(3):
        finer, pairs = sums, sums[::2] + sums[1::2]
        sums = pairs[:, ::2] + pairs[:, 1::2]
        energy = 4 * int(np.square(finer).sum()) - int(np.square(sums).sum())
        # Sums have 16^octave times the energy of means, and there are 4^octave times fewer of them.
        energies.append(energy / 4 ** (octave + 1))
    finest, _, third = energies
    if third == 0:
        return np.inf
    return float(np.sqrt(finest / third))


def fingerprint(patch: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the changes of luminance between neighbouring cells of an 8 x 8 grid, which near-identical patches share.

    The difference of two patches is 1 - a b / `FINGERPRINT_NORM`^2, one minus the correlation of these changes: 0 for
    equal patches, also where brightness or contrast differ, about 0.01 for a patch compressed hard by JPEG or shifted
    by a pixel of 128, rarely below 0.1 for squares of different photographs, and about 1 for unrelated ones.

    A patch (P, P, 3), P at least 16, has (112,) float32. They are whole numbers, so that their products and sums are
    exact in any order.
    """
    grid = [_cells(extent) for extent in patch.shape[:2]]
    means = np.rint(_sums(_luminance(patch), grid, np.int64) / _counts(grid))
    changes = np.concatenate([np.diff(means, axis=axis).ravel() for axis in (0, 1)])
    length = np.sqrt(np.square(changes).sum())
    rounded: NDArray[np.float32] = np.rint(changes * (FINGERPRINT_NORM / max(length, 1.0))).astype(np.float32)
    return rounded


class DuplicateFinder:
    """Finds crops that look like an earlier one: the same photograph twice, or two frames of a burst.

    Crops that differ less than ``min_difference`` are duplicates; see `fingerprint`.
    """

    def __init__(self, min_difference: float) -> None:
        self._least_alike = (1 - min_difference) * FINGERPRINT_NORM**2
        self._fingerprints = np.empty((0, _FINGERPRINT_LENGTH), np.float32)
        self._squares: list[Square] = []

    def find(self, squares: Sequence[Square], fingerprints: NDArray[np.float32]) -> dict[Square, Square]:
        """Return the duplicates among N crops of an image, each with the crop that it looks most like.

        The first of two that look alike is no duplicate, and crops of later images are compared with it. Where the
        ``fingerprints``, (N, 112), are empty, nothing is compared.
        """
        if not fingerprints.size:
            return {}
        known = len(self._squares)
        if known + len(squares) > len(self._fingerprints):
            # Room is doubled: growing by the crops of each image would copy all rows for every image.
            room = np.empty((known + len(squares), _FINGERPRINT_LENGTH), np.float32)
            self._fingerprints = np.concatenate([self._fingerprints[:known], room])
        to_earlier, to_own = fingerprints @ self._fingerprints[:known].T, fingerprints @ fingerprints.T
        duplicates: dict[Square, Square] = {}
        fresh: list[int] = []
        for row, square in enumerate(squares):
            earlier, own = to_earlier[row].max(initial=-np.inf), to_own[row, fresh].max(initial=-np.inf)
            if max(earlier, own) <= self._least_alike:
                fresh.append(row)
            elif earlier >= own:
                duplicates[square] = self._squares[int(to_earlier[row].argmax())]
            else:
                duplicates[square] = squares[fresh[int(to_own[row, fresh].argmax())]]
        self._fingerprints[known : known + len(fresh)] = fingerprints[fresh]
        self._squares += [squares[row] for row in fresh]
        return duplicates


def _luminance(image: NDArray[np.uint8]) -> NDArray[np.int32]:
    """Return the luminance (H, W) of (H, W, 3) RGB, or of (H, W) grey, in thousandths of a level."""
    if image.ndim == 2:
        return image.astype(np.int32) * sum(LUMINANCE)
    red, green, blue = (image[..., channel].astype(np.int32) * part for channel, part in enumerate(LUMINANCE))
    return red + green + blue


def _squares(luminance: NDArray[np.int32], grid: _Grid) -> NDArray[np.float64]:
    """Return the sum of squares of (H, W) luminance about the mean of each cell."""
    (_, heights), (_, widths) = grid
    # Whole numbers up to the mean, so that a flat cell has a deviation of exactly zero.
    means = (_sums(luminance, grid, np.int64) / _counts(grid)).repeat(heights, axis=0).repeat(widths, axis=1)
    return _sums(np.square(luminance - means), grid, np.float64)


def _median_contrast(squares: NDArray[np.float64], grid: _Grid) -> float:
    """Return the median over cells of the standard deviation in 8-bit levels, from the sums of squares of each cell."""
    return float(np.median(np.sqrt(squares / _counts(grid)))) / 1000.0


def _sums(values: NDArray[Any], grid: _Grid, dtype: type[np.number[Any]]) -> NDArray[Any]:
    (rows, _), (columns, _) = grid
    sums: NDArray[Any] = np.add.reduceat(np.add.reduceat(values, rows, axis=0, dtype=dtype), columns, axis=1)
    return sums


def _counts(grid: _Grid) -> NDArray[np.int64]:
    """Return the number of pixels of each cell."""
    (_, heights), (_, widths) = grid
    return np.multiply.outer(heights, widths)


def _cells(extent: int) -> _Cells:
    """Return the first pixel and the size of each cell along a side."""
    cells = max(1, min(_GRID_CELLS, extent // 2))
    starts = np.arange(cells, dtype=np.int64) * extent // cells
    return starts, np.diff(np.append(starts, extent))
