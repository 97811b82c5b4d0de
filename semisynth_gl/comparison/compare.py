"""A dataset's pairs beside the place that they are made for: measured alike, and what to change in the config."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.comparison.measures import MEASURES, PROFILES, Measure, Profile
from semisynth_gl.comparison.picture import WORKING_WIDTH, Picture, make_picture
from semisynth_gl.comparison.place import Place, map_pictures, photograph_pictures
from semisynth_gl.dataset.reader import Dataset
from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.errors import InputError, Skipped
from semisynth_gl.listener import FinishedPair, Listener

SAMPLE = 100
"""Pairs of a dataset that are measured, unless the caller wants another number."""

_OFF = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """The measures of one side's pictures.

    Attributes:
        values: by the key of each `Measure`, (N,) float64 of the N pictures that have it.
        profiles: by the key of each `Profile`, (N, K) float64 likewise.
    """

    values: Mapping[str, NDArray[np.float64]]
    profiles: Mapping[str, NDArray[np.float64]]

    def mean(self, measure: Measure) -> float | None:
        """Return the mean over pictures; None without pictures."""
        values = self.values[measure.key]
        return float(values.mean()) if len(values) else None

    def deviation(self, measure: Measure) -> float | None:
        """Return the standard deviation over pictures, with Bessel's correction; None with fewer than two."""
        values = self.values[measure.key]
        return float(values.std(ddof=1)) if len(values) > 1 else None


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """The measures of a dataset and of its place.

    Attributes:
        width_px: the working width.
        pairs: number of measured pairs.
        dataset_pairs: number of pairs that the dataset has, or its split.
        photographs: number of measured photographs.
        narrow: number of these that are narrower than the working width.
        maps: number of measured maps.
        maps_with_image: number of these with an image beside them.
        sparse_maps: number of these with a disparity in fewer than half of their pixels.
        dataset: measures of the dataset's left views.
        place: measures of the place: of images alone from its photographs, all others from its maps.
        skipped: photographs that cannot be read.
    """

    width_px: int
    pairs: int
    dataset_pairs: int
    photographs: int
    narrow: int
    maps: int
    maps_with_image: int
    sparse_maps: int
    dataset: Side
    place: Side
    skipped: tuple[Skipped, ...]

    def difference(self, measure: Measure) -> float | None:
        """Return the dataset's mean minus the place's, in standard deviations of the place's pictures; None for none.

        Where the pictures of the place all have one value, there is no such unit.
        """
        ours, theirs, deviation = self.dataset.mean(measure), self.place.mean(measure), self.place.deviation(measure)
        return None if ours is None or theirs is None or not deviation else (ours - theirs) / deviation

    def compared(self) -> list[tuple[Measure, float]]:
        """Return each measure that both sides have, with its `difference`, in the order of the table."""
        return [(measure, by) for measure in MEASURES if (by := self.difference(measure)) is not None]

    def near(self) -> list[Measure]:
        """Return the measures by which the dataset is within one standard deviation of its place."""
        return [measure for measure, by in self.compared() if abs(by) <= _OFF]

    def advice(self) -> list[tuple[Measure, float, str]]:
        """Return each measure that is off by more than one deviation, the farthest first, with what to change."""
        off = [(measure, by) for measure, by in self.compared() if abs(by) > _OFF]
        off.sort(key=lambda each: -abs(each[1]))
        return [(measure, by, measure.less if by > 0 else measure.more) for measure, by in off]


@dataclass(slots=True, eq=False)
class _Measured:
    """Collects the measures of pictures."""

    measures: Sequence[Measure]
    profiles: Sequence[Profile]
    values: dict[str, list[float]] = field(default_factory=lambda: {measure.key: [] for measure in MEASURES})
    shares: dict[str, list[NDArray[np.float64]]] = field(
        default_factory=lambda: {profile.key: [] for profile in PROFILES}
    )

    def add(self, picture: Picture) -> None:
        for measure in self.measures:
            value = measure.measure(picture)
            if value is not None:
                self.values[measure.key].append(value)
        for profile in self.profiles:
            shares = profile.measure(picture)
            if shares is not None:
                self.shares[profile.key].append(shares)


