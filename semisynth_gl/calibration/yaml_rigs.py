"""Calibrations in YAML: OpenCV's, ROS's and Kalibr's, with the cameras before rectification where a file has them."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from semisynth_gl.calibration.raw_rig import (
    FormatError,
    Intrinsics,
    Matrix,
    intrinsics,
    numbers,
    raw_cameras,
    rectification,
    rotation,
)
from semisynth_gl.calibration.rig import Projections, Size
from semisynth_gl.config.yaml_values import YamlError, read_documents
from semisynth_gl.frame.camera import EYES
from semisynth_gl.inputs.errors import InputError, shown
from semisynth_gl.lens.raw_camera import RawCamera

FORMATS = (
    "OpenCV's YAML with P1 and P2, or with K1, D1, K2, D2, R and T",
    "Kalibr's camchain with cam0 and cam1",
    "camera_info of ROS with projection_matrix, or p as `ros2 topic echo` prints it, of both cameras or only the right",
)
"""The formats in YAML, as text for messages."""

LONGEST_M = 5.0
"""Longest likely baseline. An OpenCV file with a longer one is refused unless the user states the unit."""

# OpenCV's keys, as its samples, its Python users and ORB-SLAM name them: of K, D and the rectifying rotation.
_RAW_KEYS = (
    (("M1", "D1", "R1"), ("M2", "D2", "R2")),
    (("K1", "D1", "R1"), ("K2", "D2", "R2")),
    (("cameraMatrix1", "distCoeffs1", "R1"), ("cameraMatrix2", "distCoeffs2", "R2")),
    (("camera_matrix_1", "dist_coeffs_1", "R1"), ("camera_matrix_2", "dist_coeffs_2", "R2")),
    (("LEFT.K", "LEFT.D", "LEFT.R"), ("RIGHT.K", "RIGHT.D", "RIGHT.R")),
)
_RAW_CAMERAS = (*(key for keys in _RAW_KEYS for eye in keys for key in eye[:2]), "R", "T")
_PROJECTION_KEYS = (("P1", "P2"), ("LEFT.P", "RIGHT.P"))
# ROS's keys of P, K, D and R in calibration files, and in messages of ROS 2 and of ROS 1.
_ROS_KEYS = (
    ("projection_matrix", "camera_matrix", "distortion_coefficients", "rectification_matrix"),
    ("p", "k", "d", "r"),
    ("P", "K", "D", "R"),
)
# Keys of the width and the height, and keys of lists or mappings with both.
_SIZES = (("image_width", "image_height"), ("width", "height"), ("LEFT.width", "LEFT.height"))
_SIZE_PAIRS = ("image_size", "imageSize", "size", "resolution")
_LARGEST_SIDE_PX = 99_999
# Numbers of a translation, and of the coefficients that both models may have.
_AXES, _OF_EITHER = 3, 4


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """One camera: its projection matrix (3, 4), size of images and file, and the camera before rectification.

    ``lens_fault`` says why the latter cannot be used, where it is stated.
    """

    matrix: Matrix
    size: Size | None
    source: str
    raw: RawCamera | None = None
    lens_fault: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class OpenCvValues:
    """The values of an OpenCV file, which may be one of two: intrinsics in one, extrinsics in the other."""

    values: Mapping[str, Any]
    source: str

    @property
    def whole(self) -> bool:
        """Whether the file describes a rig by itself."""
        return _projection_keys(self.values) is not None or {"R", "T"} <= self.values.keys()

    @property
    def raw_only(self) -> bool:
        """Whether the file has the cameras before rectification, and not how they stand."""
        return not self.whole and _raw_keys(self.values) is not None

    def joined(self, other: "OpenCvValues") -> "OpenCvValues":
        """Return the values of both files."""
        return OpenCvValues({**other.values, **self.values}, f"{self.source} and {other.source}")


def parse_yaml(text: str, source: str, expected: str) -> Sequence[OpenCvValues | Projections | Camera]:
    """Return the calibrations of a YAML text: an OpenCV file's values, a rig of Kalibr, or ROS's cameras.

    Args:
        text: the file's content.
        source: the file's name.
        expected: all formats, for messages.

    Raises:
        FormatError: where the text is none of these.
    """
    documents = _documents(text, expected)
    values = documents[0]
    if len(documents) == 1:
        opencv = OpenCvValues(values, source)
        if opencv.whole or opencv.raw_only:
            return [opencv]
        if isinstance(values.get("cam0"), Mapping) and isinstance(values.get("cam1"), Mapping):
            return [_kalibr(values, source)]
    return _ros(documents, source, expected)


# --- OpenCV ---


def opencv_rig(file: OpenCvValues, size: Size | None, unit_m: float | None) -> Projections:
    """Return the rig of an OpenCV file.

    Without P1 and P2, the cameras are rectified by OpenCV's stereoRectify with its default ``alpha``.

    Args:
        file: the values.
        size: the user's size of the images, for a file that does not state it.
        unit_m: metres per unit of the translation; None for metres.

    Raises:
        FormatError: where the file breaks its format.
        InputError: where OpenCV is needed and missing.
    """
    if file.raw_only:
        raise FormatError(
            "is not rectified: it has the cameras before rectification, but not how they stand to each other: expected "
            "P1 and P2 (OpenCV: stereoRectify), or R and T, here or in another `calib`"
        )
    values, source = file.values, file.source
    own_size = _size(values)
    size = own_size or size
    keys, fault = _projection_keys(values), None
    cameras: tuple[Intrinsics, Intrinsics] | None = None
    turns: tuple[Matrix, Matrix] | None = None
    try:
        cameras, turns = _opencv_cameras(values)
    except FormatError as error:
        if keys is None:
            raise
        fault = str(error)
    if keys is not None:
        left, right = (numbers(key, values[key], (3, 4)).copy() for key in keys)
    elif cameras is None:
        raise FormatError("has R and T, but lacks the cameras: expected K1, D1, K2 and D2 as well")
    else:
        if size is None:
            raise FormatError("does not say how large the images are: give `size`, width and height")
        turn, shift = rotation("R", values["R"]), numbers("T", values["T"], None)
        if len(shift) != _AXES:
            raise FormatError(f"T: expected {_AXES} numbers, got {len(shift)}")
        made = rectification(cameras, turn, shift, size)
        turns, (left, right) = made.rotations, made.projections
    for matrix in (left, right):
        matrix[:, 3] *= 1.0 if unit_m is None else unit_m
    if unit_m is None and right[0, 0] > 0 and abs(right[0, 3]) > LONGEST_M * right[0, 0]:
        raise FormatError(
            f"the baseline would be {abs(right[0, 3] / right[0, 0]):g} m: the file is probably not in metres. Set "
            "`unit` to mm, cm or m, the unit of the calibration board's squares",
        )
    raw = None if cameras is None or turns is None or size is None else raw_cameras(cameras, turns, size)
    return Projections(left, right, own_size, source, raw=raw, lens_fault=fault)


def _opencv_cameras(
    values: Mapping[str, Any],
) -> tuple[tuple[Intrinsics, Intrinsics] | None, tuple[Matrix, Matrix] | None]:
    """Return both cameras and the rotations that rectify them, None for each that the file lacks."""
    keys = _raw_keys(values)
    if keys is None:
        return None, None
    model = values.get("distortion_model")
    left, right = (intrinsics(values, each[:2], model=model) for each in keys)
    if model is None and left is not None and len(left.distortion) == _OF_EITHER:
        raise FormatError(
            f"{keys[0][1]}: {_OF_EITHER} coefficients are of a radial-tangential lens or of a fisheye: add the line "
            "`distortion_model: radial-tangential`, or fisheye, to the file"
        )
    cameras = None if left is None or right is None else (left, right)
    if not all(each[2] in values for each in keys):
        return cameras, None
    first, second = (rotation(each[2], values[each[2]]) for each in keys)
    return cameras, (first, second)


def _raw_keys(values: Mapping[str, Any]) -> tuple[tuple[str, str, str], tuple[str, str, str]] | None:
    return next((keys for keys in _RAW_KEYS if all(name in values for eye in keys for name in eye[:2])), None)


def _projection_keys(values: Mapping[str, Any]) -> tuple[str, str] | None:
    return next((keys for keys in _PROJECTION_KEYS if all(key in values for key in keys)), None)


# --- Kalibr ---


def _kalibr(values: Mapping[str, Any], source: str) -> Projections:
    """Return the rig of a camchain, rectified by OpenCV's stereoRectify."""
    cameras, sizes = [], []
    for name in ("cam0", "cam1"):
        camera, prefix = values[name], f"{name}."
        if camera.get("camera_model", "pinhole") != "pinhole":
            raise FormatError(
                f"{prefix}camera_model: expected pinhole, got {shown(camera['camera_model'])}: calibrate with "
                "pinhole-radtan or pinhole-equi"
            )
        for key in ("intrinsics", "distortion_coeffs", "resolution"):
            if key not in camera:
                raise FormatError(f"{prefix}{key}: missing: expected a camchain that Kalibr wrote")
        fx, fy, cx, cy = numbers(prefix + "intrinsics", camera["intrinsics"], (4,)).tolist()
        with_matrix = {**camera, "K": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]}
        made = intrinsics(with_matrix, ("K", "distortion_coeffs"), prefix, camera.get("distortion_model"))
        if made is None:
            raise FormatError(f"{prefix}distortion_coeffs: expected four coefficients, got none")
        cameras.append(made)
        sizes.append(_size(camera))
    if sizes[0] is None or sizes[0] != sizes[1]:
        raise FormatError(f"resolution: expected one size for both cameras, got {sizes[0]} and {sizes[1]}")
    if "T_cn_cnm1" not in values["cam1"]:
        raise FormatError("cam1.T_cn_cnm1: missing: expected how cam1 stands to cam0; calibrate both together")
    # From the frame of cam0 to that of cam1, as OpenCV's R and T.
    placed = numbers("cam1.T_cn_cnm1", values["cam1"]["T_cn_cnm1"], (4, 4))
    turn = rotation("cam1.T_cn_cnm1", placed[:3, :3].tolist())
    pair = cameras[0], cameras[1]
    made_of = rectification(pair, turn, placed[:3, 3], sizes[0])
    return Projections(*made_of.projections, sizes[0], source, raw=raw_cameras(pair, made_of.rotations, sizes[0]))


