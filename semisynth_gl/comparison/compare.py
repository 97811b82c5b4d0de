"""Compare a dataset's pairs with the place that they are made for, and advise what to change in the config."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np

from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.comparison.changes import advice
from semisynth_gl.comparison.maps import map_files
from semisynth_gl.comparison.measured_view import WORKING_WIDTH, working_width
from semisynth_gl.comparison.measures import MEASURES, PROFILES, Measure, Profile
from semisynth_gl.comparison.place import find_place
from semisynth_gl.comparison.sides import (
    FEWEST,
    SAMPLE,
    MeasuredPlace,
    Side,
    distance,
    measure_dataset,
    measure_place,
    sampled_pairs,
)
from semisynth_gl.dataset.reader import open_dataset
from semisynth_gl.inputs.arguments import LEAST, to_real, to_whole
from semisynth_gl.inputs.user_files import Files, names_of
from semisynth_gl.listener import Listener
from semisynth_gl.seeds.splits import SplitName
from semisynth_gl.textures.image_files import find_images

# Largest difference of means, and largest distance of distributions, that count as near, in the place's `Side.unit`.
_OFF = _FAR = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """The measures of a dataset and of its place.

    Attributes:
        width_px: the working width, to which all images and maps were brought.
        dataset: measures of the left views of the dataset's pairs.
        pairs: number of measured pairs.
        dataset_pairs: number of all pairs of the dataset, or of the chosen split.
        place: measures of the place.
        recipes: the config of each recipe in JSON's types; the config itself where it has no recipes.
    """

    width_px: int
    dataset: Side
    pairs: int
    dataset_pairs: int
    place: MeasuredPlace
    recipes: Sequence[Mapping[str, Any]]

    def difference(self, measure: Measure) -> float | None:
        """Return the dataset's mean minus the place's mean, in the place's `Side.unit`, or None if one of them is."""
        place = self.place.side
        ours, theirs, unit = self.dataset.mean(measure), place.mean(measure), place.unit(measure)
        if ours is None or theirs is None or unit is None:
            return None
        return (ours - theirs) / unit

    def distance(self, measure: Measure) -> float | None:
        """Return the distance between both sides' distributions over their pictures.

        This is the Wasserstein-1 distance in the place's `Side.unit`; it is never less than the size of `difference`.
        Where the means agree, and the deviation of the dataset's pictures is r times that of the place's, the distance
        is about 0.8 |r - 1|. If the place has no unit or the dataset no value, the result is None.
        """
        unit, ours = self.place.side.unit(measure), self.dataset.values[measure.key]
        if unit is None or not len(ours):
            return None
        return distance(ours, self.place.side.values[measure.key]) / unit

    def compared(self) -> list[tuple[Measure, float]]:
        """Return each measure that has a `distance`, with this distance, in the order of the table."""
        return [(measure, apart) for measure in MEASURES if (apart := self.distance(measure)) is not None]

    def too_few(self) -> list[Measure]:
        """Return the measures that both sides have, but that fewer than `FEWEST` pictures of the place have."""
        theirs = self.place.side.values
        return [each for each in MEASURES if len(self.dataset.values[each.key]) and 0 < len(theirs[each.key]) < FEWEST]

    def unlike(self) -> list[tuple[Measure, str]]:
        """Return the measures that are the same in all pictures of the place, and another in the dataset.

        There is no deviation to compare with; with each measure comes the advice what to change, which may be "".
        """
        found = []
        for measure in MEASURES:
            theirs, ours = self.place.side.values[measure.key], self.dataset.mean(measure)
            if ours is None or len(theirs) < FEWEST or self.place.side.unit(measure) is not None:
                continue
            if not np.isclose(ours, theirs.mean()):
                found.append((measure, advice(measure, self.recipes, more=bool(ours < theirs.mean()))))
        return found

    def near(self) -> list[Measure]:
        """Return the measures whose distributions are at most one standard deviation apart."""
        return [measure for measure, apart in self.compared() if apart <= _FAR]

    def advice(self) -> list[tuple[Measure, float, str]]:
        """Return each measure whose distributions are more than one standard deviation apart, the farthest first.

        With each measure come its `distance` and the advice what to change, which may be "".
        """
        far = sorted((-apart, measure.name, measure) for measure, apart in self.compared() if apart > _FAR)
        return [(measure, -apart, self._change(measure)) for apart, _, measure in far]

    def _change(self, measure: Measure) -> str:
        """Return the advice for a measure: how to move its mean or, where the mean fits, how to change its spread."""
        by = self.difference(measure) or 0.0
        if abs(by) > _OFF:
            return advice(measure, self.recipes, more=by < 0)
        ours, theirs = self.dataset.deviation(measure), self.place.side.deviation(measure)
        if ours is None or theirs is None:
            return ""
        alike = ours < theirs
        if len(self.recipes) > 1:
            change = f"let the recipes in scenes differ {'more' if alike else 'less'}"
        else:
            change = "add recipes to scenes, or widen ranges" if alike else "narrow the ranges of its keys"
        return f"the mean fits, the spread is {ours / theirs:.1f} times the place's: {change}"


