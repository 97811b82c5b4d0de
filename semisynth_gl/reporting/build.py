"""Build the page of a dataset: measure a sample, find outliers, choose pairs to show, and render."""

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike

from semisynth_gl.dataset.reader import Dataset, read_index
from semisynth_gl.inputs.arguments import to_whole
from semisynth_gl.listener import Listener
from semisynth_gl.reporting.measure import QUANTITIES, Measurement, Outlier, PairMeasures, find_outliers, measure
from semisynth_gl.reporting.page import ShownPair, render_page
from semisynth_gl.reporting.pictures import make_pictures
from semisynth_gl.reporting.redraws import read_redraws
from semisynth_gl.seeds.splits import SplitName
from semisynth_gl.seeds.spread import spread

# For this many of the first quantities, the page also shows the farthest outlier.
_SHOWN_QUANTITIES = 3


@dataclass(frozen=True, slots=True)
class Report:
    """A page, with its numbers.

    Attributes:
        page: the page, as HTML.
        measurement: the measures of the sample.
        shown: number of pairs on the page.
        step: the page shows every ``step``-th pixel of a pair, in both directions; 0 where it shows no pair.
    """

    page: str
    measurement: Measurement
    shown: int
    step: int


def report(
    dataset: str | PathLike[str],
    *,
    pairs: int = 12,
    sample: int = 200,
    split: SplitName | None = None,
    listener: Listener | None = None,
) -> Report:
    """Measure a dataset and render its page, as ``semisynth-gl report`` does. Equal datasets give equal pages.

    Args:
        dataset: a folder, or an address that fsspec knows.
        pairs: number of pairs to show, evenly spread; the page shows up to three outliers in addition. With 0, it shows
            no pair.
        sample: number of pairs to measure, evenly spread; never fewer than ``pairs``.
        split: a split of the dataset; None for all splits.
        listener: is told the number of pairs to measure, and each measured pair.

    Raises:
        InputError: where there is no dataset, it is not finished or has no such split, or none of the sampled pairs can
            be read.
    """
    pairs, sample = to_whole("pairs", pairs, least=0), to_whole("sample", sample, least=1)
    index = read_index(dataset)
    opened = Dataset(index, split)
    redraws = read_redraws(index, split)
    positions = spread(len(opened), max(sample, pairs))
    measurement = measure(opened, positions, redraws.messages, listener)
    outliers = [outlier for quantity in QUANTITIES for outlier in find_outliers(measurement.pairs, quantity)]
    chosen = _choose(measurement.pairs, pairs, outliers)
    pictures = make_pictures([pair.position for pair, _ in chosen], opened.__getitem__)
    shown = []
    for (pair, reason), picture in zip(chosen, pictures, strict=True):
        name, number = pair.key
        label = f"{number:06d}" if len(index.plan.pairs) == 1 else f"{name} {number:06d}"
        shown.append(ShownPair(pair, label, picture, reason))
    page = render_page(index, measurement, redraws, outliers, shown)
    return Report(page, measurement, len(shown), pictures[0].step if pictures else 0)


def _choose(
    measured: Sequence[PairMeasures], pairs: int, outliers: Sequence[Outlier]
) -> list[tuple[PairMeasures, str | None]]:
    """Return the pairs to show: first evenly spread pairs, with None, then outliers, with the reason to show them."""
    evenly = [measured[number] for number in spread(len(measured), pairs)]
    chosen: dict[int, tuple[PairMeasures, str | None]] = {pair.position: (pair, None) for pair in evenly}
    for quantity in QUANTITIES[:_SHOWN_QUANTITIES] if evenly else ():
        farthest = next((outlier.pair for outlier in outliers if outlier.quantity is quantity), None)
        if farthest is not None:
            chosen.setdefault(farthest.position, (farthest, f"shown as the outlier in {quantity.name}"))
    return list(chosen.values())
