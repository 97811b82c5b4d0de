"""The two sides of a comparison: the measures of a dataset's pairs, and the measures of a place."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.comparison.measured_view import WORKING_WIDTH, MeasuredView, make_view
from semisynth_gl.comparison.measures import MEASURES, PROFILES, Measure
from semisynth_gl.comparison.place import PlaceFiles, map_views, photograph_views
from semisynth_gl.dataset.reader import Dataset
from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.inputs.errors import InputError, Skipped, counted
from semisynth_gl.listener import FinishedPair, Listener
from semisynth_gl.seeds.spread import spread
from semisynth_gl.textures.subjects import photographed_subjects

SAMPLE = 100
"""Default number of a dataset's pairs to measure."""

FEWEST = 4
"""Least number of a place's pictures whose standard deviation serves as a unit. With four pictures, and a dataset like
its place, one measure in four is more than one unit apart by chance; with eleven pictures, one in thirty."""

_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """The measures of one side's pictures.

    Attributes:
        values: by the key of each `Measure`, (N,) float64, the numbers of the N pictures that have the measure. Several
            photographs of one subject count as one picture, with their mean.
        profiles: by the key of each `Profile`, (N, K) float64, the values of the N pictures that have the profile;
            photographs of one subject count as in ``values``.
    """

    values: dict[str, NDArray[np.float64]]
    profiles: dict[str, NDArray[np.float64]]

    def mean(self, measure: Measure) -> float | None:
        """Return the mean over the pictures that have the measure; None without such pictures."""
        values = self.values[measure.key]
        return float(values.mean()) if len(values) else None

    def deviation(self, measure: Measure) -> float | None:
        """Return the standard deviation over pictures, with Bessel's correction; None with fewer than two."""
        values = self.values[measure.key]
        return float(values.std(ddof=1)) if len(values) > 1 else None

    def unit(self, measure: Measure) -> float | None:
        """Return the deviation, in which differences are expressed.

        The result is None with fewer than `FEWEST` pictures, or where the value of all pictures is the same.
        """
        mean, deviation = self.mean(measure), self.deviation(measure)
        if mean is None or deviation is None or len(self.values[measure.key]) < FEWEST:
            return None
        return deviation if deviation > _ROUNDING * abs(mean) else None


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPlace:
    """The measures of a place.

    Attributes:
        side: the measures; those that need only an image are taken from the photographs, all others from the maps.
        photographs: number of measured photographs.
        subjects: number of subjects that the photographs show; each subject counts once.
        narrow: number of photographs that are narrower than the working width.
        maps: number of measured maps.
        maps_with_image: number of maps with an image beside them.
        sparse_maps: number of maps with a disparity in fewer than half of their pixels.
        skipped: photographs that cannot be read.
    """

    side: Side
    photographs: int
    subjects: int
    narrow: int
    maps: int
    maps_with_image: int
    sparse_maps: int
    skipped: tuple[Skipped, ...]


