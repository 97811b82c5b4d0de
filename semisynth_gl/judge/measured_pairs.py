"""Measure a sample of a dataset's pairs from their files, and find the pairs that are farthest from typical."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.reader import Dataset, StoredIndex, read_record
from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame.channels import OCCLUDED
from semisynth_gl.histogram import Histogram, PixelCount
from semisynth_gl.inputs.errors import InputError, ReadError, SemisynthError
from semisynth_gl.judge.comparison import frame_view, measure_view
from semisynth_gl.listener import FinishedPair, Listener
from semisynth_gl.seeds.splits import SplitName
from semisynth_gl.textures.crops import least_texture

PairKey = tuple[SplitName, int]
"""A pair's split, and its number in the split."""

# Number of bins in which disparities are counted: so many that the bins do not affect the distance of distributions.
_BINS = 1024
# A normal distribution's standard deviation in units of its median absolute deviation.
_DEVIATION = 1.4826


@dataclass(frozen=True, slots=True)
class PairMeasures:
    """The measures of one pair.

    Attributes:
        position: index of the pair in the `Dataset` that was measured.
        key: the pair's split, and its number in the split.
        name: name of the pair's scene, with the split in a dataset of several splits.
        median_px: median disparity of the left view; NaN where no pixel has a disparity.
        occluded: share of the left view's pixels that are hidden from the right eye, from 0 to 1; None without a mask.
        invalid: share of the left view's pixels without disparity, from 0 to 1.
        texture: texture measure of the flatter of the two stored images, levels; ``checks.min_texture`` applies to the
            same measure before imperfections.
        redraws: number of times that the pair was drawn again.
        recipe: name of the pair's recipe; None where the config has no recipes.
    """

    position: int
    key: PairKey
    name: str
    median_px: float
    occluded: float | None
    invalid: float
    texture: float
    redraws: int
    recipe: str | None = None


@dataclass(frozen=True, slots=True)
class Redraws:
    """The failed attempts of a dataset, or of one of its splits.

    Attributes:
        pairs: number of pairs in the records.
        messages: a message for each failed attempt, by the pair's key, for the pairs that have failed attempts; those
            of a sequence are listed under its first frame.
        faults: number of failed attempts and first message of each kind of fault, the most frequent kind first.
        unread: messages about the records that could not be read.
    """

    pairs: int
    messages: Mapping[PairKey, tuple[str, ...]]
    faults: Mapping[str, tuple[int, str]]
    unread: tuple[str, ...]

    @property
    def attempts(self) -> int:
        """Number of all failed attempts."""
        return sum(map(len, self.messages.values()))


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """The measures of a sample of a dataset.

    Attributes:
        dataset_pairs: number of pairs of the dataset, or of the split that the sample is from.
        pairs: measures of each pair of the sample that could be read.
        recipes: a row for each recipe. ``name`` and ``wanted``, the config's share of sequences; None if this version
            cannot read the config. ``pairs``, the number of pairs in the sample, and their ``redraws``. The means of
            their other measures; None if no pair has a value.
        redraws: the failed attempts of the dataset or split.
        unread: messages about the pairs of the sample that could not be read.
        disparity: distribution of disparity over all pixels of the left views; None where no pixel has a disparity.
        target: distribution that the config asks for; None where this version cannot read the config.
        target_fault: why this version cannot read the config; None where it can.
        left_views: each `Measure` of the sample's left views, of each scene one, by key; empty without a place.
    """

    dataset_pairs: int
    pairs: tuple[PairMeasures, ...]
    recipes: tuple[Mapping[str, Any], ...]
    redraws: Redraws
    unread: tuple[str, ...]
    disparity: Histogram | None
    target: Histogram | None
    target_fault: str | None
    left_views: tuple[Mapping[str, float], ...] = ()


def measure(
    dataset: Dataset,
    positions: Sequence[int],
    split: SplitName | None = None,
    listener: Listener | None = None,
    width_px: int | None = None,
) -> Measurement:
    """Read pairs, each once, and measure them.

    Args:
        dataset: the dataset to measure.
        positions: indices of the pairs in the dataset.
        split: the split that the dataset is limited to.
        listener: is told the number of pairs, and each pair.
        width_px: working width at which to take the measures of left views, too; None for not to.

    Raises:
        InputError: where none of the pairs can be read.
    """
    index = dataset.about
    listener = listener or Listener()
    listener.on_total(len(positions))
    redraws = read_redraws(index, split)
    target, fault, wanted = None, None, dict[str, float]()
    try:
        config = index.plan.config
        wanted = {recipe.name: recipe.share for recipe in config.recipes() if recipe.name is not None}
        target = config.shown_histogram()
    except InputError as error:
        fault = str(error)
    count: PixelCount | None = None
    pairs: list[PairMeasures] = []
    unread: list[str] = []
    left_views: dict[tuple[str | None, int], dict[str, float]] = {}
    for position in positions:
        try:
            frame = dataset[position]
        except SemisynthError as error:
            unread.append(str(error))
        else:
            count = count or PixelCount(_edges(index, target, frame))
            count.add(frame.left.disparity)
            pairs.append(_measure_pair(index, position, frame, redraws))
            if width_px is not None:
                # Pairs of one scene share their left image.
                scene = frame.split, frame.index // index.plan.views
                if scene not in left_views:
                    left_views[scene] = measure_view(frame_view(frame, width_px))
        listener.on_pair(FinishedPair(*dataset.pair(position)))
    if not pairs:
        fault = f"the fault of the first: {unread[0]}" if unread else "the sample is empty"
        raise InputError(f"{index.address}: no pair could be read; {fault}")
    return Measurement(
        dataset_pairs=len(dataset),
        pairs=tuple(pairs),
        recipes=_measure_recipes(pairs, wanted),
        redraws=redraws,
        unread=tuple(unread),
        disparity=count.histogram if count is not None and count.counts.any() else None,
        target=target,
        target_fault=fault,
        left_views=tuple(left_views.values()),
    )


