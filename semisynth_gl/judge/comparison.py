"""A dataset's pairs beside the place that they are made for: how far each measure is off, and what to change."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.inputs.errors import InputError, Skipped, counted
from semisynth_gl.judge.advice import advice
from semisynth_gl.judge.measured_view import WORKING_WIDTH, MeasuredView, make_view
from semisynth_gl.judge.measures import MEASURES, Measure
from semisynth_gl.judge.place import map_view, one_of_each_scene
from semisynth_gl.textures.image_files import beside_photographs
from semisynth_gl.textures.images import ImageError, read_image
from semisynth_gl.textures.subjects import of_subjects, photographed_subjects

FEWEST = 4
"""Least number of a place's pictures whose standard deviation serves as a unit. With four pictures, and a dataset like
its place, one measure in four is more than one unit apart by chance; with eleven pictures, one in thirty."""

_ROUNDING = 1e-9
# Largest difference of means, and largest distance of distributions, that count as near, in the place's `Side.unit`.
_NEAR = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """The measures of one side's pictures.

    ``values`` has, by the key of each `Measure`, (N,) float64, the numbers of the N pictures that have the measure.
    Several photographs of one subject count as one picture, with their mean.
    """

    values: dict[str, NDArray[np.float64]]

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

    def shown(self, measure: Measure) -> str:
        """Return mean and deviation as text, "-" without pictures."""
        mean, deviation = self.mean(measure), self.deviation(measure)
        if mean is None:
            return "-"
        digits = 3 if 0 < abs(mean) < 0.1 else 2 if abs(mean) < 10 else 1 if abs(mean) < 100 else 0
        return f"{mean:.{digits}f}" + ("" if deviation is None else f" ± {deviation:.{digits}f}")


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


@dataclass(frozen=True, slots=True)
class Row:
    """A measure in the table of a comparison.

    Attributes:
        measure: the measure.
        difference: the dataset's mean minus the place's mean, in the place's `Side.unit`; None where one is missing.
        distance: the Wasserstein-1 distance of both distributions over pictures, in the same unit. It decides: a mix of
            crowded and empty scenes may have the place's mean although no pair resembles it.
        note: ``near``, ``far``, ``too few`` pictures of the place, ``unlike`` the place, whose pictures are all the
            same; "" where a side has no picture.
        advice: what to change in the config; "" where there is nothing to change, or no key is known.
    """

    measure: Measure
    difference: float | None
    distance: float | None
    note: str
    advice: str


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """The measures of a dataset and of its place.

    Attributes:
        width_px: the working width, to which all images and maps were brought.
        dataset: measures of the left views of the dataset's pairs.
        pairs: number of measured pairs, of each scene at most one.
        place: measures of the place.
        recipes: the config of each recipe in JSON's types; the config itself where it has no recipes.
    """

    width_px: int
    dataset: Side
    pairs: int
    place: MeasuredPlace
    recipes: Sequence[Mapping[str, Any]]

    @property
    def rows(self) -> list[Row]:
        """The measures that at least one side has, in the order of `MEASURES`."""
        return [
            self._row(measure)
            for measure in MEASURES
            if any(len(side.values[measure.key]) for side in (self.dataset, self.place.side))
        ]

    def _row(self, measure: Measure) -> Row:
        ours, theirs = (side.values[measure.key] for side in (self.dataset, self.place.side))
        unit = self.place.side.unit(measure)
        if not len(ours) or not len(theirs):
            return Row(measure, None, None, "", "")
        if len(theirs) < FEWEST:
            return Row(measure, None, None, "too few", "")
        off = float(ours.mean() - theirs.mean())
        if unit is None:
            if np.isclose(ours.mean(), theirs.mean()):
                return Row(measure, None, None, "", "")
            return Row(measure, None, None, "unlike", advice(measure, self.recipes, more=off < 0))
        row = Row(measure, off / unit, distance(ours, theirs) / unit, "near", "")
        if distance(ours, theirs) <= _NEAR * unit:
            return row
        far = advice(measure, self.recipes, more=off < 0) if abs(off) > _NEAR * unit else self._spread(ours, theirs)
        return replace(row, note="far", advice=far)

    def _spread(self, ours: NDArray[np.float64], theirs: NDArray[np.float64]) -> str:
        """Return how to change the spread of a measure whose mean fits."""
        if len(ours) < 2:
            return ""
        ratio = float(ours.std(ddof=1) / theirs.std(ddof=1))
        if len(self.recipes) > 1:
            change = f"let the recipes in scenes differ {'more' if ratio < 1 else 'less'}"
        else:
            change = "add recipes to scenes, or widen ranges" if ratio < 1 else "narrow the ranges of its keys"
        return f"the mean fits, the spread is {ratio:.1f} times the place's: {change}"

    @property
    def photographs(self) -> str:
        """The number of photographs, as text."""
        place = self.place
        return f"{counted(place.photographs, 'photograph')}{of_subjects(place.photographs, place.subjects)}"

    def table(self) -> list[tuple[str, ...]]:
        """Return a head and a row for each measure: name, unit, both sides, difference, distance and advice."""
        table: list[tuple[str, ...]] = [("measure", "unit", "dataset", "place", "off by", "apart", "advice")]
        for row in self.rows:
            off = row.note if row.difference is None else f"{row.difference:+.1f} sd"
            apart = "" if row.distance is None else f"{row.distance:.1f} sd"
            sides = (side.shown(row.measure) for side in (self.dataset, self.place.side))
            table.append((row.measure.name, row.measure.unit, *sides, off, apart, row.advice))
        return table

    def lines(self) -> list[str]:
        """Return the comparison as lines for a terminal: the table, and what to change, the farthest measures first."""
        place, rows = self.place, self.rows
        maps = f"{counted(place.maps, 'disparity map')} ({place.maps_with_image} with their image)"
        lines = [f"{counted(self.pairs, 'pair')}, {self.photographs}, {maps}; all at a width of {self.width_px} px", ""]
        table = [row[:-1] for row in self.table()]
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        for texts in table:
            cells = [text.ljust(size) for text, size in zip(texts[:2], widths[:2], strict=True)]
            cells += [text.rjust(size) for text, size in zip(texts[2:], widths[2:], strict=True)]
            lines.append("  ".join(cells).rstrip())
        few = sum(row.note == "too few" for row in rows)
        if few:
            there = f"there are {self.photographs}, {counted(place.maps, 'map')}"
            too_few = f"Too few pictures of the place to tell how far {counted(few, 'measure')} may be off"
            lines += ["", f"{too_few}: at least {FEWEST} pictures are needed, better a few dozen; {there}"]
        compared = [row for row in rows if row.distance is not None]
        near = sum(row.note == "near" for row in rows)
        lines += ["", f"{near} of {counted(len(compared), 'measure')} within one standard deviation (sd) of the place"]
        for row in sorted(compared, key=lambda row: -(row.distance or 0.0)):
            if row.note == "far":
                lines.append(f"  {row.measure.name}, {row.distance:.1f} sd apart: {row.advice or 'no key'}")
        for row in rows:
            if row.note == "unlike":
                lines.append(
                    f"  {row.measure.name}, the same in all pictures of the place, not here: {row.advice or 'no key'}"
                )
        return lines

    def notes(self) -> list[str]:
        """Return sentences about pictures that were left out, or used in part only."""
        notes = [f"left out: {skipped}" for skipped in self.place.skipped]
        if self.place.narrow:
            notes.append(
                f"{counted(self.place.narrow, 'photograph')} narrower than {self.width_px} px, used for luminance "
                "only; a smaller --width uses them for all measures"
            )
        if self.place.sparse_maps:
            notes.append(
                f"{counted(self.place.sparse_maps, 'map')} with disparities in fewer than half of the pixels, used for "
                "disparity only"
            )
        return notes

    def values(self) -> dict[str, Any]:
        """Return all results in JSON's types, unrounded, with None for values that a side does not have."""

        def side(values: Side, measure: Measure) -> dict[str, Any]:
            return {
                "mean": values.mean(measure),
                "deviation": values.deviation(measure),
                "values": values.values[measure.key].tolist(),
            }

        return {
            "width_px": self.width_px,
            "pairs": self.pairs,
            "photographs": self.place.photographs,
            "subjects": self.place.subjects,
            "maps": self.place.maps,
            "measures": [
                {
                    "name": row.measure.key,
                    "meaning": row.measure.name,
                    "unit": row.measure.unit,
                    "dataset": side(self.dataset, row.measure),
                    "place": side(self.place.side, row.measure),
                    **{key: value for key, value in asdict(row).items() if key != "measure"},
                }
                for row in self.rows
            ],
        }


