"""A distribution of disparity over pixels, and how far two of them are apart."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Histogram:
    """Shares of pixels in bins of disparity, spread evenly within each bin.

    Attributes:
        edges_px: (K + 1,) float64, rising.
        shares: (K,) float64, 0 or more, sum 1.
    """

    edges_px: NDArray[np.float64]
    shares: NDArray[np.float64]

    @classmethod
    def of(cls, edges_px: ArrayLike, counts: ArrayLike) -> Self:
        """Build one from counts or weights, which are scaled to a sum of 1.

        Raises:
            ValueError: where edges do not rise, or counts are negative or all 0.
        """
        edges, weights = np.asarray(edges_px, np.float64), np.asarray(counts, np.float64)
        if edges.shape != (len(weights) + 1,) or not (np.diff(edges) > 0).all():
            raise ValueError(f"expected {len(weights) + 1} rising edges, got {edges.tolist()}")
        if not (weights >= 0).all() or not 0 < weights.sum() < np.inf:
            raise ValueError("expected counts of 0 or more, with a sum above 0")
        return cls(edges, weights / weights.sum())

    @property
    def mean_px(self) -> float:
        """Mean disparity."""
        return float(self.shares @ (self.edges_px[1:] + self.edges_px[:-1]) / 2)

    def cumulative(self, disparity_px: ArrayLike) -> NDArray[np.float64]:
        """Share of pixels below each disparity."""
        at_edges = np.concatenate([[0.0], np.cumsum(self.shares)])
        return np.asarray(np.interp(np.asarray(disparity_px, np.float64), self.edges_px, at_edges), np.float64)

    def quantile(self, share: float) -> float:
        """Disparity that this share of the pixels lies below."""
        at_edges = np.concatenate([[0.0], np.cumsum(self.shares)])
        return float(np.interp(share, at_edges, self.edges_px))

    def rebinned(self, edges_px: ArrayLike) -> Self:
        """Return it in other bins; what lies beyond the outer edges goes to the outer bins."""
        edges = np.asarray(edges_px, np.float64)
        cumulative = self.cumulative(edges)
        cumulative[0], cumulative[-1] = 0.0, 1.0
        return type(self)(edges, np.diff(cumulative))


class PixelCount:
    """Counts disparities of one image after the other.

    Args:
        edges_px: (K + 1,) rising; what lies beyond the outer ones counts in the outer bins.

    Attributes:
        edges_px: (K + 1,) float64.
        counts: (K,) int64.
    """

    def __init__(self, edges_px: ArrayLike) -> None:
        self.edges_px = np.asarray(edges_px, np.float64)
        self.counts = np.zeros(len(self.edges_px) - 1, np.int64)

    def add(self, disparity: NDArray[np.floating]) -> None:
        """Count the finite values of an array of any shape."""
        inner = np.concatenate([[-np.inf], self.edges_px[1:-1], [np.inf]])
        self.counts += np.histogram(disparity[np.isfinite(disparity)], inner)[0]

    @property
    def histogram(self) -> Histogram:
        """What was counted; raises ValueError where nothing was."""
        return Histogram.of(self.edges_px, self.counts)


def total_variation(one: Histogram, other: Histogram) -> float:
    """Half the sum of the absolute differences of shares, in the bins of ``one``: 0 for equal ones, 1 at most."""
    return float(np.abs(one.shares - other.rebinned(one.edges_px).shares).sum() / 2)


def wasserstein_px(one: Histogram, other: Histogram) -> float:
    """Wasserstein-1 distance: the area between the two cumulative distributions, in px."""
    edges = np.union1d(one.edges_px, other.edges_px)
    difference = one.cumulative(edges) - other.cumulative(edges)
    left, right, width = difference[:-1], difference[1:], np.diff(edges)
    crossing = left * right < 0
    # The difference is linear between edges; where its sign changes, two triangles make up the area.
    total = np.abs(left) + np.abs(right)
    with np.errstate(invalid="ignore", divide="ignore"):
        triangles = (left**2 + right**2) / (2 * total)
    return float((np.where(crossing, triangles, total / 2) * width).sum())


def mixed(parts: Iterable[tuple[float, Histogram]], edges_px: ArrayLike) -> Histogram:
    """Mix histograms by weights, in the bins of ``edges_px``."""
    shares = sum(weight * part.rebinned(edges_px).shares for weight, part in parts)
    return Histogram.of(edges_px, shares)