# --- ROS ---


def paired(cameras: Sequence[Camera]) -> Projections:
    """Return the rig of two cameras, the left one first, or of the right one alone, which holds the baseline.

    Raises:
        InputError: where the sizes differ, or there is no baseline.
    """
    if len(cameras) == 2:
        left, right = cameras
        source = left.source if left.source == right.source else f"{left.source} and {right.source}"
        if left.size != right.size:
            raise InputError(f"{source}: images of {left.size} and of {right.size}: expected one size")
        if np.array_equal(left.matrix[:, 3], right.matrix[:, 3]):
            raise InputError(
                f"{source}: both matrices have {right.matrix[0, 3]:g} at the end of the first row, so the baseline is "
                "0 m: expected 0 for the left camera and -(focal length x baseline) for the right one. Calibrate both "
                "cameras together, as a rig"
            )
        raw = dict(zip(EYES, (left.raw, right.raw), strict=True))
        known = {eye: camera for eye, camera in raw.items() if camera is not None}
        fault = left.lens_fault or right.lens_fault
        if len({camera.model for camera in known.values()}) > 1:
            fault = "expected lenses of one model in both cameras, got a fisheye and a radial-tangential one"
        whole = known if len(known) == 2 and fault is None else None
        return Projections(left.matrix, right.matrix, left.size, source, raw=whole, lens_fault=fault)
    (right,) = cameras
    if right.matrix[0, 3] == 0:
        raise InputError(
            f"{right.source}: is the left camera's, which has no baseline (0 at the end of the first row): give the "
            "right camera's file too, as another `calib`"
        )
    left_matrix = right.matrix.copy()
    left_matrix[:, 3] = 0
    return Projections(left_matrix, right.matrix, right.size, right.source)


