"""Adapters for calibration formats: each renames the values of one format to names that `finder` knows."""

from collections.abc import Callable, Mapping

import numpy as np

from semisynth_gl.calibration.named_arrays import is_rotation
from semisynth_gl.calibration.poses import pose_of
from semisynth_gl.calibration.sizes import ImageSize
from semisynth_gl.calibration.tree import Array, FormatError, Tree
from semisynth_gl.frame.camera import camera_matrix
from semisynth_gl.frame.raw_camera import rotation_of
from semisynth_gl.inputs.errors import abbreviate, shown

# Image sizes of ZED's modes.
_ZED_SIZES = {
    "4K": ImageSize(3840, 2160),
    "QHDPLUS": ImageSize(3200, 1800),
    "2K": ImageSize(2208, 1242),
    "FHD": ImageSize(1920, 1080),
    "FHD1200": ImageSize(1920, 1200),
    "HD": ImageSize(1280, 720),
    "SVGA": ImageSize(960, 600),
    "VGA": ImageSize(672, 376),
}
# DepthAI's camera types: the lens model, and its number of coefficients; files have 14 for each lens.
_DEPTHAI_LENSES = {0: ("radtan", 14), 1: ("fisheye", 4)}


RenamedTree = tuple[Tree, tuple[str, str] | None]
"""Renamed values, lengths in metres; and labels of the left and right camera, None if the file has only two cameras."""


def middlebury(tree: Tree, _size: ImageSize | None) -> RenamedTree | None:
    """Read calib.txt of Middlebury and ETH3D: cam0, cam1, and the baseline in mm."""
    if not tree.keys() >= {("cam0",), ("cam1",), ("baseline",)}:
        return None
    return tree | {("baseline",): np.array(_number(tree, "baseline") / 1000)}, None


def zed(tree: Tree, size: ImageSize | None) -> RenamedTree | None:
    """Read ZED's SN*.conf: cameras for each mode, the translation in mm, and a rotation vector."""
    if ("STEREO", "Baseline") not in tree:
        return None
    modes = dict.fromkeys(name[0].removeprefix("LEFT_CAM_") for name in tree)
    mode = _chosen({known: _ZED_SIZES[known] for known in modes if known in _ZED_SIZES}, size)
    eye_of = {f"LEFT_CAM_{mode}": "left", f"RIGHT_CAM_{mode}": "right"}
    made: Tree = {(eye_of[name[0]], name[-1]): value for name, value in tree.items() if name[0] in eye_of}
    t_mm = [-abs(_number(tree, "STEREO", "Baseline"))]
    t_mm += [_number(tree, "STEREO", key, missing=0.0) for key in ("TY", "TZ")]
    rotation = [_number(tree, "STEREO", f"{key}_{mode}", missing=0.0) for key in ("RX", "CV", "RZ")]
    made |= {("R",): np.array(rotation), ("T",): np.array(t_mm) / 1000, ("size",): np.array(_ZED_SIZES[mode], float)}
    return made, None


def realsense(tree: Tree, size: ImageSize | None) -> RenamedTree | None:
    """Read the calibration that RealSense's viewer saves: rectified cameras for each size, the baseline in mm."""
    numbers = [name[1] for name in tree if name[0] == "rectified" and name[-1] == "fx"]
    if not numbers or ("baseline",) not in tree:
        return None
    sizes = {n: ImageSize(*(int(_number(tree, "rectified", n, side)) for side in ("width", "height"))) for n in numbers}
    number = _chosen({n: own for n, own in sizes.items() if min(own) > 0}, size)
    made = {name[2:]: value for name, value in tree.items() if name[:2] == ("rectified", number)}
    return made | {("baseline",): np.array(abs(_number(tree, "baseline")) / 1000)}, None