def compare_with_place(
    dataset: Dataset,
    place: Place,
    *,
    width_px: int = WORKING_WIDTH,
    sample: int = SAMPLE,
    listener: Listener | None = None,
) -> Comparison:
    """Measure a dataset and its place at one width.

    Args:
        dataset: the dataset, or one of its splits.
        place: the photographs and maps, see `find_place`.
        width_px: the working width, to which all images and maps are brought.
        sample: number of pairs to measure, evenly spread, at least 1.
        listener: hears the number of pairs, and each measured pair.

    Raises:
        InputError: where no photograph can be read, or a map does not fit its image or has no disparity.
        ReadError: where a file of the dataset or a map cannot be read.
    """
    skipped: list[Skipped] = []
    photographs, maps = (
        _Measured(
            [each for each in MEASURES if each.of_images == of_images],
            [each for each in PROFILES if each.of_images == of_images],
        )
        for of_images in (True, False)
    )
    count = narrow = 0
    for picture in photograph_pictures(place, skipped, width_px):
        photographs.add(picture)
        count += 1
        narrow += picture.enlarged
    if not count:
        raise InputError(f"none of {len(skipped)} photographs can be read; the first: {skipped[0]}")
    with_image = sparse = 0
    for picture in map_pictures(place, width_px):
        maps.add(picture)
        with_image += picture.luminance is not None
        sparse += picture.surfaces is None
    ours = _Measured(MEASURES, PROFILES)
    numbers = np.unique(np.linspace(0, len(dataset) - 1, min(sample, len(dataset))).round().astype(int)).tolist()
    listener = listener or Listener()
    listener.on_total(len(numbers))
    for number in numbers:
        ours.add(frame_picture(dataset[number], width_px))
        listener.on_pair(FinishedPair(*dataset.pair(number)))
    return Comparison(
        width_px,
        len(numbers),
        len(dataset),
        count,
        narrow,
        len(place.maps),
        with_image,
        sparse,
        _side(ours),
        _side(photographs, maps),
        tuple(skipped),
    )


def frame_picture(frame: StoredFrame, width_px: int = WORKING_WIDTH) -> Picture:
    """Return the left view of a pair as it is measured; with the output ``instances`` it has its background too."""
    instances, background = frame.left.get("instances"), None
    listed = frame.provenance.get("instances")
    if instances is not None and isinstance(listed, list):
        still = np.array([False, *(instance.get("still") is True for instance in listed)])
        background = still[np.minimum(instances, len(listed))]
    return make_picture(
        frame.name, width_px, image=frame.left.image, disparity=frame.left.disparity, background=background
    )


def comparison_table(comparison: Comparison) -> list[str]:
    """Return the lines of a table: each measure's mean and deviation on both sides, and their difference."""
    rows: list[tuple[str, ...]] = [("", "unit", "dataset", "place", "off by")]
    for measure in MEASURES:
        if comparison.dataset.mean(measure) is None and comparison.place.mean(measure) is None:
            continue
        by = comparison.difference(measure)
        sides = (_shown(side, measure) for side in (comparison.dataset, comparison.place))
        rows.append((measure.name, measure.unit, *sides, "" if by is None else f"{by:+.1f} sd"))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            [*(text.ljust(size) for text, size in zip(row[:2], widths[:2], strict=True))]
            + [text.rjust(size) for text, size in zip(row[2:], widths[2:], strict=True)]
        ).rstrip()
        for row in rows
    ]


def comparison_json(comparison: Comparison) -> dict[str, Any]:
    """Return all results in JSON's types, unrounded; what a side does not have is None."""
    advice = {measure.key: change for measure, _, change in comparison.advice()}

    def side(values: Side, measure: Measure) -> dict[str, Any]:
        return {
            "mean": values.mean(measure),
            "deviation": values.deviation(measure),
            "values": values.values[measure.key].tolist(),
        }

    def profile(values: Side, each: Profile) -> list[float] | None:
        rows = values.profiles[each.key]
        return rows.mean(axis=0).tolist() if len(rows) else None

    return {
        "width_px": comparison.width_px,
        "pairs": comparison.pairs,
        "photographs": comparison.photographs,
        "maps": comparison.maps,
        "compared": len(comparison.compared()),
        "near": len(comparison.near()),
        "measures": [
            {
                "name": measure.key,
                "meaning": measure.name,
                "unit": measure.unit,
                "dataset": side(comparison.dataset, measure),
                "place": side(comparison.place, measure),
                "difference": comparison.difference(measure),
                "advice": advice.get(measure.key),
            }
            for measure in MEASURES
        ],
        "profiles": [
            {
                "name": each.key,
                "meaning": each.name,
                "bins": each.label,
                "edges": each.edges.tolist(),
                "dataset": profile(comparison.dataset, each),
                "place": profile(comparison.place, each),
            }
            for each in PROFILES
        ],
    }


def _side(*measured: _Measured) -> Side:
    def joined(each: Measure) -> Iterator[float]:
        for part in measured:
            yield from part.values[each.key]

    return Side(
        {each.key: np.array([*joined(each)], np.float64) for each in MEASURES},
        {each.key: _stacked(part.shares[each.key] for part in measured) for each in PROFILES},
    )


def _stacked(parts: Iterable[Sequence[NDArray[np.float64]]]) -> NDArray[np.float64]:
    return np.array([shares for part in parts for shares in part], np.float64)


def _shown(side: Side, measure: Measure) -> str:
    mean, deviation = side.mean(measure), side.deviation(measure)
    if mean is None:
        return "-"
    digits = 3 if 0 < abs(mean) < 0.1 else 2 if abs(mean) < 10 else 1 if abs(mean) < 100 else 0
    return f"{mean:.{digits}f}" + ("" if deviation is None else f" ± {deviation:.{digits}f}")
