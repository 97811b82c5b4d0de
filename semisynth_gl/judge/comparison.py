"""Compares the measures of a dataset with those of its place, and finds pairs that differ from all others."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.judge.measures import MEASURES, Measure, advice

# Minimum number of a place's pictures with which a dataset is compared. If a dataset is like its place, one measure in
# four is more than one standard deviation apart by chance with four pictures, and one in thirty with eleven.
FEWEST = 4
# As shares of a measure's mean: the standard deviation assumed for a single picture, and the minimum for several.
_UNKNOWN, _LEAST = 0.25, 0.05
# An outlier is at least _FAR standard deviations off; these are _DEVIATION median absolute deviations, if normal.
_FAR, _DEVIATION = 3.0, 1.4826

HEAD = ("measure", "unit", "dataset", "place", "off by", "apart", "advice")
Values = Mapping[str, NDArray[np.float64]]
"""For the key of each of `MEASURES`, the values (N,) of the N pictures that have the measure."""


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """A measure of a dataset, compared with the same measure of its place.

    Attributes:
        measure: the measure.
        dataset: (N,) float64, the values of the dataset's left views.
        place: (M,) float64, the values of the place's pictures; may be empty.
        difference: the dataset's mean minus the place's mean, in the place's standard deviations (`unit_of`). None if
            the dataset has no values, or the place has fewer than `FEWEST` values, or only zeros.
        distance: the Wasserstein-1 distance of both distributions, in the same unit. Advice depends on it: a mix of
            crowded and empty scenes may have the place's mean although no pair resembles the place.
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
        name: name of the pair's scene, with the split in a dataset of several splits.
        recipe: the recipe that sampled the pair's scene; None where the config has no recipes.
        values: the values of the left view, for the key of each of `MEASURES` that the view has.
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
    """Collect the measures of pictures into arrays; a picture's mapping may lack some keys."""
    found = list(pictures)
    return {
        measure.key: np.array([each[measure.key] for each in found if measure.key in each], np.float64)
        for measure in MEASURES
    }


def unit_of(values: NDArray[np.float64]) -> float:
    """Return the unit of differences: the standard deviation of a place's pictures, with Bessel's correction.

    It is at least 5 % of the mean. For a single picture, it is 25 % of the mean.
    """
    mean = abs(float(values.mean()))
    return max(float(values.std(ddof=1)), _LEAST * mean) if len(values) > 1 else _UNKNOWN * mean


def compare(dataset: Values, place: Values, recipes: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Return a row for each measure that the dataset's left views or the place's pictures have.

    ``recipes`` are the configs of the recipes in JSON's types, or only the config if it has no recipes.
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
        # All values of the place are 0, so there is no unit of differences.
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
    """For each measure, return the pair farthest from the median, if at least three standard deviations off.

    The farthest outlier comes first. The standard deviation is estimated from the median absolute deviation, or from
    the mean absolute deviation if more than half of the pairs have the same value.
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
    """Return a head and a row of texts for each measure; only the first three columns if no place was measured."""
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
    """Return lines: how many measures are near the place's, and what to change, for the farthest measures first."""
    compared = [row.distance for row in rows if row.distance is not None]
    near = sum(apart <= 1 for apart in compared)
    head = f"{near} of {len(compared)} measures within one standard deviation (sd) of the place"
    advised = sorted((row for row in rows if row.advice), key=lambda row: -(row.distance or 0.0))
    return [*[head] * bool(compared), *(f"  {row.measure.name}: {row.advice}" for row in advised)]


def _shown(values: NDArray[np.float64]) -> str:
    """Return mean and deviation as text, "-" if there are no values."""
    if not values.size:
        return "-"
    mean = abs(float(values.mean()))
    digits = 3 if 0 < mean < 0.1 else 2 if mean < 10 else 1 if mean < 100 else 0
    deviation = f" ± {values.std(ddof=1):.{digits}f}" if len(values) > 1 else ""
    return f"{values.mean():.{digits}f}{deviation}"
