"""The place: its photographs, and its disparity maps with the images that they are of."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from semisynth_gl.codecs.disparity_map import read_disparity_map
from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.comparison.picture import WORKING_WIDTH, Picture, make_picture
from semisynth_gl.errors import InputError, Skipped
from semisynth_gl.textures.images import ImageError, read_image

# A map's name, or its folder's, and where its image is, as Middlebury, ETH3D and KITTI have them.
_IMAGE_OF_NAME = {"disp0GT": "im0.png", "disp0": "im0.png", "disp1GT": "im1.png", "disp1": "im1.png"}
_IMAGE_OF_FOLDER = {"disp_occ_0": "image_2", "disp_noc_0": "image_2"}
# Maps that show again what another map of the same scene shows.
_FIRST_OF_NAME = {"disp1GT": "disp0GT", "disp1": "disp0"}
_FIRST_OF_FOLDER = {"disp_noc_0": "disp_occ_0"}
_MASKS = frozenset({"mask0nocc.png", "mask1nocc.png"})


@dataclass(frozen=True, slots=True)
class Place:
    """Files that show the place that a dataset is made for.

    Attributes:
        photographs: images of any kind.
        maps: disparity maps, true or predicted, of left views unless their name says otherwise. An image beside a map,
            as Middlebury, ETH3D and KITTI name it, is read with it, to measure borders of objects.
        png_scale: levels of a 16-bit PNG map per pixel of disparity.
    """

    photographs: Sequence[Path]
    maps: Sequence[Path] = ()
    png_scale: float = KITTI_DISPARITY.steps


def find_place(photographs: Sequence[Path], maps: Sequence[Path], png_scale: float = KITTI_DISPARITY.steps) -> Place:
    """Return a place of files as folders hold them: without masks, and with one map of each scene.

    Args:
        photographs: images; Middlebury's masks among them are left out.
        maps: disparity maps; the right view's is left out beside the left view's, and KITTI's ``disp_noc_0`` beside
            ``disp_occ_0``.
        png_scale: see `Place`.

    Raises:
        InputError: where there is no photograph.
    """
    images = [path for path in photographs if path.name not in _MASKS]
    if not images:
        raise InputError("no photographs to compare with: expected at least one image that is no mask")
    given = set(maps)
    return Place(images, [path for path in maps if _first_of_scene(path) not in given], png_scale)


def photograph_pictures(place: Place, skipped: list[Skipped], width_px: int = WORKING_WIDTH) -> Iterator[Picture]:
    """Yield the photographs.

    Args:
        place: the place.
        skipped: a list that receives the files that cannot be read.
        width_px: the working width.
    """
    for path in place.photographs:
        try:
            image = read_image(path)
        except ImageError as error:
            skipped.append(Skipped(path, error.reason))
        else:
            yield make_picture(str(path), width_px, image=image)


def map_pictures(place: Place, width_px: int = WORKING_WIDTH) -> Iterator[Picture]:
    """Yield the maps, each with its image where there is one.

    Args:
        place: the place.
        width_px: the working width.

    Raises:
        ReadError: where a map cannot be read.
        InputError: where a map has no disparity, or another size than its image, or the image cannot be read.
    """
    for path in place.maps:
        disparity, beside = read_disparity_map(path, place.png_scale), image_beside(path)
        if not (np.isfinite(disparity) & (disparity > 0)).any():
            raise InputError(f"{path}: holds no disparity: all of its values are 0 or below, inf or nan")
        image = None if beside is None else read_image(beside)
        if path.stem in _FIRST_OF_NAME:
            # The mirror image of a right view is a left view.
            disparity, image = disparity[:, ::-1], None if image is None else image[:, ::-1]
        yield make_picture(str(path), width_px, image=image, disparity=disparity)


def image_beside(path: Path) -> Path | None:
    """Return the image that a disparity map is of, as Middlebury, ETH3D and KITTI name it, or None."""
    if path.stem in _IMAGE_OF_NAME:
        image = path.with_name(_IMAGE_OF_NAME[path.stem])
    elif path.parent.name in _IMAGE_OF_FOLDER:
        image = path.parent.with_name(_IMAGE_OF_FOLDER[path.parent.name]) / path.name
    else:
        return None
    return image if image.is_file() else None


def _first_of_scene(path: Path) -> Path | None:
    if path.stem in _FIRST_OF_NAME:
        return path.with_stem(_FIRST_OF_NAME[path.stem])
    if path.parent.name in _FIRST_OF_FOLDER:
        return path.parent.with_name(_FIRST_OF_FOLDER[path.parent.name]) / path.name
    return None