def compare(
    dataset: str | PathLike[str],
    images: Files,
    disparity: Files = (),
    *,
    png_scale: float = KITTI_DISPARITY.steps,
    width_px: int | None = None,
    sample: int = SAMPLE,
    split: SplitName | None = None,
    listener: Listener | None = None,
) -> Comparison:
    """Compare a dataset's pairs with the place that it is made for, as ``semisynth-gl compare`` does.

    Args:
        dataset: a folder, or an address that fsspec knows.
        images: photographs of the place: files, folders or globs.
        disparity: disparity maps of the place: .pfm, .npy and 16-bit .png files, folders or globs.
        png_scale: levels of a 16-bit PNG map per pixel of disparity.
        width_px: the width, from 32 to 4096 px, to which all images and maps are brought before they are measured; by
            default `WORKING_WIDTH`, or the pairs' own width if that is less.
        sample: number of pairs to measure, evenly spread; of a scene with several pairs, one.
        split: a split of the dataset; None for all pairs.
        listener: is told the number of pairs to measure, and each measured pair.

    Raises:
        InputError: where there is no such dataset, split, photograph or map, or a map cannot be used.
        ReadError: where a file cannot be read.
    """
    if width_px is not None:
        width_px = to_whole("width_px", width_px, least=32, most=4096)
    sample, png_scale = to_whole("sample", sample, least=1), to_real("png_scale", png_scale, least=LEAST)
    found, photographs = map_files(names_of(disparity)), find_images(names_of(images))
    place, opened = find_place(photographs, found, png_scale), open_dataset(dataset, split)
    if width_px is None:
        configured = opened.about.plan.config.camera.width_px
        width_px = WORKING_WIDTH if configured is None else working_width(round(configured))
    measured = measure_place(place, width_px)
    pairs = sampled_pairs(len(opened), opened.about.plan.views, sample)
    ours = measure_dataset(opened, width_px, pairs, listener)
    configs = [recipe.config.model_dump(mode="json") for recipe in opened.about.plan.config.recipes()]
    return Comparison(width_px, ours, len(pairs), len(opened), measured, configs)


def comparison_table(comparison: Comparison) -> list[str]:
    """Return the lines of a table: for each measure, mean and deviation on both sides, difference and distance."""
    few, unlike = comparison.too_few(), [measure for measure, _ in comparison.unlike()]
    rows: list[tuple[str, ...]] = [("", "unit", "dataset", "place", "off by", "apart")]
    for measure in MEASURES:
        if comparison.dataset.mean(measure) is None and comparison.place.side.mean(measure) is None:
            continue
        by, apart = comparison.difference(measure), comparison.distance(measure)
        sides = (_shown(side, measure) for side in (comparison.dataset, comparison.place.side))
        off = "too few" if measure in few else "unlike" if measure in unlike else "" if by is None else f"{by:+.1f} sd"
        rows.append((measure.name, measure.unit, *sides, off, "" if apart is None else f"{apart:.1f} sd"))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            [*(text.ljust(size) for text, size in zip(row[:2], widths[:2], strict=True))]
            + [text.rjust(size) for text, size in zip(row[2:], widths[2:], strict=True)]
        ).rstrip()
        for row in rows
    ]


def comparison_json(comparison: Comparison) -> dict[str, Any]:
    """Return all results in JSON's types, unrounded, with None for values that a side does not have."""
    changes = {measure.key: change for measure, _, change in comparison.advice()}
    changes |= {measure.key: change for measure, change in comparison.unlike()}

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
        "photographs": comparison.place.photographs,
        "subjects": comparison.place.subjects,
        "maps": comparison.place.maps,
        "compared": len(comparison.compared()),
        "near": len(comparison.near()),
        "measures": [
            {
                "name": measure.key,
                "meaning": measure.name,
                "unit": measure.unit,
                "dataset": side(comparison.dataset, measure),
                "place": side(comparison.place.side, measure),
                "difference": comparison.difference(measure),
                "distance": comparison.distance(measure),
                "advice": changes.get(measure.key),
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
                "place": profile(comparison.place.side, each),
            }
            for each in PROFILES
        ],
    }


def _shown(side: Side, measure: Measure) -> str:
    mean, deviation = side.mean(measure), side.deviation(measure)
    if mean is None:
        return "-"
    digits = 3 if 0 < abs(mean) < 0.1 else 2 if abs(mean) < 10 else 1 if abs(mean) < 100 else 0
    return f"{mean:.{digits}f}" + ("" if deviation is None else f" ± {deviation:.{digits}f}")
