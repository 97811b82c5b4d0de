"""Statistics shared by several checks: vectors against their references, and masks against expected masks."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame import OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.verify.verdict import Verdict, format_vector

Floats = NDArray[np.floating]
Where = NDArray[np.bool_]

# Bounds; docs/verify.md derives them.
_OUTSIDE_PX = 0.2
_OUTSIDE_SHARE = 0.02
_MEDIAN_PX = 0.01
_MEDIAN_SHARE = 0.002
_MASK_SHARE = 0.01
_CLASS_SHARE = 0.05
MIN_PIXELS = 200
"""Below this number of pixels a share or a median says nothing."""
UNCERTAIN = 1
"""The value of an expected mask where either value of the mask may be right."""


@dataclass(frozen=True, slots=True, eq=False)
class Targets:
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

    def select(self, which: NDArray[np.bool_ | np.intp]) -> "Targets":
        """Return the pixels of a mask (N,) bool, or of indices."""
        return Targets(self.row[which], self.column[which], self.x[which], self.y[which], self.on_rows)

    def corners(self, array: Floats) -> Floats:
        """Return the other image's array (H, W, C) in the two or four pixels around the points, (2 or 4, N, C)."""
        left = np.floor(self.x).astype(np.int64)
        right = np.minimum(left + 1, array.shape[1] - 1)
        if self.on_rows:
            return np.stack([array[self.row, left], array[self.row, right]])
        top = np.floor(self.y).astype(np.int64)
        bottom = np.minimum(top + 1, array.shape[0] - 1)
        return np.stack([array[top, left], array[top, right], array[bottom, left], array[bottom, right]])

    def compare(self, name: str, own: Floats, reference_name: str, other: Floats, error_px: float) -> "Correspondences":
        """Compare the image's array (H, W, C) at the pixels with the other image's array (H, W, C) at the points."""
        corners = self.corners(other)
        across = (self.x - np.floor(self.x))[:, None]
        with np.errstate(invalid="ignore"):
            references = corners[0] * (1 - across) + corners[1] * across
            if not self.on_rows:
                down = (self.y - np.floor(self.y))[:, None]
                references = references * (1 - down) + (corners[2] * (1 - across) + corners[3] * across) * down
            one_surface = (np.ptp(corners, axis=0) < 1).all(axis=1)
        vectors, pixels = own[self.row, self.column], np.stack([self.column, self.row], axis=1)
        return Correspondences(name, reference_name, vectors, corners, references, one_surface, error_px, pixels)


@dataclass(frozen=True, slots=True, eq=False)
class Correspondences:
    """Vectors of N pixels, and their references: what another array has at the corresponding points.

    Attributes:
        name: the array that is judged, for messages.
        reference_name: the array and the place that it is compared with, for messages.
        vectors: (N, C) px.
        corners: (K, N, C) px, the other array in the K pixels around each point.
        references: (N, C) px, the other array interpolated between these.
        one_surface: (N,) bool, where the pixel and the K pixels show one surface.
        error_px: the largest difference that encodings cause.
        pixels: (N, 2) int64, column and row.
        least_scaled_px: shorter vectors say little about a factor.
    """

    name: str
    reference_name: str
    vectors: Floats
    corners: Floats
    references: Floats
    one_surface: Where
    error_px: float
    pixels: NDArray[np.int64]
    least_scaled_px: float = 1.0

    @property
    def known(self) -> Where:
        """Where both sides are finite, (N,) bool."""
        return np.asarray(np.isfinite(self.vectors).all(axis=1) & np.isfinite(self.references).all(axis=1))

    def select(self, where: Where) -> "Correspondences":
        """Return the pixels of a mask (N,) bool."""
        return replace(
            self,
            vectors=self.vectors[where],
            corners=self.corners[:, where],
            references=self.references[where],
            one_surface=self.one_surface[where],
            pixels=self.pixels[where],
        )


def check_agreement(check: str, measure: str, pixels: Correspondences, verdict: Verdict) -> None:
    """Judge vectors by the share of outliers, and by the median of the difference.

    Outliers lie outside the range of the pixels around the point. The median is taken on single surfaces: a constant
    error shifts the median difference, a wrong factor shifts the median of the relative difference.

    Args:
        check: the name of the check.
        measure: the first part of the measures' names.
        pixels: the vectors; an unknown reference is an outlier.
        verdict: takes findings and measures.
    """
    vectors, references = pixels.vectors, pixels.references
    if len(vectors) < MIN_PIXELS:
        return
    bound = _OUTSIDE_PX + pixels.error_px
    excess = np.maximum(pixels.corners.min(axis=0) - vectors, vectors - pixels.corners.max(axis=0))
    outlier = ~(excess <= bound).all(axis=1)
    share = float(outlier.mean())
    verdict.measures[f"{measure}_outside_share"] = share
    if share > _OUTSIDE_SHARE:
        first = int(np.argmax(outlier))
        verdict.add(
            check,
            f"{pixels.name}: {share:.2%} of {len(outlier)} visible pixels differ by more than {bound:.3g} px from "
            f"{pixels.reference_name}, at most {_OUTSIDE_SHARE:.0%} may; the first, at "
            f"{tuple(pixels.pixels[first].tolist())}, has {format_vector(vectors[first])} px instead of "
            f"{format_vector(references[first])} px",
        )
    surface = pixels.one_surface
    if surface.sum() < MIN_PIXELS:
        return
    difference = (vectors - references)[surface].astype(np.float64)
    median = np.median(difference, axis=0)
    vectors = vectors[surface].astype(np.float64)
    squared = (vectors**2).sum(axis=1)
    long = squared >= pixels.least_scaled_px**2
    factor, factor_bound = 0.0, _MEDIAN_SHARE
    if long.sum() >= MIN_PIXELS:
        factor = float(np.median((difference * vectors).sum(axis=1)[long] / squared[long]))
        factor_bound += pixels.error_px / float(np.sqrt(np.median(squared[long])))
    bound = _MEDIAN_PX + pixels.error_px
    verdict.measures[f"{measure}_median_px"] = float(np.abs(median).max())
    verdict.measures[f"{measure}_median_share"] = factor
    if np.abs(median).max() > bound or abs(factor) > factor_bound:
        verdict.add(
            check,
            f"{pixels.name} differs from {pixels.reference_name} by {format_vector(median)} px ({factor:+.3%}) in the "
            f"median of {len(difference)} pixels; at most {bound:.3g} px and {factor_bound:.2%} are allowed",
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
    share = float(wrong.sum() / max(certain.sum(), 1))
    verdict.measures[f"{measure}_disagree_share"] = share
    shares = {"certain": (share, _MASK_SHARE)}
    for label, value in (("outside", OUTSIDE), ("occluded", OCCLUDED), ("visible", VISIBLE)):
        in_class = expected == value
        if in_class.sum() >= MIN_PIXELS:
            shares[label] = (float((wrong & in_class).sum() / in_class.sum()), _CLASS_SHARE)
    for label, (measured, allowed) in shares.items():
        if measured > allowed:
            verdict.add(
                check, f"{name}: {measured:.2%} of the {label} pixels disagree with {source}; at most {allowed:.0%} may"
            )
            return


def spread_evenly(indices: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """Return at most ``most`` of the indices (N,), evenly spread over all."""
    return indices[:: max(1, -(-len(indices) // most))]
