"""Vectors of one image compared with those of another at the same points, and masks with what is expected of them."""

from dataclasses import dataclass
from functools import reduce
from math import sqrt
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.channels import OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.judge.findings import Verdict, format_vector

Floats = NDArray[np.floating]
Where = NDArray[np.bool_]
_Value = TypeVar("_Value", bound=np.generic)

# Bounds; docs/verify.md has them.
_OUTSIDE_PX, _OUTSIDE_SHARE = 0.2, 0.02
_MEDIAN_PX = 0.01
_MASK_SHARE, _CLASS_SHARE = 0.005, 0.05
SEEN_PX = 0.05
"""Difference between a vector and its reference, px, below which both views see the same point."""
SMOOTH_PX = 0.25
"""Second difference, px, below which a pixel and its neighbours are one surface."""
MIN_PIXELS = 200
"""Least number of pixels for a median or a correlation."""
UNCERTAIN = 1
"""Value of an expected mask where any value of the judged mask may be right."""
# A pixel and its eight neighbours see the same thin object, so that either all of them are wrong or none.
_TOGETHER = 9
_DEVIATIONS = 5.0
# Enough pixels for shares and medians; more would only take longer.
_MAX_PIXELS = 200_000


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """N pixels of an image, and their corresponding points in another image.

    Attributes:
        row: (N,), row of each pixel.
        column: (N,), column of each pixel.
        x: (N,) px, the point's position along the other image's rows.
        y: (N,) px, the point's position along the other image's columns.
        on_rows: whether each point lies on the row of its pixel, so that no interpolation between rows is needed.
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    on_rows: bool = False

    def of(self, array: NDArray[_Value]) -> NDArray[_Value]:
        """Return an array's values (N, ...) at the pixels."""
        return array[self.row, self.column]

    def select(self, which: NDArray[np.bool_ | np.intp]) -> "Points":
        """Return the points of some pixels, given as a mask (N,) bool or as indices."""
        return Points(self.row[which], self.column[which], self.x[which], self.y[which], self.on_rows)

    def corners(self, array: Floats) -> Floats:
        """Return the other image's array (H, W, C) in the two or four pixels around the points, (2 or 4, N, C)."""
        left, top = np.floor(self.x).astype(np.int64), np.floor(self.y).astype(np.int64)
        right, bottom = (np.minimum(at + 1, size - 1) for at, size in ((left, array.shape[1]), (top, array.shape[0])))
        rows = [self.row] if self.on_rows else [top, bottom]
        return np.stack([array[row, column] for row in rows for column in (left, right)])

    def between(self, corners: Floats) -> Floats:
        """Return what bilinear interpolation makes of `corners` at the points, (N, C)."""
        across, down = (self.x - np.floor(self.x))[:, None], (self.y - np.floor(self.y))[:, None]
        above, *below = corners[::2] * (1 - across) + corners[1::2] * across
        return np.asarray(above * (1 - down) + below[0] * down if below else above)


