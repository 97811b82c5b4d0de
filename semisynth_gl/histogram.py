"""Histograms of disparity over pixels, and distances between two histograms."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Histogram:
    """Shares of pixels in bins of disparity. Within a bin, the distribution is uniform.

    Attributes:
        edges_px: (K + 1,) float64, the increasing edges of K bins.
        shares: (K,) float64, the share of the pixels in each bin, 0 or more, sum 1.
    """

    edges_px: NDArray[np.float64]
    shares: NDArray[np.float64]

    @classmethod
    def from_counts(cls, edges_px: ArrayLike, counts: ArrayLike) -> Self:
        """Build a histogram from (K + 1,) edges and (K,) counts or weights, which are scaled to a sum of 1.

        Raises ValueError if edges do not increase, or counts are negative or all 0.
        """
        edges, weights = np.asarray(edges_px, np.float64), np.asarray(counts, np.float64)
        if edges.shape != (len(weights) + 1,) or not (np.diff(edges) > 0).all():
            raise ValueError(f"expected {len(weights) + 1} increasing edges, got {edges.tolist()}")
        if not (weights >= 0).all() or not 0 < weights.sum() < np.inf:
            raise ValueError("expected counts of 0 or more, with a sum above 0")
        return cls(edges, weights / weights.sum())

    @property
    def mean_px(self) -> float:
        """Mean disparity."""
        return float(self.shares @ (self.edges_px[1:] + self.edges_px[:-1]) / 2)

    def cumulative(self, disparity_px: ArrayLike) -> NDArray[np.float64]:
        """Return the share of the pixels below each disparity, float64 in the shape of ``disparity_px``."""
        at_edges = self._cumulative_at_edges()
        return np.asarray(np.interp(np.asarray(disparity_px, np.float64), self.edges_px, at_edges), np.float64)

    def quantile(self, share: float) -> float:
        """Return the disparity, px, below which this share of the pixels (0 to 1) lies."""
        return float(np.interp(share, self._cumulative_at_edges(), self.edges_px))

    def rebinned(self, edges_px: ArrayLike) -> Self:
        """Return the histogram in different bins, given their increasing edges (K + 1,).

        The first and the last bin also count the pixels beyond their outer edges.
        """
        edges = np.asarray(edges_px, np.float64)
        cumulative = self.cumulative(edges)
        cumulative[0], cumulative[-1] = 0.0, 1.0
        # Rounding may make cumulative shares decrease slightly, which would give negative shares.
        return type(self)(edges, np.diff(np.maximum.accumulate(np.minimum(cumulative, 1.0))))

    def _cumulative_at_edges(self) -> NDArray[np.float64]:
        return np.concatenate([[0.0], np.cumsum(self.shares)])


def count_pixels(disparity: NDArray[np.floating], edges_px: ArrayLike) -> NDArray[np.int64]:
    """Count the finite disparities, px, of an array of any shape in K bins with increasing edges (K + 1,): (K,) int64.

    The first and the last bin also count disparities beyond their outer edges.
    """
    inner = np.concatenate([[-np.inf], np.asarray(edges_px, np.float64)[1:-1], [np.inf]])
    return np.histogram(disparity[np.isfinite(disparity)], inner)[0]


def total_variation(first: Histogram, second: Histogram) -> float:
    """Return half the sum of the absolute differences of shares in the bins of ``first``: 0 if equal, at most 1."""
    return float(np.abs(first.shares - second.rebinned(first.edges_px).shares).sum() / 2)


def wasserstein_px(first: Histogram, second: Histogram) -> float:
    """Return the Wasserstein-1 distance: the area between the two cumulative distributions, px."""
    edges = np.union1d(first.edges_px, second.edges_px)
    difference = first.cumulative(edges) - second.cumulative(edges)
    begin, end, width = difference[:-1], difference[1:], np.diff(edges)
    # The difference is linear between edges; where its sign changes, the area consists of two triangles.
    total = np.abs(begin) + np.abs(end)
    with np.errstate(invalid="ignore", divide="ignore"):
        triangles = (begin**2 + end**2) / (2 * total)
    return float((np.where(begin * end < 0, triangles, total / 2) * width).sum())
