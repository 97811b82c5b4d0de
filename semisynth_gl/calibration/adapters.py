"""Calibrations whose structure names alone do not tell: each adapter returns the arrays of a tree that is its own."""

from collections.abc import Callable, Mapping

import numpy as np

from semisynth_gl.calibration.arrays import (
    DisparityBounds,
    EyeArrays,
    Size,
    StereoArrays,
    camera_matrix,
    lens_of,
    projections,
)
from semisynth_gl.calibration.kinds import checked_size, is_camera_matrix, is_rotation
from semisynth_gl.calibration.names import eye_of
from semisynth_gl.calibration.poses import Link, along, pose_of
from semisynth_gl.calibration.tree import Array, FormatError, Tree
from semisynth_gl.frame.raw_camera import rotation_of
from semisynth_gl.inputs.errors import abbreviate, shown

_SAME_DOFFS_PX = 0.02
# Largest number of characters of a matrix in a message.
_SHOWN = 200
_KITTI_PAIRS, _KITTI_FORMS = (("2", "3"), ("0", "1")), ("P_rect_0", "P")
# Sizes of ZED's modes.
_ZED_SIZES = {
    "4K": Size(3840, 2160),
    "QHDPLUS": Size(3200, 1800),
    "2K": Size(2208, 1242),
    "FHD1200": Size(1920, 1200),
    "FHD": Size(1920, 1080),
    "HD1200": Size(1920, 1200),
    "HD": Size(1280, 720),
    "SVGA": Size(960, 600),
    "VGA": Size(672, 376),
}
_ZED_NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
# DepthAI's types of a camera, and the number of coefficients that count.
_DEPTHAI_LENSES = {0: ("radtan", 14), 1: ("fisheye", 4)}


def middlebury(tree: Tree, _size: Size | None) -> StereoArrays | None:
    """Read calib.txt of Middlebury and ETH3D: cam0, cam1, and the baseline in mm."""
    names = ("cam0",), ("cam1",), ("baseline",)
    if not tree.keys() >= set(names):
        return None
    for name in names[:2]:
        if not is_camera_matrix(_array(tree, *name)):
            raise FormatError(f"{name[0]}: expected [fx 0 cx; 0 fy cy; 0 0 1], got {shown(tree[name], _SHOWN)}")
    k = [_array(tree, *name).reshape(3, 3) for name in names[:2]]
    left, right = projections(k[0], k[1], _number(tree, "baseline") / 1000)
    doffs_px = right[0, 2] - left[0, 2]
    if ("doffs",) in tree and abs(_number(tree, "doffs") - doffs_px) > _SAME_DOFFS_PX:
        raise FormatError(
            f"doffs is {_number(tree, 'doffs'):g}, but cx of cam1 minus that of cam0 is {doffs_px:g}: one is wrong"
        )
    bounds = DisparityBounds(*(_number(tree, key) if (key,) in tree else None for key in ("ndisp", "vmin", "vmax")))
    size = None
    if {("width",), ("height",)} <= tree.keys():
        size = checked_size(_number(tree, "width"), _number(tree, "height"))
    return StereoArrays(EyeArrays(p=left), EyeArrays(p=right), size, bounds=bounds, layout="middlebury")


def kitti_cameras(tree: Tree) -> tuple[str, str] | None:
    """Return the two cameras of KITTI's files that are meant: the colour cameras, or else the grey ones."""
    names = {name[-1] for name in tree}
    return next((pair for pair in _KITTI_PAIRS for form in _KITTI_FORMS if {form + n for n in pair} <= names), None)


