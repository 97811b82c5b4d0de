"""Compares the measures of a dataset with its place, and of a pair with the other pairs."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.judge.measures import MEASURES, Measure, advice

# Least number of a place's pictures with which a dataset is compared. With four pictures, and a dataset like its place,
# one measure in four is more than one standard deviation apart by chance; with eleven pictures, one in thirty.
FEWEST = 4
# As shares of a measure's mean: the standard deviation assumed for a single picture, and the lower limit of any.
_UNKNOWN, _LEAST = 0.25, 0.05
# Outliers are this many standard deviations off; a deviation is so many median absolute deviations, if normal.
_FAR, _DEVIATION = 3.0, 1.4826

HEAD = ("measure", "unit", "dataset", "place", "off by", "apart", "advice")
Values = Mapping[str, NDArray[np.float64]]
"""By the key of each of `MEASURES`, the numbers (N,) of the N pictures that have the measure."""


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """A measure of a dataset, beside the same measure of its place.

    Attributes:
        measure: the measure.
        dataset: (N,) float64, the numbers of the dataset's left views.
        place: (M,) float64, the numbers of the place's pictures; empty without any.
        difference: the dataset's mean minus the place's mean, in the place's standard deviations (`unit_of`). None
            without numbers of the dataset, with fewer than `FEWEST` pictures of the place, or where all of these are 0.
        distance: the Wasserstein-1 distance of both distributions, in the same unit. It decides: a mix of crowded and
            empty scenes may have the place's mean although no pair resembles it.
        advice: what to change in the config; "" where there is nothing to change, or no key is known.
    """

    measure: Measure
    dataset: NDArray[np.float64]
    place: NDArray[np.float64]
    difference: float | None = None
    distance: float | None = None
    advice: str = ""

    def values(self) -> dict[str, Any]:
        """Return the row in JSON's types, unrounded; a mean without numbers is None."""
        values = {"name": self.measure.key, "meaning": self.measure.name, "unit": self.measure.unit}
        sides = {"dataset": self.dataset, "place": self.place}
        numbers = {
            name: {"mean": float(side.mean()) if side.size else None, "values": side.tolist()}
            for name, side in sides.items()
        }
        return values | numbers | {name: getattr(self, name) for name in ("difference", "distance", "advice")}


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPair:
    """The measures of one pair.

    Attributes:
        position: index of the pair in the `Dataset` that was measured.
        name: name of the pair's scene, with the split in a dataset of several splits.
        recipe: the recipe that sampled the pair's scene; None where the config has no recipes.
        values: the numbers of the left view, by the key of each of `MEASURES` that it has.
    """

    position: int
    name: str
    recipe: str | None
    values: Mapping[str, float]


class Outlier(NamedTuple):
    """A pair whose value of a measure is far from the median ``typical``, by so many standard deviations."""

    pair: MeasuredPair
    measure: Measure
    value: float
    typical: float
    deviations: float


def gather(pictures: Iterable[Mapping[str, float]]) -> Values:
    """Collect the measures of pictures, each a mapping of the keys that it has, into arrays."""
    found = list(pictures)
    return {
        measure.key: np.array([each[measure.key] for each in found if measure.key in each], np.float64)
        for measure in MEASURES
    }


def unit_of(values: NDArray[np.float64]) -> float:
    """Return the standard deviation of a place's pictures, with Bessel's correction, in which differences are told.

    It is at least 5 % of the mean, and 25 % of the mean for a single picture.
    """
    mean = abs(float(values.mean()))
    return max(float(values.std(ddof=1)), _LEAST * mean) if len(values) > 1 else _UNKNOWN * mean


def compare(dataset: Values, place: Values, recipes: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Return a row for each measure that the dataset's left views or the place's pictures have.

    ``recipes`` are the config of each recipe in JSON's types, or the config itself where it has no recipes.
    """
    return [
        _row(measure, dataset[measure.key], place[measure.key], recipes)
        for measure in MEASURES
        if dataset[measure.key].size or place[measure.key].size
    ]


def _row(
    measure: Measure, ours: NDArray[np.float64], theirs: NDArray[np.float64], recipes: Sequence[Mapping[str, Any]]
) -> Row:
    if len(ours) == 0 or len(theirs) < FEWEST:
        return Row(measure, ours, theirs)
    from scipy.stats import wasserstein_distance  # noqa: PLC0415 - slow to load

    unit = unit_of(theirs)
    if unit == 0:
        # All of the place's numbers are 0, so no deviation tells how far others are off.
        return Row(measure, ours, theirs, advice=advice(measure, recipes, more=False) if ours.any() else "")
    off, apart = float(ours.mean() - theirs.mean()) / unit, float(wasserstein_distance(ours, theirs)) / unit
    change = ""
    if abs(off) > 1:
        change = advice(measure, recipes, more=off < 0)
    elif apart > 1:
        vary = "more: add recipes to scenes, or widen ranges" if ours.std() < theirs.std() else "less: narrow ranges"
        change = f"the mean fits, but pairs should vary {vary}"
    return Row(measure, ours, theirs, off, apart, change)


def find_outliers(pairs: Sequence[MeasuredPair]) -> list[Outlier]:
    """Return for each measure the pair farthest from the median, if at least three deviations off; the farthest first.

    The standard deviation is estimated from the median absolute deviation. Where more than half of the pairs have the
    same value, the mean absolute deviation is used instead.
    """
    outliers = []
    for measure in MEASURES:
        valued = [pair for pair in pairs if measure.key in pair.values]
        if not valued:
            continue
        values = np.array([pair.values[measure.key] for pair in valued])
        typical = float(np.median(values))
        off = np.abs(values - typical)
        scale = _DEVIATION * float(np.median(off)) or float(off.mean())
        at = int(np.argmax(off))
        if scale and off[at] >= _FAR * scale:
            outliers.append(Outlier(valued[at], measure, float(values[at]), typical, float(off[at] / scale)))
    return sorted(outliers, key=lambda outlier: -outlier.deviations)


def table(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """Return a head and a row of texts for each measure; without pictures of a place, only the first three columns."""
    texts = [
        (
            row.measure.name,
            row.measure.unit,
            _shown(row.dataset),
            _shown(row.place),
            "-" if row.difference is None else f"{row.difference:+.1f} sd",
            "-" if row.distance is None else f"{row.distance:.1f} sd",
            row.advice,
        )
        for row in rows
    ]
    columns = len(HEAD) if any(row.place.size for row in rows) else 3
    return [each[:columns] for each in (HEAD, *texts)]


def summary(rows: Sequence[Row]) -> list[str]:
    """Return how many measures are near the place's, and what to change, the farthest measures first, as lines."""
    compared = [row.distance for row in rows if row.distance is not None]
    near = sum(apart <= 1 for apart in compared)
    head = f"{near} of {len(compared)} measures within one standard deviation (sd) of the place"
    advised = sorted((row for row in rows if row.advice), key=lambda row: -(row.distance or 0.0))
    return [*[head] * bool(compared), *(f"  {row.measure.name}: {row.advice}" for row in advised)]


def _shown(values: NDArray[np.float64]) -> str:
    """Return mean and deviation as text, "-" without values."""
    if not values.size:
        return "-"
    mean = abs(float(values.mean()))
    digits = 3 if 0 < mean < 0.1 else 2 if mean < 10 else 1 if mean < 100 else 0
    deviation = f" ± {values.std(ddof=1):.{digits}f}" if len(values) > 1 else ""
    return f"{values.mean():.{digits}f}{deviation}"
