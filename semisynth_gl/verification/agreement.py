"""Statistics shared by several checks: vectors compared with references, and masks compared with expected masks."""

from dataclasses import dataclass
from functools import reduce
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.channels import OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.verification.verdict import Verdict, count_pixels, format_vector

Floats = NDArray[np.floating]
Where = NDArray[np.bool_]

# Bounds; docs/verify.md derives them.
_OUTSIDE_PX = 0.2
_OUTSIDE_SHARE = 0.02
_MEDIAN_PX = 0.01
_MEDIAN_SHARE = 0.002
_MASK_SHARE = 0.005
_CLASS_SHARE = 0.05
SEEN_PX = 0.05
"""Difference between a vector and its reference, px, below which both views see the same point."""
MIN_PIXELS = 200
"""Least number of pixels for a median or a fit; with fewer, it says nothing."""
UNCERTAIN = 1
"""Value of an expected mask where any value of the judged mask may be right."""
DEVIATIONS = 5.0
"""Bound in standard deviations that chance does not exceed, even in millions of pairs."""
# A pixel and its eight neighbours see the same thin object, so that either all of them are wrong or none.
_TOGETHER = 9


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

    def select(self, which: NDArray[np.bool_ | np.intp]) -> "Points":
        """Return the points of some pixels, given as a mask (N,) bool or as indices."""
        return Points(self.row[which], self.column[which], self.x[which], self.y[which], self.on_rows)

    def corners(self, array: Floats) -> Floats:
        """Return the other image's array (H, W, C) in the two or four pixels around the points, (2 or 4, N, C)."""
        left = np.floor(self.x).astype(np.int64)
        right = np.minimum(left + 1, array.shape[1] - 1)
        if self.on_rows:
            return np.stack([array[self.row, left], array[self.row, right]])
        top = np.floor(self.y).astype(np.int64)
        bottom = np.minimum(top + 1, array.shape[0] - 1)
        return np.stack([array[top, left], array[top, right], array[bottom, left], array[bottom, right]])


class Agreement:
    """Compares the vectors of an image's pixels with references: another image's vectors, interpolated at the points.

    Args:
        names: for messages, the name of the judged array, and the name of the reference with its place.
        own: (H, W, C) px, the array to judge.
        corners: (2 or 4, N, C) px, the other image's vectors around the points; see `Points.corners`.
        targets: the N pixels to compare, and their points in the other image.
        error_px: largest difference that the encodings cause.
        scaled_from_px: least length of a vector whose relative difference is judged.

    Attributes:
        vectors: (N, C) px, the vectors of the pixels.
        references: (N, C) px, interpolated between the corners.
    """

    def __init__(
        self,
        names: tuple[str, str],
        own: Floats,
        corners: Floats,
        targets: Points,
        error_px: float,
        scaled_from_px: float = 1.0,
    ) -> None:
        self.vectors = own[targets.row, targets.column]
        self.corners = corners
        self.error_px = error_px
        self._names, self._targets, self._scaled_from_px = names, targets, scaled_from_px
        across, down = (targets.x - np.floor(targets.x))[:, None], (targets.y - np.floor(targets.y))[:, None]
        above, *below = corners[::2] * (1 - across) + corners[1::2] * across
        self.references: Floats = above * (1 - down) + below[0] * down if below else above

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
        """Judge the vectors by the share of outliers, and by the median of the difference.

        An outlier is a vector outside the range of the vectors around its point, or a vector whose reference is
        unknown. A constant error shifts the median of the difference, a wrong factor the median of the relative
        difference.

        Args:
            check: name of the check in findings.
            measure: beginning of the measures' names.
            judged: (N,) bool, the pixels to judge.
            surface: (N,) bool, where pixel and point lie on one surface; only these judged pixels enter the medians.
            verdict: gets the findings and measures.
        """
        if not judged.any():
            return
        vectors, name, reference_name = self.vectors[judged], *self._names
        low, high = self.corners.min(axis=0)[judged], self.corners.max(axis=0)[judged]
        bound = _OUTSIDE_PX + self.error_px
        outlier = ~all_components(np.maximum(low - vectors, vectors - high) <= bound)
        share = float(outlier.mean())
        verdict.measures[f"{measure}_outside_share"] = share
        most = most_share(_OUTSIDE_SHARE, len(outlier))
        if share > most:
            first = np.flatnonzero(judged)[np.argmax(outlier)]
            verdict.add(
                check,
                f"{name}: {share:.2%} of {len(outlier)} visible pixels differ by more than {bound:.3g} px from "
                f"{reference_name}, at most {most:.2%} may; the first, at ({self._targets.column[first]}, "
                f"{self._targets.row[first]}), has {format_vector(self.vectors[first])} px instead of "
                f"{format_vector(self.references[first])} px",
            )
        surface = judged & surface
        if surface.sum() < MIN_PIXELS:
            return
        vectors = self.vectors[surface].astype(np.float64)
        difference = vectors - self.references[surface]
        median = np.array([np.median(component) for component in difference.T])
        squared = dot(vectors, vectors)
        scaled = squared >= self._scaled_from_px**2
        factor, factor_bound = 0.0, _MEDIAN_SHARE
        if scaled.sum() >= MIN_PIXELS:
            factor = float(np.median(dot(difference, vectors)[scaled] / squared[scaled]))
            factor_bound += self.error_px / float(np.sqrt(np.median(squared[scaled])))
        bound = _MEDIAN_PX + self.error_px
        verdict.measures[f"{measure}_median_px"] = float(np.abs(median).max())
        verdict.measures[f"{measure}_median_share"] = factor
        if np.abs(median).max() > bound or abs(factor) > factor_bound:
            verdict.add(
                check,
                f"{name} differs from {reference_name} by {format_vector(median)} px ({factor:+.3%}) in the median of "
                f"{len(difference)} pixels; at most {bound:.3g} px and {factor_bound:.2%} are allowed",
            )