def _ros(documents: Sequence[Mapping[str, Any]], source: str, expected: str) -> Sequence[Projections | Camera]:
    if len(documents) == 1:
        left, right = documents[0].get("left"), documents[0].get("right")
        if isinstance(left, Mapping) and isinstance(right, Mapping):
            return [paired([_camera(left, "left.", source, expected), _camera(right, "right.", source, expected)])]
        return [_camera(documents[0], "", source, expected)]
    return [
        _camera(values, f"document {number}: ", source, expected) for number, values in _distinct(documents).items()
    ]


def _distinct(documents: Sequence[Mapping[str, Any]]) -> dict[int, Mapping[str, Any]]:
    """Return documents by their number, from 1; of messages that differ only in their time, only the first."""
    # `ros2 topic echo` without --once prints a camera's message again and again until it is stopped.
    seen: list[tuple[Any, Mapping[str, Any]]] = []
    distinct = {}
    for number, values in enumerate(documents, 1):
        header = values.get("header")
        frame = header.get("frame_id") if isinstance(header, Mapping) else None
        message = (frame, {key: value for key, value in values.items() if key != "header"})
        if message not in seen:
            seen.append(message)
            distinct[number] = values
    return distinct


def _camera(values: Mapping[str, Any], prefix: str, source: str, expected: str) -> Camera:
    keys = next((keys for keys in _ROS_KEYS if keys[0] in values), None)
    if keys is None:
        found = [key for key in _RAW_CAMERAS if key in values]
        if found:
            raise FormatError(
                f"{prefix}is not rectified: it has {', '.join(found)}, but neither P1 and P2 nor all of "
                "K1, D1, K2, D2, R and T. Rectify first (OpenCV: stereoRectify gives P1 and P2), or give all of these"
            )
        missing = f"{prefix}projection_matrix: missing: it " if prefix else ""
        raise FormatError(f"{missing}has {', '.join(list(values)[:8]) or 'nothing'}; {expected}")
    projection_key, matrix_key, distortion_key, rotation_key = keys
    matrix = numbers(prefix + projection_key, values[projection_key], (3, 4))
    if not matrix.any():
        raise FormatError(
            f"{prefix}{projection_key}: is all zeros: the camera is not calibrated, or not rectified. Calibrate the "
            "stereo rig (ROS: `ros2 run camera_calibration cameracalibrator` with both cameras), and give the "
            "calibration of the rectified images",
        )
    size = _size(values)
    _check_whole_image(values, prefix, size)
    try:
        raw = intrinsics(values, (matrix_key, distortion_key), prefix, values.get("distortion_model"))
        if raw is None or size is None or rotation_key not in values:
            return Camera(matrix, size, source)
        turn = rotation(prefix + rotation_key, values[rotation_key])
    except FormatError as error:
        return Camera(matrix, size, source, lens_fault=str(error))
    return Camera(matrix, size, source, raw.camera(turn, size))


