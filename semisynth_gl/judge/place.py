"""Measures the place where the network will work, by photographs and disparity maps of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.codecs.disparity_map import MAP_EXTENSIONS, is_disparity_map, read_disparity_map
from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.inputs.errors import InputError, counted
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.judge.comparison import Values, gather
from semisynth_gl.judge.measure_input import make_measure_input
from semisynth_gl.judge.measures import MEASURES, measure_view
from semisynth_gl.textures.image_files import find_files
from semisynth_gl.textures.images import ImageError, read_image
from semisynth_gl.textures.subjects import group_by_subject, of_subjects


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceMeasures:
    """The measures of a place, as a reference for a dataset.

    Attributes:
        values: the measures by key. Measures of images come from the photographs, averaged over the photographs of each
            subject, which show the same thing. Other measures come from the disparity maps.
        summary: numbers of photographs, subjects and maps, as text.
        notes: sentences on photographs and maps that were not used, or only in part.
    """

    values: Values
    summary: str
    notes: Sequence[str]


def map_files(sources: Sequence[str | Path]) -> list[Path]:
    """Return the disparity maps in files, folders and globs: .pfm, .npy and 16-bit grey .png.

    In folders and globs, other PNG files, such as images and masks, are ignored. Raises InputError if a source matches
    no map, and ReadError if a PNG cannot be read.
    """
    paths: dict[Path, None] = {}
    for source in sources:
        maps = find_files([source], MAP_EXTENSIONS)
        if not expanded(source).is_file():
            maps = [path for path in maps if is_disparity_map(path)]
        if not maps:
            raise InputError(
                f"{source}: no disparity map there: expected .pfm, .npy or 16-bit .png, or a folder or glob of them",
                argument="disparity",
            )
        paths |= dict.fromkeys(maps)
    return list(paths)


def read_map(path: Path, png_scale: float = KITTI_DISPARITY.steps) -> NDArray[np.float32]:
    """Read a disparity map, (H, W) float32 px, with nan where it has no value.

    In .pfm and .npy files, inf, nan, 0 and negative numbers mean no value; in a 16-bit grey .png, 0 does. A PNG has
    ``png_scale`` levels per pixel of disparity. Raises ReadError if the file cannot be read.
    """
    values = read_disparity_map(path, png_scale)
    return np.where(np.isfinite(values) & (values > 0), values, np.float32(np.nan))


def measure_place(
    photographs: Sequence[Path], maps: Sequence[Path], width_px: int, png_scale: float = KITTI_DISPARITY.steps
) -> ReferenceMeasures:
    """Measure a place's photographs and its disparity maps, true or predicted.

    All are resized to the working width ``width_px``. A PNG map has ``png_scale`` levels per pixel of disparity. Raises
    InputError if no photograph can be read, and ReadError if a map cannot be read.
    """
    notes, subjects = list[str](), list[dict[str, float]]()
    measured = narrow = 0
    for paths in group_by_subject(photographs):
        pictures = []
        for path in paths:
            try:
                view = make_measure_input(width_px, read_image(path))
            except ImageError as error:
                notes.append(f"left out: {path}: {error.reason}")
                continue
            pictures.append(measure_view(view))
            narrow += view.enlarged
        if pictures:
            measured += len(pictures)
            subjects.append({key: float(values.mean()) for key, values in gather(pictures).items() if values.size})
    if not subjects:
        raise InputError("; ".join(("no photograph of the place can be read", *notes[:1])))
    mapped = [make_measure_input(width_px, disparity=read_map(path, png_scale)) for path in maps]
    if narrow:
        notes.append(f"{counted(narrow, 'photograph')} narrower than {width_px} px, not used for detail")
    if sparse := sum(view.surfaces is None for view in mapped):
        few = "with disparities in fewer than half of the pixels, used for disparity only"
        notes.append(f"{counted(sparse, 'map')} {few}")
    of_images, of_maps = gather(subjects), gather(map(measure_view, mapped))
    values = {each.key: (of_images if each.of_images else of_maps)[each.key] for each in MEASURES}
    photographed = f"{counted(measured, 'photograph')}{of_subjects(measured, len(subjects))}"
    return ReferenceMeasures(values, f"{photographed}, {counted(len(maps), 'disparity map')}", notes)
