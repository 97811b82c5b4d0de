"""From a dataset to its page: what is sampled, measured, listed and shown."""

from contextlib import closing
from dataclasses import dataclass

from matplotlib import colormaps

from semisynth_gl.dataset.reader import Dataset, Index
from semisynth_gl.listener import Listener
from semisynth_gl.report.measure import Measurement, PairMeasures, measure, spread
from semisynth_gl.report.outliers import QUANTITIES, Outlier, find_outliers
from semisynth_gl.report.page import ShownPair, write_page
from semisynth_gl.report.pictures import make_pictures
from semisynth_gl.report.redraws import read_redraws
from semisynth_gl.splits import SplitName

# Perceptually uniform, and dark where things are far; as on the contact sheet.
_COLOUR_MAP = "inferno"
# Of so many quantities the farthest pair is shown too, if it is not among those that are shown anyway.
_SHOWN_QUANTITIES = 3


@dataclass(frozen=True, slots=True)
class Report:
    """A page and what it was made of.

    Attributes:
        page: HTML.
        measurement: what was measured.
        shown: how many pairs it shows.
        step: every which of their pixels; 0 where none is shown.
    """

    page: str
    measurement: Measurement
    shown: int
    step: int


def build_report(
    index: Index,
    *,
    pairs: int,
    sample: int,
    split: SplitName | None = None,
    listener: Listener | None = None,
) -> Report:
    """Measure a dataset and write its page. Equal datasets give equal pages.

    Args:
        index: the dataset's.
        pairs: how many pairs to show, 0 or more, beside outliers.
        sample: how many to measure, 1 or more; at least those that are shown.
        split: of this split alone.
        listener: hears the number of pairs to measure, and each of them.

    Raises:
        InputError: where the dataset is not finished, has no such split, or no pair of it can be read.
    """
    with closing(Dataset(index, split)) as dataset:
        redraws = read_redraws(index, split)
        positions = spread(len(dataset), max(sample, pairs))
        measurement = measure(dataset, positions, redraws.of_pair, listener)
        outliers = [each for quantity in QUANTITIES for each in find_outliers(measurement.pairs, quantity)]
        chosen = _chosen(measurement.pairs, pairs, outliers)
        pictures = make_pictures([pair.position for pair, _ in chosen], dataset.__getitem__)
    shown = [
        ShownPair(pair, _label(index, pair), picture, why)
        for (pair, why), picture in zip(chosen, pictures, strict=True)
    ]
    page = write_page(index, measurement, redraws, outliers, shown, _colours())
    return Report(page, measurement, len(shown), pictures[0].step if pictures else 0)


def _chosen(
    measured: tuple[PairMeasures, ...], pairs: int, outliers: list[Outlier]
) -> list[tuple[PairMeasures, str | None]]:
    """Pairs to show, each with why it is shown if it is no evenly spread one."""
    chosen: dict[int, tuple[PairMeasures, str | None]] = {
        measured[number].position: (measured[number], None) for number in spread(len(measured), pairs)
    }
    if not chosen:
        return []
    for quantity in QUANTITIES[:_SHOWN_QUANTITIES]:
        farthest = next((each.pair for each in outliers if each.quantity is quantity), None)
        if farthest is not None:
            chosen.setdefault(farthest.position, (farthest, f"shown as the outlier in {quantity.name}"))
    return list(chosen.values())


def _colours() -> list[tuple[int, int, int]]:
    """256 colours from far to near, 8-bit RGB."""
    return [(int(red), int(green), int(blue)) for red, green, blue, _ in colormaps[_COLOUR_MAP](range(256), bytes=True)]


def _label(index: Index, pair: PairMeasures) -> str:
    split, number = pair.key
    return f"{number:06d}" if len(index.pairs) == 1 else f"{split} {number:06d}"
