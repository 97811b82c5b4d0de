"""Calibrations in YAML and JSON, told apart by their keys."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

from semisynth_gl.calibration.camera_chains import basalt_rig, depthai_rig, is_basalt, is_depthai, kalibr_rig
from semisynth_gl.calibration.file_values import FormatError
from semisynth_gl.calibration.opencv_rigs import OpenCvValues
from semisynth_gl.calibration.raw_rig import Unrectified
from semisynth_gl.calibration.rig import Projections
from semisynth_gl.calibration.ros_rigs import Camera, ros_cameras
from semisynth_gl.config.yaml_values import YamlError, read_documents

Read = Projections | Unrectified | Camera
"""What a calibration file describes: a rig, rectified or not, or one camera."""

FORMATS = (
    "OpenCV's YAML with P1 and P2, or with K1, D1, K2, D2, R and T",
    "Kalibr's camchain with cam0 and cam1",
    "Basalt's calibration.json, or DepthAI's of an OAK camera",
    "camera_info of ROS with projection_matrix, or p as `ros2 topic echo` prints it, of both cameras or only the right",
)
"""The formats in YAML and JSON, as text for messages."""


def parse_yaml(text: str, source: str, expected: str) -> Sequence[OpenCvValues | Read]:
    """Return the calibrations of a YAML text: an OpenCV file's values, a rig, or ROS's cameras.

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
            return [kalibr_rig(values, source)]
        if is_basalt(values):
            return [basalt_rig(values, source)]
        if is_depthai(values):
            return [depthai_rig(values, source)]
    return ros_cameras(documents, source, expected)


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