def zed(tree: Tree, size: Size | None) -> StereoArrays | None:
    """Read ZED's SN*.conf: cameras for each mode, the translation in mm, the turn as a rotation vector."""
    modes = [name[0].removeprefix("LEFT_CAM_") for name in tree if name[0].startswith("LEFT_CAM_") and name[-1] == "fx"]
    if not modes or ("STEREO", "Baseline") not in tree:
        return None
    mode = _chosen({mode: _ZED_SIZES[mode] for mode in modes if mode in _ZED_SIZES}, size)
    eyes = []
    for eye in ("LEFT", "RIGHT"):
        section = f"{eye}_CAM_{mode}"
        values = {name[-1]: _number(tree, *name) for name in tree if name[0] == section and name[-1] in _ZED_NAMES}
        if not {"fx", "fy", "cx", "cy"} <= values.keys():
            raise FormatError(f"{eye}_CAM_{mode}: expected fx, fy, cx and cy")
        names = _ZED_NAMES[4:] if "k4" in values else _ZED_NAMES[4:9]
        d = np.array([values.get(name, 0.0) for name in names])
        eyes.append(_eye(camera_matrix(*(values[name] for name in _ZED_NAMES[:4])), d, "radtan"))
    x, y, z = (_number(tree, "STEREO", f"{axis}_{mode}", missing=0.0) for axis in ("RX", "CV", "RZ"))
    shift = [-abs(_number(tree, "STEREO", "Baseline"))]
    shift += [_number(tree, "STEREO", name, missing=0.0) for name in ("TY", "TZ")]
    turn = np.array(rotation_of((x, y, z)))
    return StereoArrays(eyes[0], eyes[1], _ZED_SIZES[mode], turn, np.array(shift) / 1000)


def realsense(tree: Tree, size: Size | None) -> StereoArrays | None:
    """Read the calibration that RealSense's viewer saves: rectified cameras for each size, the baseline in mm."""
    numbers = [name[1] for name in tree if name[0] == "rectified" and name[-1] == "fx"]
    if not numbers or ("baseline",) not in tree:
        return None
    sizes = {n: Size(*(int(_number(tree, "rectified", n, side)) for side in ("width", "height"))) for n in numbers}
    number = _chosen({n: own for n, own in sizes.items() if min(own) > 0}, size)
    fx, fy, cx, cy = (_number(tree, "rectified", number, key) for key in ("fx", "fy", "ppx", "ppy"))
    k = camera_matrix(fx, fy, cx, cy)
    left, right = projections(k, k, abs(_number(tree, "baseline")) / 1000)
    return StereoArrays(EyeArrays(p=left), EyeArrays(p=right), sizes[number])


def mrcal(tree: Tree, _size: Size | None) -> StereoArrays | None:
    """Read two .cameramodel files of mrcal: K and D in one list, and the camera's pose as rotation and translation."""
    files = [name[:-1] for name in tree if name[-1] == "lensmodel"]
    if len(files) != 2:
        return None
    files = sorted(files, key=lambda name: (eye_of(name) != "left", eye_of(name)))
    eyes, poses, sizes = [], [], []
    for name in files:
        fx, fy, cx, cy, *d = _vector(tree, *name, "intrinsics").tolist()
        width, height = _vector(tree, *name, "imagersize").tolist()
        sizes.append(Size(int(width), int(height)))
        eyes.append(_eye(camera_matrix(fx, fy, cx, cy), np.array(d), str(tree[*name, "lensmodel"]), sizes[-1]))
        x, y, z, *shift = _vector(tree, *name, "extrinsics").tolist()
        poses.append(pose_of(np.array(rotation_of((x, y, z))), np.array(shift)))
    whole = poses[1] @ np.linalg.inv(poses[0])
    return StereoArrays(eyes[0], eyes[1], _one(sizes), whole[:3, :3], whole[:3, 3])