def _edges(index: StoredIndex, target: Histogram | None, frame: StoredFrame) -> NDArray[np.float64]:
    """Return the edges of the bins of disparity: from 0 to the config's limit, or to the image's width without a limit.

    The target's edges are among them. Bins of signed disparities begin at that of infinity, if it is below 0.
    """
    target_edges = [] if target is None else target.edges_px.tolist()
    limit_px = index.plan.config.disparity.max_px
    high = max([frame.left.disparity.shape[1] if limit_px is None else limit_px, *target_edges])
    low = min([0.0, *([-frame.camera.doffs_px] if index.signed else []), *target_edges])
    return np.union1d(np.linspace(low, high, _BINS + 1), target_edges)


def _measure_pair(index: StoredIndex, position: int, frame: StoredFrame, redraws: Redraws) -> PairMeasures:
    key = cast("SplitName", frame.split), frame.index
    valid = frame.left.disparity[np.isfinite(frame.left.disparity)]
    mask = frame.left.get("visibility")
    return PairMeasures(
        position=position,
        key=key,
        name=frame.name if len(index.plan.pairs) == 1 else f"{frame.split} {frame.name}",
        median_px=float(np.median(valid)) if valid.size else float("nan"),
        occluded=None if mask is None else float((mask == OCCLUDED).mean()),
        invalid=1 - valid.size / frame.left.disparity.size,
        texture=least_texture((frame.left.image, frame.right.image)),
        redraws=len(redraws.messages.get(key, ())),
        recipe=frame.recipe,
    )


def _measure_recipes(pairs: Sequence[PairMeasures], wanted: Mapping[str, float]) -> tuple[Mapping[str, Any], ...]:
    found: dict[str, list[PairMeasures]] = {name: [] for name in wanted}
    for pair in pairs:
        if pair.recipe is not None:
            found.setdefault(pair.recipe, []).append(pair)

    def mean(values: Iterable[float | None]) -> float | None:
        known = [value for value in values if value is not None and np.isfinite(value)]
        return float(np.mean(known)) if known else None

    return tuple(
        {
            "name": name,
            "wanted": wanted.get(name),
            "pairs": len(its),
            "redraws": sum(pair.redraws for pair in its),
            **{key: mean(getattr(pair, key) for pair in its) for key in ("median_px", "occluded", "texture")},
        }
        for name, its in found.items()
    )


def read_redraws(index: StoredIndex, split: SplitName | None = None) -> Redraws:
    """Read the records of all shards, or of the shards of one split; unreadable records are listed in the result."""
    messages: dict[PairKey, tuple[str, ...]] = {}
    examples: dict[str, str] = {}
    counts: Counter[str] = Counter()
    unread: list[str] = []
    pairs = 0
    for shard in index.plan.shards:
        if split not in (None, shard.split):
            continue
        try:
            record = read_record(index.root, shard, packed=index.plan.layout.packed)
        except ReadError as error:
            unread.append(str(error))
            continue
        pairs += len(record.samples)
        messages |= {(shard.split, sample.pair): tuple(sample.redrawn) for sample in record.samples if sample.redrawn}
    for message in (each for attempts in messages.values() for each in attempts):
        clauses = {clause.partition(":")[0]: clause for clause in message.split("; ")}
        counts.update(clauses.keys())
        examples = clauses | examples
    faults = {name: (count, examples[name]) for name, count in counts.most_common()}
    return Redraws(pairs, messages, faults, tuple(unread))


class Quantity(NamedTuple):
    """A quantity by which pairs are compared: name with unit, attribute of `PairMeasures`, and format of a value."""

    name: str
    attribute: str
    format: str = ".3g"


QUANTITIES = (
    Quantity("median disparity, px", "median_px", ".4g"),
    Quantity("occluded pixels", "occluded", ".2%"),
    Quantity("texture measure, levels", "texture"),
    Quantity("pixels without disparity", "invalid", ".3%"),
    Quantity("times drawn again", "redraws", ".0f"),
)


@dataclass(frozen=True, slots=True)
class Outlier:
    """A pair whose value of a quantity is far from the typical value.

    Attributes:
        pair: the pair.
        quantity: the quantity.
        value: the pair's value.
        typical: the median over all measured pairs.
        deviations: distance of value and median in standard deviations, as estimated by `find_outliers`.
    """

    pair: PairMeasures
    quantity: Quantity
    value: float
    typical: float
    deviations: float


def find_outliers(pairs: Sequence[PairMeasures], quantity: Quantity, most: int = 3) -> list[Outlier]:
    """Return the at most ``most`` pairs that are farthest from the median of a quantity, the farthest first.

    The standard deviation is estimated from the median absolute deviation. Where more than half of the pairs have the
    same value, the mean absolute deviation is used instead. Pairs that do not differ from the median are left out.
    """
    # As float64, None is NaN.
    values = np.array([getattr(pair, quantity.attribute) for pair in pairs], np.float64)
    known = np.isfinite(values)
    valued, values = [pair for pair, has_value in zip(pairs, known, strict=True) if has_value], values[known]
    if not valued:
        return []
    typical = float(np.median(values))
    distance = np.abs(values - typical)
    scale = _DEVIATION * float(np.median(distance)) or float(distance.mean())
    farthest = [number for number in np.argsort(-distance, kind="stable")[:most] if distance[number] > 0]
    return [
        Outlier(valued[number], quantity, float(values[number]), typical, float(distance[number] / scale))
        for number in farthest
    ]