def _check_whole_image(values: Mapping[str, Any], prefix: str, size: Size | None) -> None:
    """Refuse a message of ROS whose images are binned, or a window of the calibrated images."""
    for key in ("binning_x", "binning_y"):
        if values.get(key, 0) not in (0, 1):
            fault = f"{prefix}{key}: expected 0 or 1, got {values[key]!r}"[:200]
            raise FormatError(
                f"{fault}: binned images are smaller than the calibrated ones. Take images without binning; "
                "or, if both directions are binned alike, write 1 here and give `scale`, 0.5 for a binning of 2",
            )
    roi = values.get("roi")
    if not isinstance(roi, Mapping):
        return
    window = [roi.get(name, 0) for name in ("x_offset", "y_offset", "width", "height")]
    if window not in ([0, 0, 0, 0], [0, 0, *(size or ())]):
        fault = f"{prefix}roi: expected 0 for x_offset, y_offset, width and height, got {window}"[:200]
        raise FormatError(
            f"{fault}: the images are a window of the calibrated images. Take whole images; or write 0 for "
            "all four, the window's size as the message's width and height, and subtract the offsets from cx and cy in "
            "its projection matrix",
        )


# --- what all have ---


def checked_size(size: Sequence[Any] | None) -> Size | None:
    """Return a width and a height as a size, None for none; raises FormatError where a side cannot be one."""
    # OpenCV writes 0 0 for an unknown size.
    if size is None or list(size) == [0, 0]:
        return None
    try:
        width_px, height_px = int(size[0]), int(size[1])
    except (TypeError, ValueError, OverflowError):
        width_px = height_px = 0
    came = f"{shown(size[0])} x {shown(size[1])}"
    if width_px < 1 or height_px < 1:
        raise FormatError(f"expected a width and height of at least 1 pixel, got {came}")
    if max(width_px, height_px) > _LARGEST_SIDE_PX:
        raise FormatError(f"expected a width and height of at most {_LARGEST_SIDE_PX} pixels, got {came}")
    return Size(width_px, height_px)


def _size(values: Mapping[str, Any]) -> Size | None:
    for width, height in _SIZES:
        if width in values and height in values:
            return checked_size([values[width], values[height]])
    for key in _SIZE_PAIRS:
        value = values.get(key)
        if isinstance(value, Mapping) and "width" in value and "height" in value:
            return checked_size([value["width"], value["height"]])
        if isinstance(value, list) and len(value) == 2:
            return checked_size(value)
    return None


def _documents(text: str, expected: str) -> Sequence[Mapping[str, Any]]:
    """Return the documents of a YAML text, at least one, without empty ones."""
    # OpenCV's first line, %YAML:1.0, is not valid YAML. Tags of matrices are dropped, as they are plain mappings.
    text = re.sub(r"\A%YAML:[^\n]*\n|!!opencv-(?:nd-)?matrix\b", "", text)
    try:
        documents = read_documents(text)
    except YamlError as error:
        line = "" if error.line is None else f"line {error.line}: "
        raise FormatError(f"is no calibration and no YAML ({line}{error}); {expected}") from None
    # `ros2 topic echo` ends each message with ---, which begins an empty document after the last message.
    documents = [values for values in documents if values is not None]
    if not documents or not all(isinstance(values, Mapping) for values in documents):
        raise FormatError(f"is no calibration; {expected}")
    return documents
