"""Vectors of pixels against what they should be, judged by a share and by medians."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.verify.consistency import FEWEST, MEDIAN_PX, MEDIAN_SHARE, OUTSIDE_PX, OUTSIDE_SHARE
from semisynth_gl.verify.finding import Verdict

Floats = NDArray[np.floating]
Where = NDArray[np.bool_]

# Shorter vectors say little of a factor on them.
_SCALED_FROM_PX = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """Vectors, and what they should be: interpolated between pixels that are four, or two in a row.

    Attributes:
        name: of the array that is judged, for messages.
        other: what it is compared with, for messages.
        own: (N, C) px.
        corners: (K, N, C) px, what the K pixels around each have.
        between: (N, C) px, interpolated there.
        flat: (N,) bool, where all belong to one surface.
        error_px: the most that encodings put the difference off by.
        place: (N, 2) column and row of each in its image.
    """

    name: str
    other: str
    own: Floats
    corners: Floats
    between: Floats
    flat: Where
    error_px: float
    place: NDArray[np.int64]

    @property
    def known(self) -> Where:
        """Where both sides are finite, (N,)."""
        return np.asarray(np.isfinite(self.own).all(axis=1) & np.isfinite(self.between).all(axis=1))

    def only(self, where: Where) -> "Compared":
        """Keep those of which something is true, (N,) bool."""
        return replace(
            self,
            own=self.own[where],
            corners=self.corners[:, where],
            between=self.between[where],
            flat=self.flat[where],
            place=self.place[where],
        )


def check_compared(check: str, measure: str, compared: Compared, verdict: Verdict) -> None:
    """Judge vectors by two numbers, as `check_left_right` judges disparities.

    The share of those that lie outside what the pixels around span; and, on one surface, the median difference, which
    a constant error shifts, and the median share of the difference, which a wrong factor shifts.

    Args:
        check: the check's name.
        measure: what names of measures begin with.
        compared: the vectors, all of them finite.
        verdict: takes findings and measures.
    """
    if len(compared.own) < FEWEST:
        return
    corners, allowed = compared.corners, OUTSIDE_PX + compared.error_px
    apart = np.maximum(corners.min(axis=0) - compared.own, compared.own - corners.max(axis=0))
    wrong = ~(apart <= allowed).all(axis=1)
    share = float(wrong.mean())
    verdict.measures[f"{measure}_outside_share"] = share
    if share > OUTSIDE_SHARE:
        first = int(np.flatnonzero(wrong)[0])
        verdict.add(
            check,
            f"{compared.name}: {share:.2%} of {len(wrong)} visible pixels differ by more than {allowed:.3g} px from "
            f"{compared.other}, at most {OUTSIDE_SHARE:.0%} may; the first at {tuple(compared.place[first].tolist())} "
            f"is {vector(compared.own[first])}, expected {vector(compared.between[first])}",
        )
    flat = compared.flat
    if flat.sum() < FEWEST:
        return
    difference = (compared.own - compared.between)[flat].astype(np.float64)
    median = np.median(difference, axis=0)
    reference = compared.own[flat].astype(np.float64)
    squared = (reference**2).sum(axis=1)
    long = squared >= _SCALED_FROM_PX**2
    factor, factor_bound = 0.0, MEDIAN_SHARE
    if long.sum() >= FEWEST:
        factor = float(np.median((difference * reference).sum(axis=1)[long] / squared[long]))
        factor_bound += compared.error_px / float(np.sqrt(np.median(squared[long])))
    bound = MEDIAN_PX + compared.error_px
    verdict.measures[f"{measure}_median_px"] = float(np.abs(median).max())
    verdict.measures[f"{measure}_median_share"] = factor
    if np.abs(median).max() > bound or abs(factor) > factor_bound:
        verdict.add(
            check,
            f"{compared.name} is {vector(median)} px ({factor:+.3%}) off {compared.other} in the median of "
            f"{len(difference)} pixels; at most {bound:.3g} px and {factor_bound:.2%} may be",
        )


def vector(values: Floats) -> str:
    """Write a number, or several in parentheses."""
    numbers = ", ".join(f"{float(value):.6g}" for value in values)
    return numbers if len(values) == 1 else f"({numbers})"
