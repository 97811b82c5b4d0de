"""Measure a sample of a dataset's pairs from their files, and find the pairs that are farthest from typical."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import cast

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.reader import Dataset, StoredIndex
from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame.channels import OCCLUDED
from semisynth_gl.histogram import Histogram, PixelCount
from semisynth_gl.inputs.errors import InputError, SemisynthError
from semisynth_gl.listener import FinishedPair, Listener
from semisynth_gl.reporting.rays import RayCaster, Rays
from semisynth_gl.reporting.redraws import PairKey
from semisynth_gl.seeds.splits import SplitName
from semisynth_gl.seeds.spread import spread
from semisynth_gl.textures.crops import least_texture

RAYS = 1000
"""Approximate number of rays for each pair, on a square grid over the left view."""

# Most pairs with rays: casting the rays of a pair takes several times as long as reading the pair.
_MOST_SCENES = 64
# Number of bins in which disparities are counted: so many that the bins do not affect the distance of distributions.
_BINS = 1024
_FLOAT32 = 2.0**-23
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
class RecipeMeasures:
    """The measures of a recipe's sampled pairs: means of `PairMeasures`, and the sum of redraws.

    Attributes:
        name: name of the recipe.
        wanted: share of sequences that the config gives the recipe; None where this version cannot read the config.
        pairs: number of the recipe's sampled pairs.
        median_px: mean of the pairs' medians; like the other means, None where no pair has a value.
    """

    name: str
    wanted: float | None
    pairs: int
    median_px: float | None
    occluded: float | None
    texture: float | None
    redraws: int


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """The measures of a sample of a dataset.

    Attributes:
        dataset_pairs: number of pairs of the dataset, or of the split that the sample is from.
        pairs: measures of each pair of the sample that could be read.
        recipes: measures of each recipe.
        unread: messages about the pairs of the sample that could not be read.
        disparity: distribution of disparity over all pixels of the left views; None where no pixel has a disparity.
        target: distribution that the config asks for; None where this version cannot read the config.
        target_fault: why this version cannot read the config; None where it can.
        spacing_px: distance between neighbouring pixels of the grid of rays.
        depth_m: (D,) planar depths of the grid's pixels in all pairs, from the stored disparity, without the sky.
        rays: rays through the grid's pixels, in at most 64 pairs.
        ray_faults: number of pairs without rays, by the reason.
    """

    dataset_pairs: int
    pairs: tuple[PairMeasures, ...]
    recipes: tuple[RecipeMeasures, ...]
    unread: tuple[str, ...]
    disparity: Histogram | None
    target: Histogram | None
    target_fault: str | None
    spacing_px: int
    depth_m: NDArray[np.float64]
    rays: Rays
    ray_faults: Mapping[str, int]


def measure(
    dataset: Dataset,
    positions: Sequence[int],
    redraws: Mapping[PairKey, Sequence[str]],
    listener: Listener | None = None,
) -> Measurement:
    """Read pairs and measure them.

    Args:
        dataset: the dataset to measure.
        positions: indices of the pairs in the dataset.
        redraws: messages about the failed attempts of each pair that was drawn again; see `read_redraws`.
        listener: is told the number of pairs, and each pair.

    Raises:
        InputError: where none of the pairs can be read.
    """
    index = dataset.about
    listener = listener or Listener()
    listener.on_total(len(positions))
    target, fault, wanted = None, None, dict[str, float]()
    try:
        config = index.plan.config
        wanted = {recipe.name: recipe.share for recipe in config.recipes() if recipe.name is not None}
        target = config.shown_histogram()
    except InputError as error:
        fault = str(error)
    caster = RayCaster(index)
    count: PixelCount | None = None
    spacing_px = 0
    pairs, unread, depths, rays = [], [], [], []
    ray_faults: Counter[str] = Counter()
    with_rays = {positions[number] for number in spread(len(positions), _MOST_SCENES)}
    for position in positions:
        try:
            frame = dataset[position]
        except SemisynthError as error:
            unread.append(str(error))
        else:
            count = count or PixelCount(_edges(index, target, frame))
            count.add(frame.left.disparity)
            pairs.append(_measure_pair(index, position, frame, redraws))
            height, width = frame.left.disparity.shape
            spacing_px = max(1, round(sqrt(height * width / RAYS)))
            columns, rows = (np.arange(spacing_px // 2, side, spacing_px) for side in (width, height))
            x, y = np.tile(columns, len(rows)), np.repeat(rows, len(columns))
            depths.append(_depth_m(frame, x, y))
            if position in with_rays:
                try:
                    rays.append(caster.cast(frame, x, y))
                except InputError as error:
                    ray_faults[str(error)] += 1
        listener.on_pair(FinishedPair(*dataset.pair(position)))
    if not pairs:
        fault = f"the fault of the first: {unread[0]}" if unread else "the sample is empty"
        raise InputError(f"{index.address}: no pair could be read; {fault}")
    return Measurement(
        dataset_pairs=len(dataset),
        pairs=tuple(pairs),
        recipes=_measure_recipes(pairs, wanted),
        unread=tuple(unread),
        disparity=count.histogram if count is not None and count.counts.any() else None,
        target=target,
        target_fault=fault,
        spacing_px=spacing_px,
        depth_m=np.concatenate(depths),
        rays=Rays.joined(rays),
        ray_faults=ray_faults,
    )


def _depth_m(frame: StoredFrame, x: NDArray[np.int64], y: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the left view's depths at pixels x (R,) and y (R,), without depths that may be infinite."""
    disparity_px = frame.left.disparity[y, x].astype(np.float64)
    known = np.isfinite(disparity_px)
    x_px, y_px, disparity_px = x[known].astype(np.float64), y[known].astype(np.float64), disparity_px[known]
    beyond_px = frame.rounding_px(disparity_px) + _FLOAT32 * abs(frame.camera.doffs_px)
    depth_m = frame.camera.depth_at("left", x_px, y_px, disparity_px)
    farthest_m = frame.camera.depth_at("left", x_px, y_px, disparity_px - beyond_px)
    # A depth beyond infinity is negative.
    return depth_m[(farthest_m > 0) & np.isfinite(farthest_m)]


