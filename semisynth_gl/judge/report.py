"""The report: an HTML page about a dataset, also compared with photographs and maps of the place it is made for."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np

from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.dataset.reader import Dataset, open_dataset
from semisynth_gl.histogram import Histogram, count_pixels, total_variation, wasserstein_px
from semisynth_gl.inputs.arguments import LEAST, to_real, to_whole
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.inputs.templates import template_environment
from semisynth_gl.inputs.user_files import Files, names_of
from semisynth_gl.judge.charts import plot_report
from semisynth_gl.judge.comparison import MeasureComparison, MeasuredPair, compare, find_outliers, gather, table
from semisynth_gl.judge.measure_input import make_measure_input, working_width
from semisynth_gl.judge.measures import measure_view
from semisynth_gl.judge.pictures import MASKS, embed_pair
from semisynth_gl.judge.place import ReferenceMeasures, map_files, measure_place
from semisynth_gl.listener import Listener
from semisynth_gl.seeds.seeds import spread
from semisynth_gl.textures.image_files import find_images

# Maximum number of outliers that the page shows, besides evenly spread pairs.
_SHOWN_OUTLIERS = 3
# Number of bins in which disparities are counted: so many that they do not affect the distance of distributions.
_BINS = 1024


@dataclass(frozen=True, slots=True, eq=False)
class Report:
    """A page, and the numbers on it.

    Attributes:
        page: the page, as HTML.
        pairs: the measured pairs.
        width_px: the working width, to which all images and maps were resized.
        disparity: distribution of disparity over all pixels of the left views; None if no pixel has a disparity.
        rows: each measure of the dataset, compared with the place if photographs were given.
        place: the measures of the place; None without photographs of it.
    """

    page: str
    pairs: Sequence[MeasuredPair]
    width_px: int
    disparity: Histogram | None
    rows: Sequence[MeasureComparison]
    place: ReferenceMeasures | None

    def values(self) -> dict[str, Any]:
        """Return the measures in JSON's types."""
        return {
            "pairs": len(self.pairs),
            "place": None if self.place is None else self.place.summary,
            "width_px": self.width_px,
            "measures": [row.values() for row in self.rows],
        }


def report(
    dataset: str | PathLike[str],
    *,
    images: Files = (),
    disparity: Files = (),
    png_scale: float = KITTI_DISPARITY.steps,
    pairs: int = 12,
    sample: int = 200,
    listener: Listener | None = None,
) -> Report:
    """Measure a dataset and render its page, as ``semisynth-gl report`` does. Equal datasets give equal pages.

    Args:
        dataset: a folder, or an address that fsspec knows.
        images: photographs of the place where the network will work: files, folders or globs.
        disparity: disparity maps of the place: .pfm, .npy and 16-bit .png files, folders or globs.
        png_scale: levels of a 16-bit PNG map per pixel of disparity.
        pairs: number of pairs to show, evenly spread. The page also shows up to three outliers, unless this is 0.
        sample: number of pairs to measure, evenly spread; at least ``pairs`` are measured.
        listener: is called with the number of pairs to measure, and with each measured pair.

    Raises:
        InputError: where there is no finished dataset, or no such photograph or map.
        ReadError: where a pair or a map cannot be read.
    """
    pairs, sample = to_whole("pairs", pairs, least=0), to_whole("sample", sample, least=1)
    opened = open_dataset(dataset)
    config = opened.index.plan.config
    width_px, png_scale = working_width(config.camera.width_px), to_real("png_scale", png_scale, least=LEAST)
    image_names, map_names = names_of(images), names_of(disparity)
    if map_names and not image_names:
        raise InputError("expected photographs of the place, too: --images", argument="disparity")
    place = measure_place(find_images(image_names), map_files(map_names), width_px, png_scale) if image_names else None
    target = config.shown_histogram()
    measured, achieved = _measure(opened, spread(len(opened), max(sample, pairs)), width_px, target, listener)
    recipes = [recipe.config.model_dump(mode="json") for recipe in config.recipes()]
    rows = compare(gather(pair.values for pair in measured), gather(()) if place is None else place.values, recipes)
    outliers = find_outliers(measured)
    shown = [measured[number] for number in spread(len(measured), pairs)]
    shown += [outlier.pair for outlier in outliers[: _SHOWN_OUTLIERS * bool(shown)]]
    by_position = {pair.position: pair for pair in shown}
    template = template_environment().get_template("report.html")
    page = template.render(
        name=config.name,
        measured=len(measured),
        pairs=len(opened),
        width_px=width_px,
        facts=_facts(opened, target, achieved),
        config=json.dumps(config.model_dump(mode="json"), indent=1),
        chart=plot_report(achieved, target, rows),
        place=place,
        table=table(rows),
        outliers=outliers,
        numbers={position: number for number, position in enumerate(by_position)},
        embedded=[
            embed_pair(opened[position]) | {"name": pair.name, "recipe": pair.recipe}
            for position, pair in by_position.items()
        ],
        colours=MASKS,
    )
    return Report(page, measured, width_px, achieved, rows, place)


def _measure(
    dataset: Dataset, positions: Sequence[int], width_px: int, target: Histogram, listener: Listener | None
) -> tuple[list[MeasuredPair], Histogram | None]:
    """Read pairs, measure their left views, and return the distribution of the left disparities over all pairs.

    Each bin of ``target`` consists of whole bins of this histogram, so that both can be compared exactly.
    """
    listener = listener or Listener()
    listener.on_total(len(positions))
    pairs, plan, first = [], dataset.index.plan, dataset[positions[0]].camera
    low = min(0.0, -first.doffs_px, target.edges_px[0])
    high = max(plan.config.disparity.max_px, target.edges_px[-1])
    edges_px = np.union1d(np.linspace(low, high, _BINS + 1), target.edges_px)
    counts = np.zeros(len(edges_px) - 1, np.int64)
    for position in positions:
        frame = dataset[position]
        counts += count_pixels(frame.left.disparity, edges_px)
        view = make_measure_input(width_px, frame.left.image, frame.left.disparity, signed=plan.encodings.signed)
        name = frame.name if len(plan.pairs) == 1 else f"{frame.split} {frame.name}"
        pairs.append(MeasuredPair(position, name, frame.recipe, measure_view(view)))
        listener.on_pair()
    return pairs, Histogram.from_counts(edges_px, counts) if counts.any() else None


def _facts(dataset: Dataset, target: Histogram, achieved: Histogram | None) -> dict[str, str]:
    """Return how a dataset was made, and the distance of its disparities from the target, as texts by name."""
    plan, made = dataset.index.plan, dataset.index.finished_index
    codecs = f"images {plan.encodings.image.description}, disparities {plan.encodings.disparity.description}"
    facts = {
        "program": f"{plan.program} {plan.version}",
        "config": f"{plan.config.name}, SHA-256 {plan.config_sha256}",
        "seed": str(plan.seed),
        "pairs": ", ".join(f"{count:,} {name}" for name, count in plan.pairs.items()),
        "layout": f"{plan.layout_name}; {codecs}",
        "truth": f"{plan.config.truth}; {', '.join(plan.config.outputs)}",
    }
    if made is not None:
        redraws = sum(entry.redraws for entry in made.shard_entries)
        facts["redrawn"] = f"{redraws:,} attempts failed the config's checks and were rendered anew"
        facts["renderers"] = ", ".join(made.renderers)
    if achieved is not None:
        facts["distance from the target"] = (
            f"total variation {total_variation(target, achieved):.3f}, "
            f"Wasserstein-1 {wasserstein_px(target, achieved):.3g} px"
        )
    return facts
