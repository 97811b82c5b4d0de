"""The report: a dataset as one HTML page, and beside pictures of its place what to change in its config."""

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike

from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.dataset.reader import Dataset, read_index
from semisynth_gl.inputs.arguments import LEAST, to_real, to_whole
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.inputs.user_files import Files, names_of
from semisynth_gl.judge.comparison import Comparison, MeasuredPlace, measure_place, side_of
from semisynth_gl.judge.measured_pairs import QUANTITIES, Measurement, Outlier, PairMeasures, find_outliers, measure
from semisynth_gl.judge.measured_view import WORKING_WIDTH, working_width
from semisynth_gl.judge.page import render_page
from semisynth_gl.judge.pictures import make_pictures
from semisynth_gl.judge.place import map_files
from semisynth_gl.listener import Listener
from semisynth_gl.seeds.splits import SplitName
from semisynth_gl.seeds.spread import spread
from semisynth_gl.textures.image_files import find_images

# For this many of the first quantities, the page also shows the farthest outlier.
_SHOWN_QUANTITIES = 3
_NARROWEST, _WIDEST = 32, 4096


@dataclass(frozen=True, slots=True)
class Report:
    """A page, with its numbers.

    Attributes:
        page: the page, as HTML.
        measurement: the measures of the sample.
        comparison: the measures beside those of the place; None without photographs of it.
        shown: number of pairs on the page.
        step: the page shows every ``step``-th pixel of a pair, in both directions; 0 where it shows no pair.
    """

    page: str
    measurement: Measurement
    comparison: Comparison | None
    shown: int
    step: int


def report(
    dataset: str | PathLike[str],
    *,
    images: Files = (),
    disparity: Files = (),
    png_scale: float = KITTI_DISPARITY.steps,
    width_px: int | None = None,
    pairs: int = 12,
    sample: int = 200,
    split: SplitName | None = None,
    listener: Listener | None = None,
) -> Report:
    """Measure a dataset and render its page, as ``semisynth-gl report`` does. Equal datasets give equal pages.

    Args:
        dataset: a folder, or an address that fsspec knows.
        images: photographs of the place that the dataset is made for, to compare it with: files, folders or globs.
        disparity: disparity maps of the place: .pfm, .npy and 16-bit .png files, folders or globs.
        png_scale: levels of a 16-bit PNG map per pixel of disparity.
        width_px: the width, from 32 to 4096 px, to which all images and maps are brought before they are compared; by
            default 512, or the pairs' own width if that is less.
        pairs: number of pairs to show, evenly spread; the page shows up to three outliers in addition. With 0, it shows
            no pair.
        sample: number of pairs to measure, evenly spread; never fewer than ``pairs``.
        split: a split of the dataset; None for all splits.
        listener: is told the number of pairs to measure, and each measured pair.

    Raises:
        InputError: where there is no dataset, it is not finished or has no such split, none of the sampled pairs can be
            read, or there is no such photograph or map, or a map cannot be used.
    """
    pairs, sample = to_whole("pairs", pairs, least=0), to_whole("sample", sample, least=1)
    index = read_index(dataset)
    opened = Dataset(index, split)
    if width_px is None:
        configured = index.plan.config.camera.width_px
        width_px = WORKING_WIDTH if configured is None else working_width(round(configured))
    width_px = to_whole("width_px", width_px, least=_NARROWEST, most=_WIDEST)
    place = _measured_place(images, disparity, png_scale, width_px)
    positions = spread(len(opened), max(sample, pairs))
    measurement = measure(opened, positions, split, listener, None if place is None else width_px)
    comparison = None
    if place is not None:
        recipes = [recipe.config.model_dump(mode="json") for recipe in index.plan.config.recipes()]
        left_views = measurement.left_views
        comparison = Comparison(width_px, side_of(left_views), len(left_views), place, recipes)
    outliers = [outlier for quantity in QUANTITIES for outlier in find_outliers(measurement.pairs, quantity)]
    shown = _choose(measurement.pairs, pairs, outliers)
    pictures = make_pictures([pair.position for pair, _ in shown], opened.__getitem__)
    page = render_page(index, measurement, comparison, outliers, shown, pictures)
    return Report(page, measurement, comparison, len(shown), pictures[0].step if pictures else 0)


def _measured_place(images: Files, disparity: Files, png_scale: float, width_px: int) -> MeasuredPlace | None:
    png_scale = to_real("png_scale", png_scale, least=LEAST)
    image_names, map_names = names_of(images), names_of(disparity)
    if not image_names:
        if map_names:
            raise InputError("expected photographs of the place, too: --images", argument="disparity")
        return None
    return measure_place(find_images(image_names), map_files(map_names), width_px, png_scale)


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