def mrcal(tree: Tree, _size: ImageSize | None) -> RenamedTree | None:
    """Read .cameramodel files of mrcal: K and D in one list, and the camera's pose as rotation and translation."""
    made = dict(tree)
    for name in (name[:-1] for name in tree if name[-1] == "lensmodel"):
        intrinsics = _array(tree, *name, "intrinsics")
        pose = _array(tree, *name, "extrinsics" if (*name, "extrinsics") in tree else "rt_cam_ref")
        if len(intrinsics) < 4 or len(pose) != 6:
            raise FormatError("expected intrinsics of 4 or more numbers, and extrinsics of 6")
        made |= {(*name, "K"): camera_matrix(*intrinsics[:4]), (*name, "D"): intrinsics[4:]}
        made[*name, "T_cam_reference"] = pose_of(np.array(rotation_of((pose[0], pose[1], pose[2]))), pose[3:])
    return (made, None) if len(made) > len(tree) else None


def depthai(tree: Tree, _size: ImageSize | None) -> RenamedTree | None:
    """Read what DepthAI's eepromToJsonFile writes about an OAK: cameras by socket, linked by poses in cm."""
    made: Tree = {}
    cameras = dict.fromkeys(name[:2] for name in tree if name[0] == "cameraData" and len(name) > 2)
    for camera in cameras:
        socket, values = int(_number(tree, *camera, "0")), (*camera, "1")
        kind = int(_number(tree, *values, "cameraType", missing=0))
        model, count = _DEPTHAI_LENSES.get(kind, (f"omni (cameraType {kind})", 0))
        for name, key in {"K": "intrinsicMatrix", "width": "width", "height": "height"}.items():
            made[f"cam{socket}", name] = _array(tree, *values, key)
        made |= {
            (f"cam{socket}", "D"): _array(tree, *values, "distortionCoeff")[:count],
            (f"cam{socket}", "model"): model,
        }
        # The last camera of the chain has toCameraSocket -1, and an empty rotation or only zeros.
        turn, shift = (_array(tree, *values, "extrinsics", key) for key in ("rotationMatrix", "translation"))
        if (turn.size, shift.size) == (9, 3) and is_rotation(turn.reshape(3, 3)):
            there = int(_number(tree, *values, "extrinsics", "toCameraSocket", missing=-1))
            made[f"T_{there}_{socket}",] = pose_of(turn.reshape(3, 3), shift / 100)
    if not cameras:
        return None
    left, right = (int(_number(tree, "stereoRectificationData", f"{eye}CameraSocket")) for eye in ("left", "right"))
    return made, (str(left), str(right))


def kitti(tree: Tree, _size: ImageSize | None) -> RenamedTree | None:
    """Read KITTI's files: the colour cameras, or else the grey ones."""
    names = {name[-1] for name in tree}
    for pair in (("2", "3"), ("0", "1")):
        if any({form + number for number in pair} <= names for form in ("P_rect_0", "P")):
            return tree, pair
    return None


Adapter = Callable[[Tree, ImageSize | None], RenamedTree | None]
ADAPTERS: tuple[Adapter, ...] = (middlebury, zed, realsense, mrcal, depthai, kitti)
"""Each returns None for other formats. The size is None unless the user gave one or the photographs have one."""


def _chosen(sizes: Mapping[str, ImageSize], size: ImageSize | None) -> str:
    """Return the mode whose images have this size, or without a size the only mode; raises FormatError if none fits."""
    fitting = [mode for mode, own in sizes.items() if own == size or (size is None and len(sizes) == 1)]
    if fitting:
        return fitting[0]
    if not sizes:
        raise FormatError("has no mode that is known")
    got = "" if size is None else f", not for {size}"
    raise FormatError(f"has cameras for {abbreviate([*map(str, sizes.values())])}{got}: give one of these, --size")


def _array(tree: Tree, *name: str) -> Array:
    value = tree.get(name)
    return value.ravel() if isinstance(value, np.ndarray) else np.zeros(0)


def _number(tree: Tree, *name: str, missing: float | None = None) -> float:
    value = _array(tree, *name)
    if value.size == 1 and np.isfinite(value).all():
        return float(value[0])
    if missing is not None and not value.size:
        return missing
    raise FormatError(f"{'.'.join(name)}: expected a number, got {shown(tree.get(name, 'nothing'))}")
