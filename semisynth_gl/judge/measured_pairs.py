"""Read a sample of a dataset's pairs, each once, measure them, and find the pairs that are farthest from typical."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from semisynth_gl.dataset.reader import Dataset
from semisynth_gl.histogram import Histogram, PixelCount
from semisynth_gl.judge.measured_view import make_view
from semisynth_gl.judge.measures import MEASURES, Measure, measure_view
from semisynth_gl.listener import FinishedPair, Listener

# Number of bins in which disparities are counted: so many that the bins do not affect the distance of distributions.
_BINS = 1024
# A normal distribution's standard deviation in units of its median absolute deviation.
_DEVIATION = 1.4826
_FAR = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPair:
    """The measures of one pair.

    Attributes:
        position: index of the pair in the `Dataset` that was measured.
        name: name of the pair's scene, with the split in a dataset of several splits.
        recipe: name of the pair's recipe; None where the config has no recipes.
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


def measure_pairs(
    dataset: Dataset, positions: Sequence[int], width_px: int, target: Histogram, listener: Listener
) -> tuple[list[MeasuredPair], Histogram | None]:
    """Read pairs and measure their left views.

    Args:
        dataset: the dataset to measure.
        positions: indices of the pairs in the dataset, at least one.
        width_px: the working width of the measures.
        target: the wanted distribution of disparity, whose edges the returned one has, too.
        listener: is told the number of pairs, and each pair.

    Returns:
        The pairs, and the distribution of disparity over all pixels of their left views; None where no pixel has a
        disparity.

    Raises:
        ReadError: where a pair cannot be read.
    """
    listener.on_total(len(positions))
    pairs = []
    plan = dataset.about.plan
    first = dataset[positions[0]].camera
    low = min(0.0, -first.doffs_px, target.edges_px[0])
    high = max(plan.config.disparity.max_px or first.width_px, target.edges_px[-1])
    count = PixelCount(np.union1d(np.linspace(low, high, _BINS + 1), target.edges_px))
    for position in positions:
        frame = dataset[position]
        count.add(frame.left.disparity)
        view = make_view(width_px, frame.left.image, frame.left.disparity, signed=dataset.about.plan.encodings.signed)
        name = frame.name if len(plan.pairs) == 1 else f"{frame.split} {frame.name}"
        pairs.append(MeasuredPair(position, name, frame.recipe, measure_view(view)))
        listener.on_pair(FinishedPair(*dataset.pair(position)))
    return pairs, count.histogram if count.counts.any() else None


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
