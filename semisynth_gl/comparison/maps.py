"""Disparity maps of a place, true or predicted, dense or sparse: finding and reading them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.codecs.disparity_map import MAP_EXTENSIONS, is_disparity_map, read_disparity_map
from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.textures.image_files import KITTI_2012_MAPS, KITTI_2015_MAPS, find_files

# Where the image of a map is, by the map's name or its folder's, as Middlebury, ETH3D and KITTI have them.
_IMAGE_OF_NAME = {"disp0GT": "im0.png", "disp0": "im0.png", "disp1GT": "im1.png", "disp1": "im1.png"}
_IMAGE_OF_FOLDER = dict(zip(KITTI_2015_MAPS, ("image_2", "image_2", "image_3", "image_3"), strict=True))
# Maps of a scene, of which the first counts: the left view's, and that with the pixels that one eye sees.
_OF_ONE_SCENE = (("disp0GT", "disp1GT"), ("disp0", "disp1"), KITTI_2015_MAPS, KITTI_2012_MAPS)
_OF_RIGHT_VIEWS = frozenset({"disp1GT", "disp1", *KITTI_2015_MAPS[2:]})


def map_files(sources: Sequence[str | Path]) -> list[Path]:
    """Return the disparity maps of files, folders and globs: .pfm, .npy and 16-bit grey .png.

    In folders and globs, PNG files of other kinds are passed over: images and masks lie beside disparity maps. A
    source that matches no map raises InputError, and a PNG that cannot be read ReadError.
    """
    paths: dict[Path, None] = {}
    for source in sources:
        maps = find_files([source], MAP_EXTENSIONS)
        if not expanded(source).is_file():
            maps = [path for path in maps if is_disparity_map(path)]
        if not maps:
            raise InputError(
                f"`disparity` {source}: no disparity map there: expected .pfm, .npy or 16-bit grey .png, or a folder "
                "or glob of them"
            )
        paths |= dict.fromkeys(maps)
    return list(paths)


def one_of_each_scene(maps: Sequence[Path]) -> list[Path]:
    """Leave out the maps that show again what another one shows, as Middlebury, ETH3D and KITTI name them.

    Of the maps of a scene the left view's counts (``disp0GT`` before ``disp1GT``, ``disp_occ_0`` before
    ``disp_occ_1``), and that with the pixels that one eye sees (``disp_occ_0`` before ``disp_noc_0``).
    """
    given = set(maps)
    return [path for path in maps if given.isdisjoint(_before(path))]


def read_map(path: Path, png_scale: float = KITTI_DISPARITY.steps) -> NDArray[np.float32]:
    """Read a disparity map (H, W) px, nan where it has no value.

    Inf, nan, 0 and negative numbers of .pfm and .npy stand for no value, and 0 in 16-bit grey .png, which counts
    ``png_scale`` levels per pixel of disparity.
    """
    values = read_disparity_map(path, png_scale)
    return np.where(np.isfinite(values) & (values > 0), values, np.float32(np.nan))


def is_of_right_view(path: Path) -> bool:
    """Return whether a map is of a right view, as its name or its folder's says."""
    return bool(_OF_RIGHT_VIEWS.intersection((path.stem, path.parent.name)))


def image_beside(path: Path) -> Path | None:
    """Return the image that a disparity map is of, as Middlebury, ETH3D and KITTI name it, or None."""
    if path.stem in _IMAGE_OF_NAME:
        image = path.with_name(_IMAGE_OF_NAME[path.stem])
    elif path.parent.name in _IMAGE_OF_FOLDER:
        image = path.parent.with_name(_IMAGE_OF_FOLDER[path.parent.name]) / path.name
    else:
        return None
    return image if image.is_file() else None


def _before(path: Path) -> list[Path]:
    """Return the names under which a map of the same scene would count instead."""
    for names in _OF_ONE_SCENE:
        if path.stem in names:
            return [path.with_stem(name) for name in names[: names.index(path.stem)]]
        if path.parent.name in names:
            folder = path.parent
            return [folder.with_name(name) / path.name for name in names[: names.index(folder.name)]]
    return []