def depthai(tree: Tree, _size: Size | None) -> StereoArrays | None:
    """Read what DepthAI's eepromToJsonFile writes of an OAK: cameras by socket, linked by poses in cm."""
    listed: dict[str, Tree] = {}
    for name, value in tree.items():
        if name[0] == "cameraData" and len(name) > 2:
            listed.setdefault(name[1], {})[name[2:]] = value
    if not listed:
        return None
    cameras = {
        int(_number(pair, "0")): {name[1:]: value for name, value in pair.items() if name[0] == "1"}
        for pair in listed.values()
    }
    keys = [("stereoRectificationData", f"{eye}CameraSocket") for eye in ("left", "right")]
    sockets = [int(_number(tree, *key)) for key in keys]
    if not set(sockets) <= cameras.keys():
        raise FormatError(
            f"cameraData: expected the sockets {sockets} of stereoRectificationData, got {sorted(cameras)}"
        )
    eyes, sizes = [], []
    for socket in sockets:
        camera, where = cameras[socket], f"cameraData, socket {socket}: "
        kind = int(_number(camera, "cameraType", missing=0))
        k, d = _array(camera, "intrinsicMatrix"), _array(camera, "distortionCoeff")
        if kind not in _DEPTHAI_LENSES or not is_camera_matrix(k):
            raise FormatError(f"{where}expected a calibrated camera of cameraType 0 (perspective) or 1 (fisheye)")
        model, count = _DEPTHAI_LENSES[kind]
        sizes.append(Size(*(int(_number(camera, side)) for side in ("width", "height"))))
        eyes.append(_eye(k.reshape(3, 3), d.ravel()[:count], model, sizes[-1]))
    links = []
    for socket, camera in cameras.items():
        # The last camera of a chain leads to -1, with an empty rotation or one of zeros.
        there = int(_number(camera, "extrinsics", "toCameraSocket", missing=-1))
        turn, shift = (_array(camera, "extrinsics", key) for key in ("rotationMatrix", "translation"))
        if there in cameras and is_rotation(turn) and shift.size == 3:
            links.append(Link(str(there), str(socket), pose_of(turn.reshape(3, 3), shift)))
    whole = along(links, *map(str, sockets))
    if whole is None:
        raise FormatError(
            f"cameraData: expected extrinsics that lead from socket {sockets[0]} to socket {sockets[1]}, got none"
        )
    return StereoArrays(eyes[0], eyes[1], _one(sizes), whole[:3, :3], whole[:3, 3] / 100)


Adapter = Callable[[Tree, Size | None], StereoArrays | None]
"""Reads a tree of one format, None for others; the size is the user's or the photographs', None if both are silent."""
ADAPTERS: tuple[Adapter, ...] = (middlebury, zed, realsense, mrcal, depthai)


def _chosen(sizes: Mapping[str, Size], size: Size | None) -> str:
    """Return the mode whose images have a size. Raises FormatError where no mode has it."""
    fitting = [mode for mode, own in sizes.items() if own == size]
    if fitting:
        return fitting[0]
    if size is None and len(sizes) == 1:
        return next(iter(sizes))
    listed = abbreviate([str(own) for own in sizes.values()])
    got = "" if size is None else f", got {size}"
    raise FormatError(f"is for images of {listed}: give the size of yours{got}")


def _eye(k: Array, d: Array, model: str, size: Size | None = None) -> EyeArrays:
    if not is_camera_matrix(k):
        raise FormatError(f"expected focal lengths above 1 px and finite numbers, got {k.tolist()}")
    coefficients, lens, _ = lens_of(d, [model], k, size)
    return EyeArrays(k, coefficients, lens)


def _one(sizes: list[Size]) -> Size:
    if sizes[0] != sizes[1]:
        raise FormatError(f"has images of {sizes[0]} and of {sizes[1]}: expected one size of both cameras")
    return sizes[0]


def _array(tree: Tree, *name: str) -> Array:
    value = tree.get(name)
    return value if isinstance(value, np.ndarray) else np.zeros(0)


def _vector(tree: Tree, *name: str) -> Array:
    counts = {"intrinsics": range(4, 17), "extrinsics": (6,), "imagersize": (2,)}[name[-1]]
    value = _array(tree, *name).ravel()
    if value.size not in counts or not np.isfinite(value).all():
        raise FormatError(f"{'.'.join(name)}: expected {counts[0]} or more finite numbers, got {value.size}")
    return value


def _number(tree: Tree, *name: str, missing: float | None = None) -> float:
    value = _array(tree, *name)
    if value.size == 1 and np.isfinite(value).all():
        return float(value.ravel()[0])
    if missing is not None and not value.size:
        return missing
    raise FormatError(f"{'.'.join(name)}: expected a number, got {shown(tree.get(name, 'nothing'))}")
