"""Adapters: each renames the values of one calibration format to names that `aliases` knows."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from semisynth_gl.calibration.aliases import is_camera_matrix, is_rotation, key_and_camera
from semisynth_gl.calibration.finder import pose_of
from semisynth_gl.calibration.sizes import ImageSize
from semisynth_gl.calibration.tree import Array, FormatError, Tree
from semisynth_gl.frame.camera import camera_matrix
from semisynth_gl.frame.raw_camera import rotation_of
from semisynth_gl.geometry.rotations import rotations_from_quaternions
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
_BASALT_POSE = ("px", "py", "pz", "qx", "qy", "qz", "qw")


class CalibrationTree(NamedTuple):
    """Renamed values of a calibration.

    ("pose", a, b) is the matrix (4, 4) that maps points in coordinate frame b to coordinate frame a. The name of a
    coordinate frame is a camera's number or any other text.
    """

    tree: Tree
    cameras: tuple[str, str] | None = None
    """Names of the left and the right camera. None if `find_stereo_arrays` can tell which of two cameras is left."""
    unit: str | None = "m"
    """Unit of lengths; None if the format does not fix it."""


def middlebury(tree: Tree, _size: ImageSize | None) -> CalibrationTree | None:
    """Read calib.txt of Middlebury and ETH3D: cam0, cam1, and the baseline in mm."""
    if not tree.keys() >= {("cam0",), ("cam1",), ("baseline",)}:
        return None
    return CalibrationTree(tree | {("baseline",): np.array(_number(tree, "baseline") / 1000)})


def zed(tree: Tree, size: ImageSize | None) -> CalibrationTree | None:
    """Read ZED's SN*.conf: cameras for each mode, the translation in mm, and a rotation vector."""
    if ("STEREO", "Baseline") not in tree:
        return None
    modes = dict.fromkeys(name[0].removeprefix("LEFT_CAM_") for name in tree)
    mode = _mode_of_size({known: _ZED_SIZES[known] for known in modes if known in _ZED_SIZES}, size)
    eye_of = {f"LEFT_CAM_{mode}": "left", f"RIGHT_CAM_{mode}": "right"}
    made: Tree = {(eye_of[name[0]], name[-1]): value for name, value in tree.items() if name[0] in eye_of}
    t_mm = [-abs(_number(tree, "STEREO", "Baseline"))]
    t_mm += [_number(tree, "STEREO", key, missing=0.0) for key in ("TY", "TZ")]
    rotation = [_number(tree, "STEREO", f"{key}_{mode}", missing=0.0) for key in ("RX", "CV", "RZ")]
    made |= {("R",): np.array(rotation), ("T",): np.array(t_mm) / 1000, ("size",): np.array(_ZED_SIZES[mode], float)}
    return CalibrationTree(made)


def realsense(tree: Tree, size: ImageSize | None) -> CalibrationTree | None:
    """Read the calibration that RealSense's viewer saves: rectified cameras for each size, the baseline in mm."""
    numbers = [name[1] for name in tree if name[0] == "rectified" and name[-1] == "fx"]
    if not numbers or ("baseline",) not in tree:
        return None
    sizes = {n: ImageSize(*(int(_number(tree, "rectified", n, side)) for side in ("width", "height"))) for n in numbers}
    number = _mode_of_size({n: own for n, own in sizes.items() if min(own) > 0}, size)
    made = {name[2:]: value for name, value in tree.items() if name[:2] == ("rectified", number)}
    return CalibrationTree(made | {("baseline",): np.array(abs(_number(tree, "baseline")) / 1000)})


def mrcal(tree: Tree, _size: ImageSize | None) -> CalibrationTree | None:
    """Read .cameramodel files of mrcal: K and D in one list, and the camera's pose as rotation and translation."""
    made = dict(tree)
    for name in (name[:-1] for name in tree if name[-1] == "lensmodel"):
        intrinsics = _array(tree, *name, "intrinsics")
        pose = _array(tree, *name, "extrinsics" if (*name, "extrinsics") in tree else "rt_cam_ref")
        if len(intrinsics) < 4 or len(pose) != 6:
            raise FormatError("expected intrinsics of 4 or more numbers, and extrinsics of 6")
        made |= {(*name, "K"): camera_matrix(*intrinsics[:4]), (*name, "D"): intrinsics[4:]}
        made[*name, "T_cam_ref"] = pose_of(np.array(rotation_of((pose[0], pose[1], pose[2]))), pose[3:])
    return CalibrationTree(made) if len(made) > len(tree) else None


def depthai(tree: Tree, _size: ImageSize | None) -> CalibrationTree | None:
    """Read what DepthAI's eepromToJsonFile writes about an OAK: cameras by socket, linked by poses in cm."""
    made: Tree = {}
    cameras = dict.fromkeys(name[:2] for name in tree if name[0] == "cameraData" and len(name) > 2)
    for camera in cameras:
        socket, values = str(int(_number(tree, *camera, "0"))), (*camera, "1")
        kind = int(_number(tree, *values, "cameraType", missing=0))
        model, count = _DEPTHAI_LENSES.get(kind, (f"omni (cameraType {kind})", 0))
        for name, key in {"K": "intrinsicMatrix", "width": "width", "height": "height"}.items():
            made[socket, name] = _array(tree, *values, key)
        made |= {(socket, "D"): _array(tree, *values, "distortionCoeff")[:count], (socket, "model"): model}
        # The last camera of the chain has toCameraSocket -1, and its rotation is empty or all zeros.
        turn = _array(tree, *values, "extrinsics", "rotationMatrix")
        if turn.size == 9 and is_rotation(turn.reshape(3, 3)):
            there = int(_number(tree, *values, "extrinsics", "toCameraSocket", missing=-1))
            shift_cm = [_number(tree, *values, "extrinsics", "translation", axis) for axis in "xyz"]
            made["pose", str(there), socket] = pose_of(turn.reshape(3, 3), np.array(shift_cm) / 100)
    if not cameras:
        return None
    left, right = (int(_number(tree, "stereoRectificationData", f"{eye}CameraSocket")) for eye in ("left", "right"))
    return CalibrationTree(made, (str(left), str(right)))