def check_mask_values(check: str, name: str, mask: NDArray[np.uint8], verdict: Verdict) -> None:
    """Check that a mask of any shape has only the values 0, 128 and 255."""
    values = np.unique(mask)
    strange = values[~np.isin(values, (OUTSIDE, OCCLUDED, VISIBLE))]
    if strange.size:
        verdict.add(check, f"{name}: expected the values 0, 128 and 255, got {', '.join(map(str, strange[:5]))}")


def check_mask_agreement(
    check: str,
    name: str,
    measure: str,
    mask: NDArray[np.uint8],
    expected: NDArray[np.uint8],
    source: str,
    verdict: Verdict,
) -> None:
    """Judge a mask by the share of its pixels that differ from the expected mask of the same shape.

    Each class (outside, occluded, visible) is judged by itself too: nearly everything is visible in most pairs, so even
    the mask of another pair may be right nearly everywhere. Pixels where `UNCERTAIN` is expected are not judged.

    Args:
        check: name of the check in findings.
        name: the mask's name in findings.
        measure: beginning of the measure's name.
        mask: the mask to judge.
        expected: the expected mask.
        source: for messages, what the expected mask was worked out from.
        verdict: gets the findings and the measure.
    """
    certain = expected != UNCERTAIN
    wrong = certain & (mask != expected)
    verdict.measures[f"{measure}_disagree_share"] = float(wrong.sum() / max(certain.sum(), 1))
    classes = (("outside", OUTSIDE), ("occluded", OCCLUDED), ("visible", VISIBLE))
    judged = [("certain", certain, _MASK_SHARE), *((label, expected == each, _CLASS_SHARE) for label, each in classes)]
    for label, where, limit in judged:
        pixels = int(where.sum())
        share, most = float((wrong & where).sum() / max(pixels, 1)), most_share(limit, max(pixels, 1))
        if share > most:
            fault = f"{share:.2%} of {pixels} {label} pixels disagree with {source}; at most {most:.2%} may"
            verdict.add(check, f"{name}: {fault}")
            return


def check_visibility(
    name: str, mask: NDArray[np.uint8], valid: Where, expected: NDArray[np.uint8], verdict: Verdict
) -> None:
    """Check a view's mask (H, W): its values, 0 where ``valid`` is False, and agreement with the expected mask."""
    check_mask_values("mask", name, mask, verdict)
    invalid = ~valid & (mask != OUTSIDE)
    if invalid.any():
        verdict.add("mask", f"{name}: expected 0 without a disparity, got other values in {count_pixels(invalid)}")
    check_mask_agreement("mask", name, name, mask, expected, "the disparities", verdict)


def most_share(limit: float, pixels: int) -> float:
    """Return the largest share of ``pixels`` pixels that may be wrong: the limit, and a margin for chance.

    The fewer the pixels, the larger the margin: with a limit of 5 %, all of eleven pixels may be wrong.
    """
    return limit + DEVIATIONS * sqrt(limit * (1 - limit) * _TOGETHER / pixels)


def ends(vectors: Floats) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return x and y, (H, W) float64 px each, of the other image's points to which vectors (H, W, 2) px lead."""
    height, width = vectors.shape[:2]
    along, down = np.moveaxis(vectors.astype(np.float64), 2, 0)
    return np.arange(width) + along, np.arange(height)[:, None] + down


def inside_px(x: Floats, y: Floats) -> NDArray[np.float64]:
    """Return how far points lie inside an image of their own shape, (H, W) float64 px; negative outside.

    The image's border is half a pixel beyond the centres of its outer pixels.
    """
    height, width = x.shape
    nearest: NDArray[np.float64] = np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y))
    return nearest + 0.5


def spread_evenly(indices: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """Return at most ``most`` of the indices (N,), evenly spread over all of them."""
    return indices[:: max(1, -(-len(indices) // most))]


def all_components(where: Where) -> Where:
    """Return where all C components of (..., C) bool are True, (...); numpy's `all` is slow over a short axis."""
    return reduce(np.logical_and, np.moveaxis(where, -1, 0))


def dot(first: Floats, second: Floats) -> NDArray[np.float64]:
    """Return the dot products (...) float64 of vectors (..., C)."""
    products = (first[..., k].astype(np.float64) * second[..., k] for k in range(first.shape[-1]))
    return reduce(np.add, products)