def follow(vectors: Floats, *surfaces: Floats, on_rows: bool = False) -> Points:
    """Return pixels, and the points of the other image to which vectors (H, W, 2) px lead.

    A pixel is taken where its point lies in the image, and its neighbours are on the same surface, by their vectors and
    by ``surfaces`` (H, W, C) px. At most 200,000 pixels are taken, evenly spread.
    """
    height, width = vectors.shape[:2]
    followed = all_components(np.isfinite(vectors))
    for values in (vectors, *surfaces):
        followed &= is_smooth(values)
    x, y = ends(np.where(followed[..., None], vectors, 0))
    followed &= (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    chosen = np.flatnonzero(followed)
    row, column = np.divmod(chosen[:: max(1, -(-len(chosen) // _MAX_PIXELS))], width)
    return Points(row, column, x[row, column], y[row, column], on_rows)


class Agreement:
    """Compares the vectors of an image's pixels with references: another image's vectors, interpolated at the points.

    Args:
        names: for messages, the name of the judged array, and the name of the reference with its place.
        own: (H, W, C) px, the array to judge.
        corners: (2 or 4, N, C) px, the other image's vectors around the points; see `Points.corners`.
        points: the N pixels to compare, and their points in the other image.
        error_px: largest difference that the encodings cause.

    Attributes:
        vectors: (N, C) px, the vectors of the pixels.
        references: (N, C) px, interpolated between the corners.
    """

    def __init__(self, names: tuple[str, str], own: Floats, corners: Floats, points: Points, error_px: float) -> None:
        self.vectors = own[points.row, points.column]
        self.references = points.between(corners)
        self.corners, self.error_px = corners, error_px
        self._names, self._points = names, points

    @property
    def known(self) -> Where:
        """Where both vector and reference are finite, (N,) bool."""
        return all_components(np.isfinite(self.vectors) & np.isfinite(self.references))

    @property
    def close(self) -> Where:
        """Where the vectors around the point differ by less than 1 px, as on one surface, (N,) bool."""
        return all_components(np.ptp(self.corners, axis=0) < 1)

    @property
    def agree(self) -> Where:
        """Where the vector is so near its reference that both images see the same point, (N,) bool."""
        return all_components(np.abs(self.vectors - self.references) < SEEN_PX + self.error_px)

    def check(self, check: str, measure: str, judged: Where, surface: Where, verdict: Verdict) -> None:
        """Judge the vectors by the share of outliers, and by the median size of the difference.

        An outlier is a vector outside the range of the vectors around its point, or a vector whose reference is
        unknown.

        Args:
            check: name of the check in findings.
            measure: beginning of the measures' names.
            judged: (N,) bool, the pixels to judge.
            surface: (N,) bool, where pixel and point lie on one surface; only these judged pixels enter the median.
            verdict: gets the findings and measures.
        """
        if not judged.any():
            return
        name, reference_name = self._names
        bound = _OUTSIDE_PX + self.error_px
        beyond = np.maximum(self.corners.min(axis=0) - self.vectors, self.vectors - self.corners.max(axis=0))
        outlier = judged & ~all_components(beyond <= bound)
        share, most = float(outlier.sum() / judged.sum()), most_share(_OUTSIDE_SHARE, int(judged.sum()))
        verdict.measures[f"{measure}_outside_share"] = share
        if share > most:
            first = np.argmax(outlier)
            verdict.add(
                check,
                f"{name}: {share:.2%} of {judged.sum()} visible pixels differ by more than {bound:.3g} px from "
                f"{reference_name}, at most {most:.2%} may; the first, at ({self._points.column[first]}, "
                f"{self._points.row[first]}), has {format_vector(self.vectors[first])} px instead of "
                f"{format_vector(self.references[first])} px",
            )
        surface = judged & surface
        if surface.sum() < MIN_PIXELS:
            return
        median = float(np.median(np.abs(self.vectors[surface] - self.references[surface]), axis=0).max())
        verdict.measures[f"{measure}_median_px"] = median
        bound = _MEDIAN_PX + self.error_px
        if not median <= bound:
            verdict.add(
                check,
                f"{name} differs from {reference_name} by {median:.3g} px in the median of {surface.sum()} pixels; at "
                f"most {bound:.3g} px may be",
            )


def check_mask_values(check: str, name: str, mask: NDArray[np.uint8], verdict: Verdict) -> None:
    """Check that a mask of any shape has only the values 0, 128 and 255."""
    values = np.unique(mask)
    strange = values[~np.isin(values, (OUTSIDE, OCCLUDED, VISIBLE))]
    if strange.size:
        verdict.add(check, f"{name}: expected the values 0, 128 and 255, got {', '.join(map(str, strange[:5]))}")


def check_mask_agreement(
    check: str, name: str, mask: NDArray[np.uint8], expected: NDArray[np.uint8], source: str, verdict: Verdict
) -> None:
    """Judge a mask by the share of its pixels that differ from the expected mask of the same shape.

    Each class (outside, occluded, visible) is judged by itself too: most pixels are visible, so a mask of another pair
    may agree overall. Pixels where `UNCERTAIN` is expected are not judged.

    Args:
        check: name of the check in findings.
        name: the mask's name in findings; its first word begins the measure's name.
        mask: the mask to judge.
        expected: the expected mask.
        source: for messages, what the expected mask was worked out from.
        verdict: gets the findings and the measure.
    """
    certain = expected != UNCERTAIN
    wrong = certain & (mask != expected)
    verdict.measures[f"{name.split(maxsplit=1)[0]}_disagree_share"] = float(wrong.sum() / max(certain.sum(), 1))
    classes = (("outside", OUTSIDE), ("occluded", OCCLUDED), ("visible", VISIBLE))
    judged = [("certain", certain, _MASK_SHARE), *((label, expected == each, _CLASS_SHARE) for label, each in classes)]
    for label, where, limit in judged:
        pixels = max(int(where.sum()), 1)
        share, most = float((wrong & where).sum() / pixels), most_share(limit, pixels)
        if share > most:
            fault = f"{share:.2%} of {pixels} {label} pixels disagree with {source}; at most {most:.2%} may"
            verdict.add(check, f"{name}: {fault}")
            return


def most_share(limit: float, pixels: int) -> float:
    """Return the largest share of ``pixels`` pixels that may be wrong: the limit, and a margin for chance.

    The fewer the pixels, the larger the margin: with a limit of 5 %, all of eleven pixels may be wrong.
    """
    return limit + _DEVIATIONS * sqrt(limit * (1 - limit) * _TOGETHER / pixels)


def is_smooth(values: Floats) -> Where:
    """Return where a pixel and its neighbours in row and column are one surface, by (H, W, C) px, (H, W) bool."""
    smooth = np.zeros(values.shape[:2], bool)
    inner = smooth[1:-1, 1:-1]
    inner[...] = True
    for channel in np.moveaxis(values, 2, 0):
        inner &= np.abs(np.diff(channel[1:-1], 2, axis=1)) < SMOOTH_PX
        inner &= np.abs(np.diff(channel[:, 1:-1], 2, axis=0)) < SMOOTH_PX
    return smooth


def ends(vectors: Floats) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return x and y, (H, W) float64 px each, of the other image's points to which vectors (H, W, 2) px lead."""
    height, width = vectors.shape[:2]
    along, down = np.moveaxis(vectors.astype(np.float64), 2, 0)
    return np.arange(width) + along, np.arange(height)[:, None] + down


def inside_px(vectors: Floats) -> NDArray[np.float64]:
    """Return how far the ends of vectors (H, W, 2) px lie inside the image, (H, W) float64 px; negative outside.

    The image's border is half a pixel beyond the centres of its outer pixels.
    """
    height, width = vectors.shape[:2]
    x, y = ends(vectors)
    nearest: NDArray[np.float64] = np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y))
    return nearest + 0.5


def all_components(where: Where) -> Where:
    """Return where all C components of (..., C) bool are True, (...); numpy's `all` is slow over a short axis."""
    return reduce(np.logical_and, np.moveaxis(where, -1, 0))


def dot(first: Floats, second: Floats) -> NDArray[np.float64]:
    """Return the dot products (...) float64 of vectors (..., C)."""
    products = (first[..., k].astype(np.float64) * second[..., k] for k in range(first.shape[-1]))
    return reduce(np.add, products)
