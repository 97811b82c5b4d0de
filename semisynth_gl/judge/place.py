"""The files of a place, photographs and disparity or depth maps, as views to measure."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.codecs.disparity_map import MAP_EXTENSIONS, is_disparity_map, read_depth_map, read_disparity_map
from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.inputs.errors import InputError, counted
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.judge.measured_view import MeasuredView, make_view
from semisynth_gl.textures.image_files import KITTI_2012_MAPS, KITTI_2015_MAPS, beside_photographs, find_files
from semisynth_gl.textures.images import read_image

# The image of a map, by the map's name (Middlebury and ETH3D), and the images' folder, by the maps' folder (KITTI).
_IMAGE_OF_NAME = {"disp0GT": "im0.png", "disp0": "im0.png", "disp1GT": "im1.png", "disp1": "im1.png"}
_IMAGE_OF_FOLDER = dict(zip(KITTI_2015_MAPS, ("image_2", "image_2", "image_3", "image_3"), strict=True))
# Maps of the same scene, the preferred one first: left before right views, and maps with occluded pixels before others.
_OF_ONE_SCENE = (("disp0GT", "disp1GT"), ("disp0", "disp1"), KITTI_2015_MAPS, KITTI_2012_MAPS)
_OF_RIGHT_VIEWS = frozenset({"disp1GT", "disp1", *KITTI_2015_MAPS[2:]})


def map_files(sources: Sequence[str | Path], kind: str = "disparity") -> list[Path]:
    """Return the maps of a kind, disparity or depth, in files, folders and globs: .pfm, .npy and 16-bit grey .png.

    Images and masks may lie beside maps, so PNG files of other kinds are ignored in folders and globs.

    Raises:
        InputError: where a source matches no map.
        ReadError: where a PNG cannot be read.
    """
    paths: dict[Path, None] = {}
    for source in sources:
        maps = find_files([source], MAP_EXTENSIONS)
        if not expanded(source).is_file():
            maps = [path for path in maps if is_disparity_map(path)]
        if not maps:
            raise InputError(
                f"{source}: no {kind} map there: expected .pfm, .npy or 16-bit grey .png, or a folder or glob of them",
                argument=kind,
            )
        paths |= dict.fromkeys(maps)
    return list(paths)


def one_of_each_scene(maps: Sequence[Path]) -> list[Path]:
    """Return the maps without those that show the same scene as another map, as Middlebury, ETH3D and KITTI name them.

    A left view's map is preferred to a right view's (``disp0GT`` to ``disp1GT``, ``disp_occ_0`` to ``disp_occ_1``), and
    a map with the pixels that only one eye sees to a map without them (``disp_occ_0`` to ``disp_noc_0``).
    """
    given = set(maps)
    return [path for path in maps if given.isdisjoint(_before(path))]


def disparity_of_depths(path: Path, camera: StereoCamera) -> NDArray[np.float32]:
    """Read a depth map as disparity, (H, W) float32 px at the map's width, nan where it has no value.

    Points so near that the right camera's image would not show them have no value either. ``camera`` is the rectified
    pair, whose left image the map belongs to, at any resolution.

    Raises:
        ReadError: where the file cannot be read.
    """
    depth = read_depth_map(path)
    disparity = (camera.focal_baseline / depth - camera.doffs_px) / camera.width_px
    return np.where(disparity <= 1, disparity * depth.shape[1], np.nan).astype(np.float32)


def read_map(
    path: Path, png_scale: float = KITTI_DISPARITY.steps, depths_of: StereoCamera | None = None
) -> NDArray[np.float32]:
    """Read a disparity map, (H, W) float32 px, with nan where it has no value.

    In .pfm and .npy, inf, nan, 0 and negative numbers mean that there is no value; in a 16-bit grey .png, 0 does. A PNG
    has ``png_scale`` levels per pixel of disparity. With ``depths_of``, the map holds depths of this camera instead.

    Raises:
        ReadError: where the file cannot be read.
    """
    values = read_disparity_map(path, png_scale) if depths_of is None else disparity_of_depths(path, depths_of)
    return np.where(np.isfinite(values) & (values > 0), values, np.float32(np.nan))


def _image_beside(path: Path) -> Path | None:
    """Return the image that belongs to a disparity map, as Middlebury, ETH3D and KITTI name it; None without one."""
    if path.stem in _IMAGE_OF_NAME:
        image = path.with_name(_IMAGE_OF_NAME[path.stem])
    elif path.parent.name in _IMAGE_OF_FOLDER:
        image = path.parent.with_name(_IMAGE_OF_FOLDER[path.parent.name]) / path.name
    else:
        return None
    return image if image.is_file() else None


def _before(path: Path) -> list[Path]:
    """Return the paths of maps of the same scene that would be preferred to this one."""
    for names in _OF_ONE_SCENE:
        if path.stem in names:
            return [path.with_stem(name) for name in names[: names.index(path.stem)]]
        if path.parent.name in names:
            folder = path.parent
            return [folder.with_name(name) / path.name for name in names[: names.index(folder.name)]]
    return []


def left_out(images: Sequence[Path], maps: Sequence[Path]) -> str:
    """Return a note on the images and maps that a comparison leaves out; "" where it takes all.

    These are masks and maps among the images, and maps that `one_of_each_scene` leaves out.
    """
    taken = set(one_of_each_scene(maps))
    beside = [path for path in images if beside_photographs(path)]
    files = list(dict.fromkeys([*beside, *(path for path in maps if path not in taken)]))
    reason = "masks and maps among photographs, and further maps of the same scene"
    return f"left out {counted(len(files), 'file')}, such as {files[0]}: {reason}" if files else ""


def map_view(
    path: Path, width_px: int, png_scale: float = KITTI_DISPARITY.steps, depths_of: StereoCamera | None = None
) -> MeasuredView:
    """Return a map at the working width ``width_px``, with its image where there is one.

    The image is found by the names of Middlebury, ETH3D and KITTI. Right views, by the same names, are mirrored, so
    that they count as left views. `read_map` explains the other arguments.

    Raises:
        InputError: where the map has no disparity, or another size than its image.
        ReadError: where a file cannot be read.
    """
    disparity, beside = read_map(path, png_scale, depths_of), _image_beside(path)
    if not np.isfinite(disparity).any():
        raise InputError(f"{path}: holds no disparity: all of its values are 0 or below, inf or nan")
    image = None if beside is None else read_image(beside)
    if _OF_RIGHT_VIEWS.intersection((path.stem, path.parent.name)):
        # The mirror image of a right view is a left view.
        disparity, image = disparity[:, ::-1], None if image is None else image[:, ::-1]
    return make_view(str(path), width_px, image=image, disparity=disparity)
