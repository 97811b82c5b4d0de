"""How many particles each layer of depth needs for a wanted distribution of disparity.

With particles thrown independently, a layer whose particles cover a pixel lambda times on average hides it with
probability 1 - exp(-lambda) (a Boolean model). Going from near to far, T is the share of the view that is still open
in front of a layer, and of the bare background the share B lies in the layer or behind it and the share b lies in the
layer itself. Then the layer's disparities take the share

    w = T ((1 - exp(-lambda)) B + exp(-lambda) b),    so    exp(-lambda) = (B - w / T) / (B - b).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.config.model import DisparitySection

# Above this coverage a layer is closed for all practical purposes (95%).
_DENSEST = 3.0
_UNIFORM_BINS = 24


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """A wanted distribution of disparity.

    Attributes:
        edges_px: (K + 1,) float64, rising.
        shares: (K,) float64, sum 1.
    """

    edges_px: NDArray[np.float64]
    shares: NDArray[np.float64]


def target_of(section: DisparitySection) -> Target:
    """Return the section's histogram, or a uniform one from ``min_px`` to ``max_px`` in bins of equal width."""
    if section.histogram is None:
        edges = np.linspace(section.min_px, section.max_px, _UNIFORM_BINS + 1, dtype=np.float64)
        return Target(edges, np.full(_UNIFORM_BINS, 1 / _UNIFORM_BINS))
    shares = np.array(section.histogram.shares, np.float64)
    edges = np.arange(len(shares) + 1, dtype=np.float64) * section.histogram.bin_px
    return Target(edges, shares / shares.sum())


def coverage(target: Target, background_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solve the layers' mean coverages lambda, (K,) float64, 0 or more.

    Args:
        target: what is wanted.
        background_px: disparities of the bare background over the view, any length.
    """
    edges = target.edges_px.copy()
    edges[0], edges[-1] = -np.inf, np.inf
    background = np.histogram(background_px, edges)[0] / len(background_px)
    behind = np.cumsum(background)
    result = np.zeros(len(target.shares))
    still_open = 1.0
    for k in range(len(target.shares) - 1, -1, -1):
        hideable = behind[k] - background[k]
        if hideable <= 0:
            break
        passed = (behind[k] - target.shares[k] / still_open) / hideable
        passed = float(np.clip(passed, np.exp(-_DENSEST), 1.0))
        result[k] = -np.log(passed)
        still_open *= passed
    return result
