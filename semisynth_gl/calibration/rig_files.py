"""Calibration files in the formats of Middlebury and ETH3D, KITTI, OpenCV, and ROS."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.calibration.rig import DisparityBounds, Projections, Rig, Size, rectified
from semisynth_gl.codecs import read_bytes
from semisynth_gl.codecs.calib import calib_matrix, calib_values
from semisynth_gl.config.fields import LARGEST
from semisynth_gl.config.yaml_values import YamlError, read_documents
from semisynth_gl.inputs.errors import InputError, ReadError, shown
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.textures.image_files import find_files

FORMATS = (
    "calib.txt of Middlebury and ETH3D (cam0=[...], cam1=[...], baseline=...)",
    "calib_cam_to_cam.txt of KITTI (P_rect_02: ..., P_rect_03: ...) or its P2: and P3:",
    "OpenCV's YAML with P1 and P2",
    "camera_info of ROS with projection_matrix, or p as `ros2 topic echo` prints it, of both cameras or only the right",
)
"""The formats that `read_rigs` reads, as text for messages."""

_EXPECTED = f"expected {'; '.join(FORMATS)}"
_EXTENSIONS = (".txt", ".yaml", ".yml")
# At most one way to match each text: without alternatives to try, a text that does not match fails fast.
_NUMBER = r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_KITTI = re.compile(
    rf"^(P_rect_0[0-3]|P[0-3]|S_rect_0[0-3])[ \t]*:[ \t]*({_NUMBER}(?:[ \t]+{_NUMBER})*)[ \t\r]*$", re.MULTILINE
)
_KITTI_PAIRS = (("P_rect_02", "P_rect_03"), ("P_rect_00", "P_rect_01"), ("P2", "P3"), ("P0", "P1"))
# First part of the name of a folder that ETH3D's archives have.
_ETH3D = "two_view_"
_OPENCV_PAIRS = (("P1", "P2"), ("LEFT.P", "RIGHT.P"))
# Keys of the projection matrix in ROS's calibration files, in messages of ROS 2, and in messages of ROS 1.
_ROS_MATRICES = ("projection_matrix", "p", "P")
# Keys of OpenCV files that describe cameras before rectification.
_RAW_CAMERAS = ("M1", "K1", "cameraMatrix1", "camera_matrix_1", "LEFT.K", "R", "T")
# Largest number of characters of a matrix in a message.
_SHOWN = 400
# Keys of the width and the height, and keys of lists or mappings with both.
_SIZES = (("image_width", "image_height"), ("width", "height"), ("LEFT.width", "LEFT.height"))
_SIZE_PAIRS = ("image_size", "imageSize", "size")

LONGEST_M = 5.0
"""Longest likely baseline. An OpenCV file with a longer one is refused unless the user states the unit."""
_LARGEST_BYTES = 1 << 20
_LARGEST_SIDE_PX = 99_999


def read_rigs(sources: Sequence[str | Path], *, size: Size | None = None, unit_m: float | None = None) -> list[Rig]:
    """Read rectified rigs from calibration files and globs, in the order of the files.

    Each file describes a rig, except for ROS's camera_info, which describes one camera. Those of both cameras, the left
    camera's first, in two files or in one, make a rig; the right camera's suffices, since it holds the baseline.

    Args:
        sources: names of files, and globs.
        size: size of the images, for files that do not state it; where a file does, both must be equal.
        unit_m: metres per unit of the translation in OpenCV files; None for files in metres, and for other formats.

    Raises:
        InputError: where there is no file, or a rig is not rectified.
        ReadError: where a file has none of the formats, or breaks its format.
    """
    paths: dict[Path, None] = {}
    for source in sources:
        if expanded(source).is_dir():
            raise InputError(f"`calib` {source}: is a folder; give files, or a glob such as '{source}/*/calib.txt'")
        matches = find_files([source], _EXTENSIONS)
        if not matches:
            raise InputError(f"`calib` {source}: no such file, and as a glob it matches no .txt, .yaml or .yml")
        paths |= dict.fromkeys(matches)
    calibrations = [calibration for path in paths for calibration in _read(path, unit_m)]
    pairs = [pair for pair in calibrations if isinstance(pair, Projections)]
    cameras = [camera for camera in calibrations if isinstance(camera, _Camera)]
    if cameras and (pairs or len(cameras) > 2):
        names = ", ".join(camera.source for camera in cameras[:4]) + (", ..." if len(cameras) > 4 else "")
        raise InputError(
            f"{len(cameras)} of {len(calibrations)} calibrations are of one camera ({names}): expected two of "
            "these, the left camera's first, or only the right camera's"
        )
    if cameras:
        pairs = [_paired(cameras)]
    return [rectified(pair, size) for pair in pairs]


class _Camera(NamedTuple):
    """The camera_info of one camera: its projection matrix (3, 4), the size of its images, and its file."""

    matrix: NDArray[np.float64]
    size: Size | None
    source: str


def _paired(cameras: Sequence[_Camera]) -> Projections:
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
        return Projections(left.matrix, right.matrix, left.size, source)
    (right,) = cameras
    if right.matrix[0, 3] == 0:
        raise InputError(
            f"{right.source}: is the left camera's, which has no baseline (0 at the end of the first row): give the "
            "right camera's file too, as another `calib`"
        )
    left_matrix = right.matrix.copy()
    left_matrix[:, 3] = 0
    return Projections(left_matrix, right.matrix, right.size, right.source)


class _FormatError(Exception):
    """A file breaks its format, as the message says without naming the file."""


def _read(path: Path, unit_m: float | None) -> Sequence[Projections | _Camera]:
    try:
        return _parsed(read_bytes(path, _LARGEST_BYTES).decode("utf-8-sig"), str(path), unit_m)
    except UnicodeDecodeError:
        raise ReadError(path, f"is not text; {_EXPECTED}") from None
    except _FormatError as error:
        raise ReadError(path, str(error)) from None


def _parsed(text: str, source: str, unit_m: float | None) -> Sequence[Projections | _Camera]:
    calibrations: Sequence[Projections | _Camera]
    if "cam0" in (lines := calib_values(text)):
        calibrations = [_middlebury(lines, source)]
    elif _KITTI.search(text):
        calibrations = [_kitti(text, source)]
    else:
        documents = _yaml(text)
        for left, right in _OPENCV_PAIRS:
            if left in documents[0] and right in documents[0] and len(documents) == 1:
                return [_opencv(documents[0], (left, right), source, unit_m)]
        calibrations = _ros(documents, source)
    if unit_m is not None:
        raise _FormatError("its format states the unit: leave `unit` out, which is only for OpenCV's files")
    return calibrations


def _middlebury(values: Mapping[str, str], source: str) -> Projections:
    missing = [key for key in ("cam0", "cam1", "baseline") if key not in values]
    if missing:
        raise _FormatError(f"lacks {', '.join(missing)}: expected cam0=[...], cam1=[...], baseline=... in millimetres")

    def number(key: str) -> float:
        try:
            return float(values[key])
        except ValueError:
            raise _FormatError(f"{key}: expected a number, got {shown(values[key])}") from None

    left, right = (_middlebury_matrix(key, values[key]) for key in ("cam0", "cam1"))
    baseline_m = number("baseline") / 1000
    if not abs(baseline_m) <= LARGEST:
        raise _FormatError(f"baseline: expected at most {LARGEST:g} m, got {baseline_m:g} m")
    right[0, 3] = -right[0, 0] * baseline_m
    doffs_px = float(right[0, 2] - left[0, 2])
    if "doffs" in values and abs(number("doffs") - doffs_px) > 0.02:
        raise _FormatError(
            f"doffs is {number('doffs'):g}, but cx of cam1 minus cx of cam0 is {doffs_px:g}: one of them is wrong"
        )
    size = (number("width"), number("height")) if "width" in values and "height" in values else None
    ndisp, vmin, vmax = (number(key) if key in values else None for key in ("ndisp", "vmin", "vmax"))
    # ETH3D's files have the same form as Middlebury's, but lie in folders such as two_view_training or two_view_test.
    layout = "eth3d" if any(part.startswith(_ETH3D) for part in Path(source).absolute().parts) else "middlebury"
    return Projections(left, right, _checked_size(size), source, DisparityBounds(ndisp, vmin, vmax), layout)


def _middlebury_matrix(key: str, text: str) -> NDArray[np.float64]:
    """Return a matrix (3, 4), its last column 0."""
    try:
        matrix = np.reshape(calib_matrix(text), (3, 3))
    except ValueError:
        raise _FormatError(f"{key}: expected a matrix [f 0 cx; 0 f cy; 0 0 1], got {shown(text, _SHOWN)}") from None
    if not (np.abs(matrix) <= LARGEST).all():
        raise _FormatError(f"{key}: expected finite numbers of at most {LARGEST:g}, got {shown(text, _SHOWN)}")
    return np.hstack([matrix, np.zeros((3, 1))])


def _kitti(text: str, source: str) -> Projections:
    values = {key: [float(number) for number in numbers.split()] for key, numbers in _KITTI.findall(text)}
    pair = next((pair for pair in _KITTI_PAIRS if values.keys() >= set(pair)), None)
    if pair is None:
        raise _FormatError(f"has {', '.join(values)}: expected P_rect_02 and P_rect_03, or P2 and P3")
    for key in pair:
        if len(values[key]) != 12:
            raise _FormatError(f"{key}: expected 12 numbers, got {len(values[key])}")
    sizes = [values.get(key.replace("P", "S", 1)) for key in pair]
    if sizes[0] != sizes[1] or (sizes[0] is not None and len(sizes[0]) != 2):
        raise _FormatError(f"the rectified sizes are {sizes[0]} and {sizes[1]}: expected one width and height")
    left, right = (np.reshape(values[key], (3, 4)) for key in pair)
    return Projections(left, right, _checked_size(sizes[0]), source, layout="kitti")


def _opencv(values: Mapping[str, Any], keys: tuple[str, str], source: str, unit_m: float | None) -> Projections:
    left, right = (_matrix(key, values[key]) for key in keys)
    for matrix in (left, right):
        matrix[:, 3] *= 1.0 if unit_m is None else unit_m
    if unit_m is None and right[0, 0] > 0 and abs(right[0, 3]) > LONGEST_M * right[0, 0]:
        raise _FormatError(
            f"the baseline would be {abs(right[0, 3] / right[0, 0]):g} m: the file is probably not in metres. Set "
            "`unit` to mm, cm or m, the unit of the calibration board's squares",
        )
    return Projections(left, right, _size(values), source)


def _ros(documents: Sequence[Mapping[str, Any]], source: str) -> Sequence[Projections | _Camera]:
    if len(documents) == 1:
        left, right = documents[0].get("left"), documents[0].get("right")
        if isinstance(left, Mapping) and isinstance(right, Mapping):
            return [_paired([_ros_camera(left, "left.", source), _ros_camera(right, "right.", source)])]
        return [_ros_camera(documents[0], "", source)]
    return [_ros_camera(values, f"document {number}: ", source) for number, values in _distinct(documents).items()]


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


def _ros_camera(values: Mapping[str, Any], prefix: str, source: str) -> _Camera:
    key = next((key for key in _ROS_MATRICES if key in values), None)
    if key is None:
        raw = [key for key in _RAW_CAMERAS if key in values]
        if raw:
            raise _FormatError(
                f"{prefix}is not rectified: it has {', '.join(raw)}, of raw cameras, but no P1 and P2. Rectify first "
                "(OpenCV: stereoRectify gives P1 and P2), and store both in this file",
            )
        missing = f"{prefix}projection_matrix: missing: it " if prefix else ""
        raise _FormatError(f"{missing}has {', '.join(list(values)[:8]) or 'nothing'}; {_EXPECTED}")
    matrix = _matrix(prefix + key, values[key])
    if not matrix.any():
        raise _FormatError(
            f"{prefix}{key}: is all zeros: the camera is not calibrated, or not rectified. Calibrate the stereo rig "
            "(ROS: `ros2 run camera_calibration cameracalibrator` with both cameras), and give the calibration of the "
            "rectified images",
        )
    size = _size(values)
    _check_whole_image(values, prefix, size)
    return _Camera(matrix, size, source)


def _check_whole_image(values: Mapping[str, Any], prefix: str, size: Size | None) -> None:
    """Refuse a message of ROS whose images are binned, or a window of the calibrated images."""
    for key in ("binning_x", "binning_y"):
        if values.get(key, 0) not in (0, 1):
            fault = f"{prefix}{key}: expected 0 or 1, got {values[key]!r}"[:200]
            raise _FormatError(
                f"{fault}: binned images are smaller than the calibrated ones. Take images without binning; "
                "or, if both directions are binned alike, write 1 here and give `scale`, 0.5 for a binning of 2",
            )
    roi = values.get("roi")
    if not isinstance(roi, Mapping):
        return
    window = [roi.get(name, 0) for name in ("x_offset", "y_offset", "width", "height")]
    if window not in ([0, 0, 0, 0], [0, 0, *(size or ())]):
        fault = f"{prefix}roi: expected 0 for x_offset, y_offset, width and height, got {window}"[:200]
        raise _FormatError(
            f"{fault}: the images are a window of the calibrated images. Take whole images; or write 0 for "
            "all four, the window's size as the message's width and height, and subtract the offsets from cx and cy in "
            "its projection matrix",
        )


def _matrix(key: str, node: Any) -> NDArray[np.float64]:  # noqa: ANN401 - any YAML value
    """Return a (3, 4) matrix from a mapping with ``data``, a list of rows, or a list of 12 numbers."""
    data = node.get("data") if isinstance(node, Mapping) else node
    try:
        values = np.array(data, np.float64)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.size != 12 or (isinstance(node, Mapping) and (node.get("rows", 3), node.get("cols", 4)) != (3, 4)):
        raise _FormatError(f"{key}: expected a 3 x 4 projection matrix of 12 numbers, got {shown(node, _SHOWN)}")
    return values.reshape(3, 4)


def _size(values: Mapping[str, Any]) -> Size | None:
    for width, height in _SIZES:
        if width in values and height in values:
            return _checked_size([values[width], values[height]])
    for key in _SIZE_PAIRS:
        value = values.get(key)
        if isinstance(value, Mapping) and "width" in value and "height" in value:
            return _checked_size([value["width"], value["height"]])
        if isinstance(value, list) and len(value) == 2:
            return _checked_size(value)
    return None


def _checked_size(size: Sequence[Any] | None) -> Size | None:
    # OpenCV writes 0 0 for an unknown size.
    if size is None or list(size) == [0, 0]:
        return None
    try:
        width_px, height_px = int(size[0]), int(size[1])
    except (TypeError, ValueError, OverflowError):
        width_px = height_px = 0
    came = f"{shown(size[0])} x {shown(size[1])}"
    if width_px < 1 or height_px < 1:
        raise _FormatError(f"expected a width and height of at least 1 pixel, got {came}")
    if max(width_px, height_px) > _LARGEST_SIDE_PX:
        raise _FormatError(f"expected a width and height of at most {_LARGEST_SIDE_PX} pixels, got {came}")
    return Size(width_px, height_px)


def _yaml(text: str) -> Sequence[Mapping[str, Any]]:
    """Return the documents of a YAML text, at least one, without empty ones."""
    # OpenCV's first line, %YAML:1.0, is not valid YAML. The tag of its matrices is dropped, as they are plain mappings.
    text = re.sub(r"\A%YAML:[^\n]*\n|!!opencv-matrix\b", "", text)
    try:
        documents = read_documents(text)
    except YamlError as error:
        line = "" if error.line is None else f"line {error.line}: "
        raise _FormatError(f"is no calibration and no YAML ({line}{error}); {_EXPECTED}") from None
    # `ros2 topic echo` ends each message with ---, which begins an empty document after the last message.
    documents = [values for values in documents if values is not None]
    if not documents or not all(isinstance(values, Mapping) for values in documents):
        raise _FormatError(f"is no calibration; {_EXPECTED}")
    return documents
