"""Calibrations in YAML: OpenCV's, ROS's and Kalibr's, with the cameras before rectification where a file has them."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

from semisynth_gl.calibration.file_values import FormatError, numbers, rotation, stated_size
from semisynth_gl.calibration.opencv_rigs import OpenCvValues
from semisynth_gl.calibration.raw_rig import intrinsics, raw_cameras, rectification
from semisynth_gl.calibration.rig import Projections
from semisynth_gl.calibration.ros_rigs import Camera, ros_cameras
from semisynth_gl.config.yaml_values import YamlError, read_documents
from semisynth_gl.inputs.errors import shown

FORMATS = (
    "OpenCV's YAML with P1 and P2, or with K1, D1, K2, D2, R and T",
    "Kalibr's camchain with cam0 and cam1",
    "camera_info of ROS with projection_matrix, or p as `ros2 topic echo` prints it, of both cameras or only the right",
)
"""The formats in YAML, as text for messages."""


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
    return ros_cameras(documents, source, expected)


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
        sizes.append(stated_size(camera))
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
