"""The distributions of disparity that ``disparity.target`` may have."""

from collections.abc import Iterator
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from semisynth_gl.config.fields import FROM_LIST, SMALLEST, ConfigSection, Finite, Positive, Rule, Weight
from semisynth_gl.histogram import Histogram

# Number of points per bin at which a density is evaluated.
_POINTS = 16
# Number of bins of targets other than histograms.
_BINS = 24


class UniformTarget(ConfigSection):
    """Equally many pixels at each disparity from ``low_px`` to ``high_px``, by default ``min_px`` to ``max_px``."""

    form: Literal["uniform"] = "uniform"
    low_px: Finite | None = None
    high_px: Finite | None = None

    def ends(self, min_px: float, max_px: float) -> tuple[float, float]:
        """Return the smallest and the largest disparity, px."""
        low_px, high_px = self.low_px, self.high_px
        return min_px if low_px is None else low_px, max_px if high_px is None else high_px


class UniformDepthTarget(ConfigSection):
    """Every depth from ``disparity.max_px`` to ``disparity.min_px`` has the same share of the pixels."""

    form: Literal["uniform-depth"]


class GammaTarget(ConfigSection):
    """A gamma distribution: one hump with a long tail of large disparities.

    The distribution begins at ``origin_px``. Its mean is ``mean_px``, and its standard deviation ``spread_px``, before
    it is truncated to the disparities from ``disparity.min_px`` to ``disparity.max_px``.
    """

    form: Literal["gamma"]
    origin_px: Finite = 0.0
    mean_px: Finite
    spread_px: Positive

    def _rules(self) -> Iterator[Rule]:
        text = f"expected mean_px above origin_px, got {self.mean_px:g} and {self.origin_px:g}"
        yield self.mean_px - self.origin_px < SMALLEST, text, ("mean_px", "origin_px")

    def histogram(self, edges_px: NDArray[np.float64]) -> Histogram:
        """Integrate the distribution over bins of equal width with edges (K + 1,), and truncate it to them.

        Its density is proportional to x^(shape - 1) exp(-x / scale), where x is the distance from the origin.
        """
        shape, scale = self._shape_and_scale()
        width = np.diff(edges_px) / _POINTS
        at = edges_px[:-1, None] + (np.arange(_POINTS) + 0.5) * width[:, None] - self.origin_px
        after = np.maximum(at, np.finfo(np.float64).tiny)
        # Points before the origin have a density of 0. If all points are there, bins have equal shares.
        logarithm = np.where(at > 0, (shape - 1) * np.log(after) - after / scale, -1e300)
        # The largest density may be far from 1, so it is scaled to 1.
        return Histogram.from_counts(edges_px, np.exp(logarithm - logarithm.max()).sum(axis=1))

    def share_below(self, disparity_px: float) -> float:
        """Return the share of the distribution, before it is truncated, below a disparity."""
        from scipy.special import gammainc  # noqa: PLC0415 - slow to load

        shape, scale = self._shape_and_scale()
        return float(gammainc(shape, max(disparity_px - self.origin_px, 0.0) / scale))

    def _shape_and_scale(self) -> tuple[float, float]:
        mean_px = self.mean_px - self.origin_px
        return (mean_px / self.spread_px) ** 2, self.spread_px**2 / mean_px


class HistogramTarget(ConfigSection):
    """Shares of pixels in bins of width ``bin_px``, the first from ``first_px``; shares are scaled to a sum of 1."""

    form: Literal["histogram"]
    bin_px: Positive
    first_px: Finite = 0.0
    shares: Annotated[tuple[Weight, ...], FROM_LIST, Field(min_length=1)]

    def _rules(self) -> Iterator[Rule]:
        yield sum(self.shares) <= 0, "expected at least one share above 0", ("shares",)

    def histogram(self) -> Histogram:
        """Return the shares with the bins' edges."""
        edges_px = self.first_px + np.arange(len(self.shares) + 1) * self.bin_px
        return Histogram.from_counts(edges_px, self.shares)


TargetSection = Annotated[
    UniformTarget | UniformDepthTarget | GammaTarget | HistogramTarget, Field(discriminator="form")
]


def shares_beyond(target: TargetSection, min_px: float, max_px: float) -> tuple[float, float]:
    """Return the shares of a target, before it is truncated, below ``min_px`` and above ``max_px``."""
    match target:
        case UniformDepthTarget():
            return 0.0, 0.0
        case GammaTarget():
            return target.share_below(min_px), 1 - target.share_below(max_px)
        case UniformTarget():
            whole = Histogram.from_counts(target.ends(min_px, max_px), [1.0])
        case HistogramTarget():
            whole = target.histogram()
    below, to_end = whole.cumulative([min_px, max_px]).tolist()
    return below, 1 - to_end


def wanted_histogram(target: TargetSection, min_px: float, max_px: float, doffs_px: float) -> Histogram:
    """Return a target as a histogram of disparity, px, see `semisynth_gl.config.model.Config.wanted_histogram`.

    ``doffs_px`` is the mean cx_right - cx_left of the cameras.
    """
    edges_px = np.linspace(min_px, max_px, _BINS + 1, dtype=np.float64)
    match target:
        case UniformDepthTarget():
            # Depth is f B / (d + doffs): a bin's share of the depths is a difference of 1 / (d + doffs), scaled.
            return Histogram.from_counts(edges_px, -np.diff(1 / (edges_px + doffs_px)))
        case GammaTarget():
            return target.histogram(edges_px)
        case UniformTarget():
            return Histogram.from_counts(target.ends(min_px, max_px), [1.0]).rebinned(edges_px)
        case HistogramTarget():
            return target.histogram()
