"""Statistics shared by several checks: vectors against their references, and masks against expected masks."""

from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.frame import OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.verification.shares import most_share
from semisynth_gl.verification.verdict import Verdict, format_vector

Floats = NDArray[np.floating]
Where = NDArray[np.bool_]

# Bounds; docs/verify.md derives them.
_OUTSIDE_PX = 0.2
_OUTSIDE_SHARE = 0.02
_MEDIAN_PX = 0.01
_MEDIAN_SHARE = 0.002
_MASK_SHARE = 0.005
_CLASS_SHARE = 0.05
MIN_PIXELS = 200
"""Below this number of pixels a median or a fit says nothing."""
UNCERTAIN = 1
"""The value of an expected mask where either value of the mask may be right."""


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """The points of another image that correspond to N pixels of an image.

    Attributes:
        row: (N,) int64, of the pixels.
        column: (N,) int64, of the pixels.
        x: (N,) float64 px, of the points.
        y: (N,) float64 px, of the points.
        on_rows: whether the points lie on the rows of their pixels.
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    on_rows: bool = False

    def select(self, which: NDArray[np.bool_ | np.intp]) -> "Points":
        """Return the pixels of a mask (N,) bool, or of indices."""
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
    """Vectors of an image's pixels against references: what another image's array has at the corresponding points.

    Args:
        names: of the array that is judged, and of its reference with the place, for messages.
        own: (H, W, C) px, the array of the image.
        corners: (2 or 4, N, C) px, the array of the other image around the points, as `Points.corners` gathers it.
        targets: N pixels and their points.
        error_px: the largest difference that encodings cause.
        scaled_from_px: shorter vectors are not judged by their relative difference.

    Attributes:
        vectors: (N, C) px, the image's array at the pixels.
        corners: as given.
        references: (N, C) px, the other image's array, interpolated at the points.
        error_px: as given.
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
        lefts, rights = self.corners[::2], self.corners[1::2]
        with np.errstate(invalid="ignore"):
            above, *below = lefts * (1 - across) + rights * across
            self.references: Floats = above * (1 - down) + below[0] * down if below else above

    @property
    def known(self) -> Where:
        """Where vectors and references are finite, (N,) bool."""
        return all_components(np.isfinite(self.vectors) & np.isfinite(self.references))

    @property
    def close(self) -> Where:
        """Where the pixels around the points have similar vectors, as on one surface, (N,) bool."""
        with np.errstate(invalid="ignore"):
            return all_components(np.ptp(self.corners, axis=0) < 1)

    def check(self, check: str, measure: str, judged: Where, surface: Where, verdict: Verdict) -> None:
        """Judge the vectors by the share of outliers, and by the median of the difference.

        Outliers lie outside the range of the pixels around the point. A constant error shifts the median difference, a
        wrong factor shifts the median of the relative difference.

        Args:
            check: the name of the check.
            measure: the first part of the measures' names.
            judged: (N,) bool, the pixels to judge; an unknown reference is an outlier.
            surface: (N,) bool, where pixel and point lie on one surface; medians are taken over these.
            verdict: takes findings and measures.
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
    """Check that a mask of any shape has the values 0, 128 and 255 alone."""
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
    """Judge a mask by the share of its pixels that are not as expected.

    Each class is judged by itself too: nearly everything is visible in most pairs, so the mask of another pair may be
    right nearly everywhere.

    Args:
        check: the name of the check.
        name: the mask's, for messages.
        measure: the first part of the measure's name.
        mask: uint8 of any shape.
        expected: uint8 of the same shape, `UNCERTAIN` where the mask is not judged.
        source: the arrays that ``expected`` follows from, for messages.
        verdict: takes findings and measures.
    """
    certain = expected != UNCERTAIN
    wrong = certain & (mask != expected)
    verdict.measures[f"{measure}_disagree_share"] = float(wrong.sum() / max(certain.sum(), 1))
    classes = {"outside": OUTSIDE, "occluded": OCCLUDED, "visible": VISIBLE}
    judged = {"certain": (certain, _MASK_SHARE)} | {
        label: (expected == value, _CLASS_SHARE) for label, value in classes.items()
    }
    for label, (where, limit) in judged.items():
        pixels = int(where.sum())
        if not pixels:
            continue
        share, most = float((wrong & where).sum() / pixels), most_share(limit, pixels)
        if share > most:
            verdict.add(
                check,
                f"{name}: {share:.2%} of {pixels} {label} pixels disagree with {source}; at most {most:.2%} may",
            )
            return


def spread_evenly(indices: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """Return at most ``most`` of the indices (N,), evenly spread over all."""
    return indices[:: max(1, -(-len(indices) // most))]


def all_components(where: Where) -> Where:
    """Return where all components of (..., C) bool are set, (...); numpy's `all` is slow over so short an axis."""
    return reduce(np.logical_and, np.moveaxis(where, -1, 0))


def dot(first: Floats, second: Floats) -> NDArray[np.float64]:
    """Return the dot products of vectors (..., C), (...) float64."""
    products = (first[..., k].astype(np.float64) * second[..., k] for k in range(first.shape[-1]))
    return reduce(np.add, products)