def kitti(tree: Tree, _size: ImageSize | None) -> CalibrationTree | None:
    """Read KITTI's rectified colour cameras, or the rectified grey cameras if there are no colour cameras."""
    names = {name[-1] for name in tree}
    for pair in (("2", "3"), ("0", "1")):
        if {f"P_rect_0{number}" for number in pair} <= names:
            # Without the raw cameras: their image size, S_00, differs from that of rectified images, S_rect_00.
            return CalibrationTree({name: value for name, value in tree.items() if "_rect_" in name[-1]}, pair)
        if {f"P{number}" for number in pair} <= names:
            return CalibrationTree(tree, pair)
    return None


def kalibr(tree: Tree, _size: ImageSize | None) -> CalibrationTree | None:
    """Read Kalibr's camchain: T_cn_cnm1 of camera n is the pose from camera n - 1 to camera n."""
    made = dict(tree)
    for name in (name for name in tree if name[-1] == "T_cn_cnm1"):
        _, camera = key_and_camera(name[:-1])
        if camera.isdigit():
            made["pose", camera, str(int(camera) - 1)] = tree[name]
    return CalibrationTree(made) if len(made) > len(tree) else None


def basalt(tree: Tree, _size: ImageSize | None) -> CalibrationTree | None:
    """Read Basalt's JSON: lists of intrinsics, sizes, and poses as translation and quaternion."""
    cameras = [name[2] for name in tree if name[:2] == ("value0", "intrinsics") and name[-1] == "camera_type"]
    if not cameras:
        return None
    made = {name[2:]: value for name, value in tree.items() if name[:2] == ("value0", "intrinsics")}
    sizes = _array(tree, "value0", "resolution")
    made |= {(str(n), "size"): np.array(size) for n, size in enumerate(zip(sizes[::2], sizes[1::2], strict=False))}
    for camera in cameras:
        px, py, pz, *quaternion = (_number(tree, "value0", "T_imu_cam", camera, axis) for axis in _BASALT_POSE)
        length = np.linalg.norm(quaternion)
        if not length:
            raise FormatError("has a quaternion of length 0")
        rotation = rotations_from_quaternions((np.array(quaternion) / length)[None])[0]
        made["pose", "body", camera] = pose_of(rotation, np.array([px, py, pz]))
    return CalibrationTree(made)


def stella(tree: Tree, _size: ImageSize | None) -> CalibrationTree | None:
    """Read Stella's and OpenVSLAM's YAML.

    The section Camera describes both rectified cameras, and StereoRectifier the raw ones.
    """
    if ("StereoRectifier", "K_left") not in tree:
        return None
    fx, fy, cx, cy, product = (_number(tree, "Camera", key) for key in ("fx", "fy", "cx", "cy", "focal_x_baseline"))
    left = np.hstack([camera_matrix(fx, fy, cx, cy), np.zeros((3, 1))])
    right = left.copy()
    right[0, 3] = -product
    return CalibrationTree(tree | {("P_left",): left, ("P_right",): right})


def matlab(tree: Tree, _size: ImageSize | None) -> CalibrationTree | None:
    """Read MATLAB's stereoParameters: the struct that toStruct returns, or its fields saved one by one.

    A field that is saved by itself has the camera's number at the end, as in IntrinsicMatrix1. Matrices are for row
    vectors, and sizes have the height first.
    """
    if ("RotationOfCamera2",) not in tree:
        return None
    made: Tree = {("R",): _square(tree, "RotationOfCamera2").T, ("T",): _array(tree, "TranslationOfCamera2")}
    for number in "12":
        own: Tree = {
            (name[-1].removesuffix(number),): value
            for name, value in tree.items()
            if name == ("ImageSize",) or name[0].endswith(number)
        }
        k = _square(own, "IntrinsicMatrix" if ("IntrinsicMatrix",) in own else "K")
        radial, tangential = _array(own, "RadialDistortion"), _array(own, "TangentialDistortion")
        made[number, "K"] = k if is_camera_matrix(k) else k.T
        made[number, "D"] = np.concatenate([radial[:2], tangential, radial[2:]])
        made[number, "image_shape"] = _array(own, "ImageSize")
    return CalibrationTree(made, unit=None)


Adapter = Callable[[Tree, ImageSize | None], CalibrationTree | None]
ADAPTERS: tuple[Adapter, ...] = (middlebury, zed, realsense, mrcal, depthai, kitti, kalibr, basalt, stella, matlab)
"""Each returns None for other formats. The size is the user's, else that of the photographs, else None."""


def _mode_of_size(sizes: Mapping[str, ImageSize], size: ImageSize | None) -> str:
    """Return the mode whose images have this size; without a size, the only mode. Raises FormatError if none fits."""
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


def _square(tree: Tree, *name: str) -> Array:
    value = _array(tree, *name)
    if value.size != 9:
        raise FormatError(f"{'.'.join(name)}: expected 3 x 3 numbers")
    return value.reshape(3, 3)


def _number(tree: Tree, *name: str, missing: float | None = None) -> float:
    value = _array(tree, *name)
    if value.size == 1:
        return float(value[0])
    if missing is not None and not value.size:
        return missing
    raise FormatError(f"{'.'.join(name)}: expected a number, got {shown(tree.get(name, 'nothing'))}")
