"""Crops: squares cut out of an image and reduced to patches, their measures, and the duplicates among them."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from semisynth_gl.inputs.errors import InputError

FINGERPRINT_NORM = 1000
"""Euclidean length of a fingerprint, up to rounding."""

LUMINANCE = (299, 587, 114)
"""Thousandths of red, green and blue in luminance, by ITU-R BT.601."""
LUMINANCE_PARTS = np.array(LUMINANCE) / 1000
"""The weights of `LUMINANCE` as parts of 1, (3,) float64."""

# `least_texture` samples every second pixel of every second row; `surely_has_texture` every fourth of these pixels.
_EVERY, _PART = 2, 4

# First pixel and size of each cell along a side.
_Cells = tuple[NDArray[np.int64], NDArray[np.int64]]
# The cells of rows, then of columns.
_Grid = Sequence[_Cells]

# Cells along each side of a patch in which texture and fingerprints are measured.
_GRID_CELLS = 8
_FINGERPRINT_LENGTH = 2 * _GRID_CELLS * (_GRID_CELLS - 1)


class CropBox(NamedTuple):
    """A square of an upright image: column and row of its upper left pixel, and its side."""

    left_px: int
    top_px: int
    side_px: int


class Square(NamedTuple):
    """A `CropBox` of a named image.

    ``source`` is the image's path relative to the folder that all images share, or the name of a picture. For a clip it
    is the path of the first frame.
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
    """Return squares that cover an image once for each scale, by increasing side, then by row and column.

    A scale s is a number of image pixels per patch pixel: the side is round(s * patch_px). It is at least 1, since
    crops are reduced, never enlarged. Along each axis there are as few squares as cover the image; they are spread
    evenly from border to border and overlap where they must. A scale whose square does not fit gives no squares.
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
    """Cut a square out of an image (H, W, 3) uint8, as a patch (patch_px, patch_px, 3) uint8 with its own memory.

    A square of ``patch_px`` is copied bit for bit. A larger square is averaged over areas: for whole factors each patch
    pixel is the mean of its factor x factor image pixels, rounded; for other factors, image pixels on the border
    between two patch pixels count in both.

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
    # Pillow's reduce is off by one level in some pixels, for factors other than powers of two.
    # Rows and columns are added one by one, since numpy's sums over such short axes take four times as long.
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
    Because of the median, half of the patch must have texture: one strong edge across a blank wall counts for little,
    and slow shading counts only as far as it changes within a cell. Patches below 16 pixels have fewer cells, of 2
    pixels or more. The measure runs from 0, where half of the cells are each of one colour, to 127.5.

    The patch is an image of any size, (H, W, 3) RGB or (H, W) grey.
    """
    grid = [_cells(extent) for extent in patch.shape[:2]]
    return _median_contrast(_squares(_luminance(patch), grid), grid)


def least_texture(images: Iterable[NDArray[np.uint8]]) -> float:
    """Return the `texture_measure` of the flattest of several images, from every second pixel of every second row.

    This is faster, and still measures texture as fine as a pixel.
    """
    return min(texture_measure(np.ascontiguousarray(image[::_EVERY, ::_EVERY])) for image in images)


def surely_has_texture(images: Iterable[NDArray[np.uint8]], least: float) -> bool:
    """Return True where a sample proves that `least_texture` is not below a limit; False proves nothing.

    The sample is a sixteenth of the pixels that `least_texture` takes. The sum of squares of a cell's sampled pixels
    about their own mean is never larger than that of all its pixels about theirs, so it gives a lower bound.
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
    # Lowered by more than the rounding errors of both measures.
    return _median_contrast(squares, grid) * (1 - 1e-9)


def sharpness_measure(patch: NDArray[np.uint8]) -> float:
    """Return how sharp a patch is: the contrast of its finest octave against that of the third.

    The contrast of octave k is the root of the mean square that luminance loses when the means over squares with sides
    of 2^(k - 1) pixels are averaged by 2 x 2 once more (a Haar decomposition). Photographs have about the same contrast
    in each octave, a little less in the finest. A blur lowers the finest octave first, whatever the overall contrast.

    The measure is 0.25 for a smooth patch such as a gradient; 0.26 to 0.33 after a Gaussian blur of 2 pixels; 0.34 to
    1.5 for sharp photographs; 4 for white noise; infinite where the third octave has no contrast. The patch is (P, P,
    3) uint8 with P of 8 or more; rows and columns beyond the last multiple of 8 do not count.
    """
    rows, columns = (extent // 8 * 8 for extent in patch.shape[:2])
    # In whole numbers throughout, so that the measure is the same on every machine.
    sums = _luminance(patch[:rows, :columns]).astype(np.int64)
    energies = []
    for octave in range(3):
        finer, pairs = sums, sums[::2] + sums[1::2]
        sums = pairs[:, ::2] + pairs[:, 1::2]
        energy = 4 * int(np.square(finer).sum()) - int(np.square(sums).sum())
        # The sums have 16^octave times the energy of means, and are 4^octave times fewer.
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

    The patch is (P, P, 3) uint8 with P of 16 or more. Its fingerprint is (112,) float32 of whole numbers, whose
    products and sums are exact in any order.
    """
    grid = [_cells(extent) for extent in patch.shape[:2]]
    means = np.rint(_sums(_luminance(patch), grid, np.int64) / _counts(grid))
    changes = np.concatenate([np.diff(means, axis=axis).ravel() for axis in (0, 1)])
    length = np.sqrt(np.square(changes).sum())
    rounded: NDArray[np.float32] = np.rint(changes * (FINGERPRINT_NORM / max(length, 1.0))).astype(np.float32)
    return rounded


class DuplicateFinder:
    """Finds crops that look like an earlier crop: the same photograph twice, or two frames of a burst.

    Crops that differ less than ``min_difference`` are duplicates; see `fingerprint`.
    """

    def __init__(self, min_difference: float) -> None:
        self._least_alike = (1 - min_difference) * FINGERPRINT_NORM**2
        self._fingerprints = np.empty((0, _FINGERPRINT_LENGTH), np.float32)
        self._squares: list[Square] = []

    def find(self, squares: Sequence[Square], fingerprints: NDArray[np.float32]) -> dict[Square, Square]:
        """Return the duplicates among N crops of an image, each with the crop that it looks most like.

        Of two crops that look alike, the second is the duplicate; crops of later images are compared with the first.
        Where ``fingerprints``, (N, 112), is empty, nothing is compared.
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
    # The sums are whole numbers, so that a flat cell has a deviation of exactly zero.
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
