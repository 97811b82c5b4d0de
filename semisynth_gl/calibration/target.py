"""The range of disparity and the wanted histogram: from what was measured, or wide and smooth where nothing was."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.errors import InputError
from semisynth_gl.histogram import Histogram

# Guesses and lidar have a few values that are far off.
_LOWEST, _HIGHEST = 0.001, 0.999
# Above the largest: the near plane stands where max_px is, and things shall have some room before it.
_HEADROOM = 1.1
# Objects are deep: what they show cannot follow bins much narrower than that.
_MOST_BINS = 22
_STEPS = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)
# Of a chosen range without a lower end.
_LOW_OF_HIGH = 0.02
# A chosen histogram: one part even, the other a hump at a sixth of the range that falls off slowly.
_EVEN_PART = 0.25
_HUMP = 1 / 6


@dataclass(frozen=True, slots=True, eq=False)
class DisparityRange:
    """What goes into the config's section ``disparity``.

    Attributes:
        min_px: least disparity.
        max_px: largest one.
        bin_px: width of a bin.
        target: the histogram, in bins of that width.
    """

    min_px: float
    max_px: float
    bin_px: float
    target: Histogram


def farthest_px(least_doffs_px: float) -> float:
    """Return what disparities have to be above: a depth takes d + doffs above 0, and a config d above 0."""
    return max(0.0, -least_doffs_px)


def measured_range(histogram: Histogram, least_doffs_px: float = 0.0) -> DisparityRange:
    """Return the range that holds all but a thousandth of the disparities at either end, and their histogram.

    Args:
        histogram: what was measured.
        least_doffs_px: the least cx_right - cx_left of the rigs.

    Raises:
        InputError: where disparities lie beyond infinity.
    """
    low, high = histogram.quantile(_LOWEST), histogram.quantile(_HIGHEST)
    _check_before_infinity(
        low,
        least_doffs_px,
        "a thousandth of the measured disparities lies below",
        "give disparity maps of these rigs, or calibrate rigs whose doffs differ one by one",
    )
    first = _rounded_down(low, farthest_px(least_doffs_px))
    edges, bin_px = _bins(first, high * _HEADROOM)
    return DisparityRange(first, float(edges[-1]), bin_px, histogram.rebinned(edges))


def chosen_range(low_px: float | None, high_px: float, least_doffs_px: float = 0.0) -> DisparityRange:
    """Return a wide and smooth histogram over a range that is known.

    Args:
        low_px: its lower end; where it is not known, a fiftieth of the way from the farthest disparity to the upper
            end.
        high_px: its upper end.
        least_doffs_px: the least cx_right - cx_left of the rigs.

    Raises:
        InputError: where the range is empty, not above 0, or begins beyond infinity.
    """
    farthest = farthest_px(least_doffs_px)
    if farthest > 0:
        _check_before_infinity(
            high_px,
            least_doffs_px,
            "the range of disparity ends at",
            "give the range of this rig with --range-px LOW HIGH",
        )
    low = farthest + _LOW_OF_HIGH * (high_px - farthest) if low_px is None else low_px
    if not 0 < low < high_px < math.inf:
        raise InputError(f"the range of disparity is {low:g} to {high_px:g} px: expected two numbers above 0 that rise")
    _check_before_infinity(
        low, least_doffs_px, "the range of disparity begins at", "give one that begins above with --range-px LOW HIGH"
    )
    edges, bin_px = _bins(low, high_px)
    inside = np.clip((np.clip(edges, low, high_px) - low) / (high_px - low), 0, 1)
    # The integral of x exp(-x / h), a gamma distribution of shape 2.
    hump = 1 - (1 + inside / _HUMP) * np.exp(-inside / _HUMP)
    cumulative = _EVEN_PART * inside + (1 - _EVEN_PART) * hump / hump[-1]
    return DisparityRange(low, high_px, bin_px, Histogram.from_counts(edges, np.diff(cumulative)))


def _bins(low: float, high: float) -> tuple[NDArray[np.float64], float]:
    """Edges of 15 to 22 bins of one round width that begin where a range does and cover it."""
    least = (high - low) / (_MOST_BINS - 1)  # one may be added by rounding the end
    power = 10.0 ** math.floor(math.log10(least))
    bin_px = next(step * power for step in (*_STEPS, 10.0) if step * power >= least)
    bin_px = float(f"{bin_px:.6g}")  # since 3 x 0.1 is no number that anyone wants to read
    return np.round(low + np.arange(math.ceil((high - low) / bin_px) + 1) * bin_px, 9), bin_px


def _check_before_infinity(low_px: float, least_doffs_px: float, what: str, how: str) -> None:
    if low_px + least_doffs_px <= 0:
        raise InputError(
            f"{what} {low_px:g} px, but with doffs = {least_doffs_px:g} px (cx_right - cx_left) what is at "
            f"{-least_doffs_px:g} px is infinitely far, and less is nowhere: expected more; {how}"
        )


def _rounded_down(value: float, above: float) -> float:
    """Two significant digits of a value, or of its distance from what it has to stay above where they lose half."""
    rounded = _two_digits(value)
    return rounded if rounded - above >= (value - above) / 2 else above + _two_digits(value - above)


def _two_digits(value: float) -> float:
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.floor(value / step) * step:.6g}")