def distance(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    """Return the Wasserstein-1 distance of samples (N,) and (M,): the area between their distribution functions."""
    places = np.sort(np.concatenate([first, second]))
    below = [np.searchsorted(np.sort(each), places[:-1], "right") / len(each) for each in (first, second)]
    return float(np.abs(below[0] - below[1]) @ np.diff(places))


def measure_view(view: MeasuredView) -> dict[str, float]:
    """Return the measures that a view has, by their keys."""
    return {each.key: value for each in MEASURES if (value := each.measure(view)) is not None}


def side_of(pictures: Iterable[Mapping[str, float]]) -> Side:
    """Return a side from the measures of each of its pictures; see `measure_view`."""
    found = list(pictures)
    keys = (measure.key for measure in MEASURES)
    return Side({key: np.array([each[key] for each in found if key in each], np.float64) for key in keys})


def frame_view(frame: StoredFrame, width_px: int = WORKING_WIDTH) -> MeasuredView:
    """Return a pair's left view at the working width ``width_px``."""
    signed = frame.encodings.signed
    return make_view(frame.name, width_px, image=frame.left.image, disparity=frame.left.disparity, signed=signed)


def measure_place(
    photographs: Sequence[Path],
    maps: Sequence[Path],
    width_px: int,
    png_scale: float = KITTI_DISPARITY.steps,
    depths_of: StereoCamera | None = None,
) -> MeasuredPlace:
    """Measure a place's photographs, where each subject counts as one picture, and its maps, at a working width.

    Masks and maps among the photographs are left out, and so are further maps of the same scene; see `left_out`.

    Args:
        photographs: image files.
        maps: disparity maps, true or predicted, with ``png_scale`` levels per pixel of disparity in 16-bit PNG.
        width_px: the working width.
        png_scale: see ``maps``.
        depths_of: the rectified pair, if the maps hold depths of its left view instead.

    Raises:
        InputError: where no photograph can be read, or a map does not fit its image or has no disparity.
        ReadError: where a map cannot be read.
    """
    images = [path for path in photographs if not beside_photographs(path)]
    if not images:
        raise InputError("no photographs to compare with: expected at least one image that is not a mask or map")
    skipped: list[Skipped] = []
    subjects: list[dict[str, float]] = []
    measured = narrow = with_image = sparse = 0
    for paths in photographed_subjects(images):
        pictures = []
        for path in paths:
            try:
                view = make_view(str(path), width_px, image=read_image(path))
            except ImageError as error:
                skipped.append(Skipped(path, error.reason))
                continue
            pictures.append(measure_view(view))
            narrow += view.enlarged
        measured += len(pictures)
        if pictures:
            side = side_of(pictures)
            subjects.append({key: float(values.mean()) for key, values in side.values.items() if len(values)})
    if not subjects:
        raise InputError(f"none of {counted(len(skipped), 'photograph')} can be read; the first: {skipped[0]}")
    measured_maps = []
    for path in one_of_each_scene(maps):
        view = map_view(path, width_px, png_scale, depths_of)
        measured_maps.append(measure_view(view))
        with_image += view.luminance is not None
        sparse += view.surfaces is None
    of_images, of_maps = side_of(subjects), side_of(measured_maps)
    sides = {each.key: (of_images if each.of_images else of_maps).values[each.key] for each in MEASURES}
    return MeasuredPlace(
        Side(sides), measured, len(subjects), narrow, len(measured_maps), with_image, sparse, tuple(skipped)
    )
