"""Which pairs are farthest from the others."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from semisynth_gl.report.measure import PairMeasures

# A normal distribution's standard deviation in units of its median absolute deviation.
_DEVIATION = 1.4826


@dataclass(frozen=True, slots=True)
class Quantity:
    """What pairs are compared by.

    Attributes:
        name: of the quantity, with its unit.
        of: its value in a pair; None or NaN where it has none.
        form: how a value is written, as `format` takes it.
    """

    name: str
    of: Callable[[PairMeasures], float | None]
    form: str = ".3g"


QUANTITIES = (
    Quantity("median disparity, px", lambda pair: pair.median_px, ".4g"),
    Quantity("occluded pixels", lambda pair: pair.occluded, ".2%"),
    Quantity("texture measure, levels", lambda pair: pair.texture),
    Quantity("pixels without disparity", lambda pair: pair.invalid, ".3%"),
    Quantity("times drawn again", lambda pair: pair.redraws, ".0f"),
)


@dataclass(frozen=True, slots=True)
class Outlier:
    """A pair that is far from the others.

    Attributes:
        pair: which one.
        quantity: in what.
        value: its value.
        typical: the median of all measured pairs.
        deviations: how far it is from the median, in standard deviations as the median absolute deviation tells them.
    """

    pair: PairMeasures
    quantity: Quantity
    value: float
    typical: float
    deviations: float


def find_outliers(pairs: Sequence[PairMeasures], quantity: Quantity, most: int = 3) -> list[Outlier]:
    """Return the pairs that are farthest from the median of a quantity, the farthest first.

    Where more than half of all pairs have the same value, the mean absolute deviation takes the place of the median's.

    Args:
        pairs: those that were measured.
        quantity: what to compare.
        most: how many to return; fewer where fewer differ from the median.
    """
    had = [(pair, value) for pair in pairs if (value := quantity.of(pair)) is not None and np.isfinite(value)]
    if not had:
        return []
    values = np.array([value for _, value in had], np.float64)
    typical = float(np.median(values))
    off = np.abs(values - typical)
    scale = _DEVIATION * float(np.median(off)) or float(off.mean())
    farthest = [number for number in np.argsort(-off, kind="stable")[:most] if off[number] > 0]
    return [
        Outlier(had[number][0], quantity, float(values[number]), typical, float(off[number] / scale))
        for number in farthest
    ]
