"""Compares the measures of a dataset with its place: how far each is off, and what to change."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.judge.measures import MEASURES, Measure, advice

FEWEST = 4
"""Least number of a place's pictures with which a dataset is compared. With four pictures, and a dataset like its
place, one measure in four is more than one standard deviation apart by chance; with eleven pictures, one in thirty."""

# As shares of a measure's mean: the standard deviation assumed for a single picture, and the lower limit of any.
_UNKNOWN, _LEAST = 0.25, 0.05

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
            without numbers of the dataset, with fewer than `FEWEST` pictures of the place, or where all of the place's
            numbers are 0.
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


def distance(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    """Return the Wasserstein-1 distance of samples (N,) and (M,): the area between their distribution functions."""
    places = np.sort(np.concatenate([first, second]))
    below = [np.searchsorted(np.sort(each), places[:-1], "right") / len(each) for each in (first, second)]
    return float(np.abs(below[0] - below[1]) @ np.diff(places))


def compare(dataset: Values, place: Values, recipes: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Return a row for each measure that the dataset or the place has.

    Args:
        dataset: measures of the dataset's left views.
        place: measures of the place's pictures.
        recipes: the config of each recipe in JSON's types; the config itself where it has no recipes.
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
    off, apart, unit = float(ours.mean() - theirs.mean()), distance(ours, theirs), unit_of(theirs)
    change = ""
    if abs(off) > unit:
        change = advice(measure, recipes, more=off < 0)
    elif apart > unit:
        vary = "more: add recipes to scenes, or widen ranges" if ours.std() < theirs.std() else "less: narrow ranges"
        change = f"the mean fits, but pairs should vary {vary}"
    if unit == 0:
        return Row(measure, ours, theirs, advice=change)
    return Row(measure, ours, theirs, off / unit, apart / unit, change)


def table(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """Return a head and a row of texts for each measure: name, unit, both sides, difference, distance and advice.

    Without pictures of a place, only the first three columns are returned.
    """
    head = ("measure", "unit", "dataset", "place", "off by", "apart", "advice")
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
    columns = len(head) if any(row.place.size for row in rows) else 3
    return [each[:columns] for each in (head, *texts)]


def lines(rows: Sequence[Row]) -> list[str]:
    """Return the rows as lines for a terminal: the table, and what to change, the farthest measures first."""
    cells = [each[:6] for each in table(rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    aligned = [str.ljust] * 2 + [str.rjust] * 4
    shown = [
        "  ".join(align(text, width) for align, text, width in zip(aligned, row, widths, strict=False)).rstrip()
        for row in cells
    ]
    compared = [row for row in rows if row.dataset.size and len(row.place) >= FEWEST]
    if compared:
        # A measure that is 0 all over the place has no deviation: the dataset's must be 0 too.
        near = sum(not row.dataset.any() if row.distance is None else row.distance <= 1 for row in compared)
        shown += ["", f"{near} of {len(compared)} measures within one standard deviation (sd) of the place"]
    farthest = sorted(rows, key=lambda row: -(row.distance or 0.0))
    return shown + [f"  {row.measure.name}: {row.advice}" for row in farthest if row.advice]


def _shown(values: NDArray[np.float64]) -> str:
    """Return mean and deviation as text, "-" without values."""
    if not values.size:
        return "-"
    mean = abs(float(values.mean()))
    digits = 3 if 0 < mean < 0.1 else 2 if mean < 10 else 1 if mean < 100 else 0
    deviation = f" ± {values.std(ddof=1):.{digits}f}" if len(values) > 1 else ""
    return f"{values.mean():.{digits}f}{deviation}"