def distance(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    """Return the Wasserstein-1 distance of samples (N,) and (M,): the area between their distribution functions."""
    places = np.sort(np.concatenate([first, second]))
    below = [np.searchsorted(np.sort(each), places[:-1], "right") / len(each) for each in (first, second)]
    return float(np.abs(below[0] - below[1]) @ np.diff(places))


def measure_views(views: Iterable[MeasuredView], *, of_images: bool | None = None) -> Side:
    """Measure views one by one, without keeping them.

    With ``of_images`` True, only the measures and profiles that need only an image are taken; with False, only all
    others; with None, all of them. The other measures are missing from the result.
    """
    tables = [[each for each in table if of_images in (None, each.of_images)] for table in (MEASURES, PROFILES)]
    found: list[dict[str, list[Any]]] = [{each.key: [] for each in table} for table in tables]
    for view in views:
        for table, values in zip(tables, found, strict=True):
            for each in table:
                value = each.measure(view)
                if value is not None:
                    values[each.key].append(value)
    return Side(*({key: np.array(each, np.float64) for key, each in values.items()} for values in found))


def sampled_pairs(pairs: int, per_scene: int, sample: int) -> list[int]:
    """Return the numbers of at most ``sample`` evenly spread pairs of a dataset, of each scene at most one.

    Pairs of one scene share their left image; the scenes take turns in which of their pairs is taken.
    """
    scenes = range(-(-pairs // per_scene))
    of_scenes = [min(scene * per_scene + scene % per_scene, pairs - 1) for scene in scenes]
    return [of_scenes[scene] for scene in spread(len(scenes), min(sample, len(scenes)))]


def measure_dataset(dataset: Dataset, width_px: int, pairs: Sequence[int], listener: Listener | None = None) -> Side:
    """Measure the left views of some pairs of a dataset, at the working width ``width_px``.

    The listener is told the number of pairs to measure, and each measured pair.
    """
    listener = listener or Listener()
    listener.on_total(len(pairs))

    def views() -> Iterator[MeasuredView]:
        for number in pairs:
            yield frame_view(dataset[number], width_px)
            listener.on_pair(FinishedPair(*dataset.pair(number)))

    return measure_views(views())


def _one_sample_each(sides: Sequence[Side]) -> Side:
    """Return a side with one picture for each of ``sides``: the mean of its pictures."""

    def means(arrays: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
        return np.array([array.mean(axis=0) for array in arrays if len(array)], np.float64)

    return Side(
        {key: means(side.values[key] for side in sides) for key in sides[0].values},
        {key: means(side.profiles[key] for side in sides) for key in sides[0].profiles},
    )


@dataclass(frozen=True, slots=True)
class _Facts:
    """The facts of a view that `MeasuredPlace` counts; the views themselves would fill the memory."""

    narrow: bool
    with_image: bool
    sparse: bool


def _noted(views: Iterable[MeasuredView], facts: list[_Facts]) -> Iterator[MeasuredView]:
    """Yield the views unchanged, and add the facts of each to ``facts``."""
    for view in views:
        facts.append(_Facts(view.enlarged, view.luminance is not None, view.surfaces is None))
        yield view


def measure_place(place: PlaceFiles, width_px: int) -> MeasuredPlace:
    """Measure a place's photographs, where each subject counts as one picture, and its maps, at a working width.

    Raises:
        InputError: where no photograph can be read, or a map does not fit its image or has no disparity.
        ReadError: where a map cannot be read.
    """
    skipped: list[Skipped] = []
    photographs: list[_Facts] = []
    maps: list[_Facts] = []
    sides: list[Side] = []
    subjects = 0
    for subject in photographed_subjects(place.photographs):
        before = len(photographs)
        views = photograph_views(subject, skipped, width_px)
        sides.append(measure_views(_noted(views, photographs), of_images=True))
        subjects += len(photographs) > before
    of_images = _one_sample_each(sides)
    of_maps = measure_views(_noted(map_views(place, width_px), maps), of_images=False)
    if not photographs:
        raise InputError(f"none of {counted(len(skipped), 'photograph')} can be read; the first: {skipped[0]}")
    return MeasuredPlace(
        Side(of_images.values | of_maps.values, of_images.profiles | of_maps.profiles),
        photographs=len(photographs),
        subjects=subjects,
        narrow=sum(view.narrow for view in photographs),
        maps=len(maps),
        maps_with_image=sum(view.with_image for view in maps),
        sparse_maps=sum(view.sparse for view in maps),
        skipped=tuple(skipped),
    )


def frame_view(frame: StoredFrame, width_px: int = WORKING_WIDTH) -> MeasuredView:
    """Return a pair's left view at the working width ``width_px``; the background needs the output ``instances``."""
    instances, background = frame.left.get("instances"), None
    listed = frame.provenance.get("instances")
    if instances is not None and isinstance(listed, list):
        still = np.array([False, *(instance.get("still") is True for instance in listed)])
        background = still[np.minimum(instances, len(listed))]
    return make_view(
        frame.name,
        width_px,
        image=frame.left.image,
        disparity=frame.left.disparity,
        background=background,
        signed=frame.encodings.signed,
    )
