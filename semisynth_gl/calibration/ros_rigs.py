"""Calibrations of ROS: files of camera_calibration, and messages of camera_info."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from semisynth_gl.calibration.file_values import FormatError, Matrix, numbers, rotation, stated_size
from semisynth_gl.calibration.opencv_rigs import RAW_KEYS
from semisynth_gl.calibration.raw_rig import intrinsics
from semisynth_gl.calibration.rig import Projections, Size
from semisynth_gl.frame.camera import EYES
from semisynth_gl.frame.raw_camera import RawCamera
from semisynth_gl.inputs.errors import InputError

# ROS's keys of P, K, D and R in calibration files, and in messages of ROS 2 and of ROS 1.
_ROS_KEYS = (
    ("projection_matrix", "camera_matrix", "distortion_coefficients", "rectification_matrix"),
    ("p", "k", "d", "r"),
    ("P", "K", "D", "R"),
)


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
            "right camera's file too"
        )
    left_matrix = right.matrix.copy()
    left_matrix[:, 3] = 0
    return Projections(left_matrix, right.matrix, right.size, right.source)


def ros_cameras(documents: Sequence[Mapping[str, Any]], source: str, expected: str) -> Sequence[Projections | Camera]:
    """Return the rig of a file of both cameras, or the camera of each document; raises FormatError for other files."""
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
        found = [key for key in RAW_KEYS if key in values]
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
    size = stated_size(values)
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
                "or, if both directions are binned alike, write 1 here and give the scale, 0.5 for a binning of 2",
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
