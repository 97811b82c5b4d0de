"""The section ``disparity``: the limits of disparity, and the distributions that ``disparity.target`` may have."""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from semisynth_gl.config.fields import FROM_LIST, SMALLEST, ConfigError, ConfigSection, Finite, NotNegative, Positive
from semisynth_gl.histogram import Histogram

# Number of points per bin at which a density is evaluated.
_POINTS = 16
# Number of bins of targets other than histograms.
_BINS = 24
# Maximum share of a target below min_px, where far planes and the sky may be.
_MOST_BELOW = 0.25
# Maximum share of a target above max_px: measured histograms have outliers.
_MOST_ABOVE = 0.02


class UniformTarget(ConfigSection):
    """Equally many pixels at each disparity from ``low_px`` to ``high_px``, by default ``min_px`` to ``max_px``."""

    form: Literal["uniform"] = "uniform"
    low_px: Finite | None = None
    high_px: Finite | None = None


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

    def _check_rules(self) -> None:
        if self.mean_px - self.origin_px < SMALLEST:
            text = f"expected mean_px above origin_px, got {self.mean_px:g} and {self.origin_px:g}"
            raise ConfigError(text, ("mean_px", "origin_px"))

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
    shares: Annotated[tuple[NotNegative, ...], FROM_LIST, Field(min_length=1)]

    def _check_rules(self) -> None:
        if sum(self.shares) <= 0:
            raise ConfigError("expected at least one share above 0", ("shares",))

    def histogram(self) -> Histogram:
        """Return the shares with the bins' edges."""
        edges_px = self.first_px + np.arange(len(self.shares) + 1) * self.bin_px
        return Histogram.from_counts(edges_px, self.shares)


TargetSection = Annotated[
    UniformTarget | UniformDepthTarget | GammaTarget | HistogramTarget, Field(discriminator="form")
]


class DisparitySection(ConfigSection):
    """The disparities of a dataset."""

    signed: bool = False
    """allow disparities of 0 and below"""
    min_px: Finite
    """smallest disparity of walls and particles; far planes may be below it"""
    max_px: Finite
    """largest disparity of any pixel; it sets the near plane"""
    target: TargetSection = UniformTarget()
    """wanted distribution: ``uniform`` (default), ``uniform-depth``, ``gamma``, ``histogram``"""

    def _check_rules(self) -> None:
        if self.min_px >= self.max_px:
            text = f"expected min_px < max_px, got {self.min_px:g} and {self.max_px:g}: the range is empty"
            raise ConfigError(text, ("min_px", "max_px"))
        if isinstance(self.target, UniformTarget):
            low_px, high_px = self._ends_px(self.target)
            if low_px >= high_px:
                raise ConfigError(f"expected low_px < high_px, got {low_px:g} and {high_px:g}", ("target",))
        below, above = self._shares_beyond()
        if below > _MOST_BELOW or above > _MOST_ABOVE:
            text = f"wants {below:.1%} of the pixels below disparity.min_px and {above:.1%} above max_px"
            keys = "target", "min_px", "max_px"
            raise ConfigError(f"disparity.target {text}: change the target, or these limits", keys)

    def wanted_histogram(self, doffs_px: float) -> Histogram:
        """Return the target as a histogram, px; ``doffs_px`` is the mean cx_right - cx_left of the cameras."""
        edges_px = np.linspace(self.min_px, self.max_px, _BINS + 1, dtype=np.float64)
        match self.target:
            case UniformTarget() as target:
                return Histogram.from_counts(self._ends_px(target), [1.0]).rebinned(edges_px)
            case UniformDepthTarget():
                # Depth is f B / (d + doffs): a bin's share of the depths is a difference of 1 / (d + doffs), scaled.
                return Histogram.from_counts(edges_px, -np.diff(1 / (edges_px + doffs_px)))
            case GammaTarget() as target:
                return target.histogram(edges_px)
            case HistogramTarget() as target:
                return target.histogram()

    def _ends_px(self, target: UniformTarget) -> tuple[float, float]:
        low_px, high_px = target.low_px, target.high_px
        return self.min_px if low_px is None else low_px, self.max_px if high_px is None else high_px

    def _shares_beyond(self) -> tuple[float, float]:
        """Return the shares of the target, before it is truncated, below ``min_px`` and above ``max_px``."""
        match self.target:
            case UniformTarget() as target:
                whole = Histogram.from_counts(self._ends_px(target), [1.0])
            case UniformDepthTarget():
                return 0.0, 0.0
            case GammaTarget() as target:
                return target.share_below(self.min_px), 1 - target.share_below(self.max_px)
            case HistogramTarget() as target:
                whole = target.histogram()
        below, to_end = whole.cumulative([self.min_px, self.max_px]).tolist()
        return below, 1 - to_end