def _edges(index: StoredIndex, target: Histogram | None, frame: StoredFrame) -> NDArray[np.float64]:
    """Return the edges of the bins of disparity: from 0 to the config's limit, or to the image's width without a limit.

    The target's edges are among them. Bins of signed disparities begin at that of infinity, if it is below 0.
    """
    target_edges = [] if target is None else target.edges_px.tolist()
    limit_px = index.plan.config.disparity.max_px
    high = max([frame.left.disparity.shape[1] if limit_px is None else limit_px, *target_edges])
    low = min([0.0, *([-frame.camera.doffs_px] if index.signed else []), *target_edges])
    return np.union1d(np.linspace(low, high, _BINS + 1), target_edges)


def _measure_pair(
    index: StoredIndex, position: int, frame: StoredFrame, redraws: Mapping[PairKey, Sequence[str]]
) -> PairMeasures:
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
        redraws=len(redraws.get(key, ())),
        recipe=frame.recipe,
    )


def _measure_recipes(pairs: Sequence[PairMeasures], wanted: Mapping[str, float]) -> tuple[RecipeMeasures, ...]:
    found: dict[str, list[PairMeasures]] = {name: [] for name in wanted}
    for pair in pairs:
        if pair.recipe is not None:
            found.setdefault(pair.recipe, []).append(pair)
    return tuple(
        RecipeMeasures(
            name=name,
            wanted=wanted.get(name),
            pairs=len(its),
            median_px=_mean(pair.median_px for pair in its),
            occluded=_mean(pair.occluded for pair in its),
            texture=_mean(pair.texture for pair in its),
            redraws=sum(pair.redraws for pair in its),
        )
        for name, its in found.items()
    )


def _mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None and np.isfinite(value)]
    return float(np.mean(known)) if known else None


@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity by which pairs are compared.

    Attributes:
        name: name with the unit.
        attribute: attribute of `PairMeasures` that has the value; None or NaN where a pair has none.
        format: format specification for a value.
    """

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
