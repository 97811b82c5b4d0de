"""The files of a place: its photographs, and its disparity maps with their images."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.comparison.maps import image_beside, is_of_right_view, one_of_each_scene, read_map
from semisynth_gl.comparison.measured_view import WORKING_WIDTH, MeasuredView, make_view
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.inputs.errors import InputError, Skipped, counted
from semisynth_gl.textures.image_files import beside_photographs
from semisynth_gl.textures.images import ImageError, read_image


@dataclass(frozen=True, slots=True)
class PlaceFiles:
    """Photographs of the place that a dataset is made for, and its disparity maps, true or predicted.

    Maps are of left views unless their names say otherwise. To measure borders of objects, a map is read together with
    its image, if Middlebury's, ETH3D's or KITTI's names tell where that is. A 16-bit PNG map has ``png_scale`` levels
    per pixel of disparity. With ``depths_of``, the maps hold depths of this camera instead.
    """

    photographs: Sequence[Path]
    maps: Sequence[Path] = ()
    png_scale: float = KITTI_DISPARITY.steps
    depths_of: StereoCamera | None = None


def find_place(
    photographs: Sequence[Path],
    maps: Sequence[Path],
    png_scale: float = KITTI_DISPARITY.steps,
    depths_of: StereoCamera | None = None,
) -> PlaceFiles:
    """Return the files of a place without masks and maps among the photographs, and with one map of each scene.

    See `beside_photographs` and `one_of_each_scene`.

    Raises:
        InputError: where no photograph is left.
    """
    images = [path for path in photographs if not beside_photographs(path)]
    if not images:
        raise InputError("no photographs to compare with: expected at least one image that is not a mask or map")
    return PlaceFiles(images, one_of_each_scene(maps), png_scale, depths_of)


def left_out(images: Sequence[Path], maps: Sequence[Path]) -> str:
    """Return a note on the images and maps that `find_place` leaves out; "" where it takes all."""
    taken = set(one_of_each_scene(maps))
    beside = [path for path in images if beside_photographs(path)]
    files = list(dict.fromkeys([*beside, *(path for path in maps if path not in taken)]))
    reason = "masks and maps among photographs, and further maps of the same scene"
    return f"left out {counted(len(files), 'file')}, such as {files[0]}: {reason}" if files else ""


def photograph_views(photographs: Sequence[Path], skipped: list[Skipped], width_px: int) -> Iterator[MeasuredView]:
    """Yield photographs at the working width ``width_px``; photographs that cannot be read are added to ``skipped``."""
    for path in photographs:
        try:
            image = read_image(path)
        except ImageError as error:
            skipped.append(Skipped(path, error.reason))
        else:
            yield make_view(str(path), width_px, image=image)


def map_views(place: PlaceFiles, width_px: int = WORKING_WIDTH) -> Iterator[MeasuredView]:
    """Yield the maps at the working width ``width_px``, each with its image where there is one.

    Right views are mirrored, so that they count as left views. A map without any disparity raises InputError.
    """
    for path in place.maps:
        disparity, beside = read_map(path, place.png_scale, place.depths_of), image_beside(path)
        if not np.isfinite(disparity).any():
            raise InputError(f"{path}: holds no disparity: all of its values are 0 or below, inf or nan")
        image = None if beside is None else read_image(beside)
        if is_of_right_view(path):
            # The mirror image of a right view is a left view.
            disparity, image = disparity[:, ::-1], None if image is None else image[:, ::-1]
        yield make_view(str(path), width_px, image=image, disparity=disparity)
