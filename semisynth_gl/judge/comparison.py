"""Compares the measures of a dataset with the measures of its place, and finds the dataset's outliers.

The place is where the network will work. Its pictures are photographs and disparity maps.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.judge.measures import MEASURES, Measure, advice

# Minimum number of a place's pictures for a comparison. Even if a dataset is like its place, ``distance`` exceeds 1 by
# chance: for a quarter of the measures with four pictures, for one measure in thirty with eleven.
MIN_PICTURES = 4
# Minimum distance of an outlier from the median, in standard deviations.
_OUTLIER_DEVIATIONS = 3.0
# The standard deviation of a normal distribution, divided by its median absolute deviation.
_DEVIATION_RATIO = 1.4826

HEAD = ("measure", "unit", "dataset", "place", "off by", "apart", "advice")
Values = Mapping[str, NDArray[np.float64]]
"""The values (N,) of several pictures, by the measure's key in `MEASURES`. A picture may lack some measures."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasureComparison:
    """A measure of a dataset, compared with the same measure of its place.

    Attributes:
        measure: the measure.
        dataset: (N,) float64, the values of the dataset's left views.
        place: (M,) float64, the values of the place's pictures; may be empty.
        difference: the dataset's mean minus the place's mean, in standard deviations of the place (see
            `standard_deviation`). None if the dataset has no values, or the place has fewer than four, or only zeros.
        distance: the Wasserstein-1 distance of both distributions, in standard deviations of the place; None if
            ``difference`` is None. A mix of crowded and empty scenes may have the place's mean, but a large distance.
        advice: what to change in the config; "" if there is nothing to change, or no key is known.
    """

    measure: Measure
    dataset: NDArray[np.float64]
    place: NDArray[np.float64]
    difference: float | None = None
    distance: float | None = None
    advice: str = ""

    def values(self) -> dict[str, Any]:
        """Return the row in JSON's types, unrounded; the mean of no values is None."""
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
        name: the pair's name, with the split in a dataset of several splits.
        recipe: the recipe that sampled the pair's scene; None where the config has no recipes.
        values: the measures of the left view, by the key of each measure; some may be missing.
    """

    position: int
    name: str
    recipe: str | None
    values: Mapping[str, float]


class Outlier(NamedTuple):
    """A pair whose value of a measure is ``deviations`` standard deviations from the median, ``typical``."""

    pair: MeasuredPair
    measure: Measure
    value: float
    typical: float
    deviations: float


def gather(pictures: Iterable[Mapping[str, float]]) -> Values:
    """Collect the measures of each picture, by key, into an array for each key; pictures may lack some keys."""
    found = list(pictures)
    return {
        measure.key: np.array([each[measure.key] for each in found if measure.key in each], np.float64)
        for measure in MEASURES
    }


def standard_deviation(values: NDArray[np.float64]) -> float:
    """Return the standard deviation of a measure of a place's pictures, with Bessel's correction.

    It is at least 5 % of the mean. For a single picture, it is 25 % of the mean.
    """
    mean = abs(float(values.mean()))
    return max(float(values.std(ddof=1)), 0.05 * mean) if len(values) > 1 else 0.25 * mean


def compare(dataset: Values, place: Values, recipes: Sequence[Mapping[str, Any]]) -> list[MeasureComparison]:
    """Compare each measure that the dataset's left views or the place's pictures have.

    ``recipes`` are the configs of the recipes in JSON's types, or only the config if it has no recipes.
    """
    return [
        _row(measure, dataset[measure.key], place[measure.key], recipes)
        for measure in MEASURES
        if dataset[measure.key].size or place[measure.key].size
    ]


def _row(
    measure: Measure, dataset: NDArray[np.float64], place: NDArray[np.float64], recipes: Sequence[Mapping[str, Any]]
) -> MeasureComparison:
    if len(dataset) == 0 or len(place) < MIN_PICTURES:
        return MeasureComparison(measure, dataset, place)
    from scipy.stats import wasserstein_distance  # noqa: PLC0415 - slow to load

    deviation = standard_deviation(place)
    if deviation == 0:
        # All values of the place are 0.
        return MeasureComparison(
            measure, dataset, place, advice=advice(measure, recipes, more=False) if dataset.any() else ""
        )
    difference = float(dataset.mean() - place.mean()) / deviation
    distance = float(wasserstein_distance(dataset, place)) / deviation
    change = ""
    if abs(difference) > 1:
        change = advice(measure, recipes, more=difference < 0)
    elif distance > 1:
        vary = "more: add recipes to scenes, or widen ranges" if dataset.std() < place.std() else "less: narrow ranges"
        change = f"the mean fits, but pairs should vary {vary}"
    return MeasureComparison(measure, dataset, place, difference, distance, change)


def find_outliers(pairs: Sequence[MeasuredPair]) -> list[Outlier]:
    """Return for each measure the pair that is farthest from the median, if by at least three standard deviations.

    The farthest outlier comes first. The standard deviation is estimated from the median absolute deviation. If that is
    0, since more than half of the pairs have the same value, the mean absolute deviation replaces it.
    """
    outliers = []
    for measure in MEASURES:
        valued = [pair for pair in pairs if measure.key in pair.values]
        if not valued:
            continue
        values = np.array([pair.values[measure.key] for pair in valued])
        typical = float(np.median(values))
        off = np.abs(values - typical)
        deviation = _DEVIATION_RATIO * float(np.median(off)) or float(off.mean())
        at = int(np.argmax(off))
        if deviation and off[at] >= _OUTLIER_DEVIATIONS * deviation:
            outliers.append(Outlier(valued[at], measure, float(values[at]), typical, float(off[at] / deviation)))
    return sorted(outliers, key=lambda outlier: -outlier.deviations)


def table(rows: Sequence[MeasureComparison]) -> list[tuple[str, ...]]:
    """Return a table as texts: `HEAD`, and a row for each measure; without a place, only the first three columns."""
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


def summary(rows: Sequence[MeasureComparison]) -> list[str]:
    """Return lines: how many measures are near the place's, and the advice, the most distant measure first."""
    distances = [row.distance for row in rows if row.distance is not None]
    near = sum(distance <= 1 for distance in distances)
    head = f"{near} of {len(distances)} measures within one standard deviation (sd) of the place"
    advised = sorted((row for row in rows if row.advice), key=lambda row: -(row.distance or 0.0))
    return [*[head] * bool(distances), *(f"  {row.measure.name}: {row.advice}" for row in advised)]


def _shown(values: NDArray[np.float64]) -> str:
    """Return mean and standard deviation as text, "-" if there are no values."""
    if not values.size:
        return "-"
    mean = abs(float(values.mean()))
    digits = 3 if 0 < mean < 0.1 else 2 if mean < 10 else 1 if mean < 100 else 0
    deviation = f" ± {values.std(ddof=1):.{digits}f}" if len(values) > 1 else ""
    return f"{values.mean():.{digits}f}{deviation}"
