"""Calibrations of OpenCV: P1 and P2, and the cameras before rectification, from which P1 and P2 follow."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from semisynth_gl.calibration.file_values import FormatError, Matrix, numbers, rotation, stated_size
from semisynth_gl.calibration.raw_rig import Intrinsics, Unrectified, intrinsics, raw_cameras
from semisynth_gl.calibration.rig import Projections, Size

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
RAW_KEYS = (*(key for keys in _RAW_KEYS for eye in keys for key in eye[:2]), "R", "T")
"""All keys of cameras before rectification, except R1 and R2."""

_PROJECTION_KEYS = (("P1", "P2"), ("LEFT.P", "RIGHT.P"))
# Numbers of a translation, and of the coefficients that both models may have.
_AXES, _OF_EITHER = 3, 4


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


def opencv_rig(file: OpenCvValues, size: Size | None, unit_m: float | None) -> Projections | Unrectified:
    """Return the rig of an OpenCV file: its projections or, without P1 and P2, its cameras with R and T.

    Args:
        file: the values.
        size: the user's size of the images, for a file that does not state it.
        unit_m: metres per unit of the translation; None for metres.

    Raises:
        FormatError: where the file breaks its format.
    """
    if file.raw_only:
        raise FormatError(
            "is not rectified: it has the cameras before rectification, but not how they stand to each other: expected "
            "P1 and P2 (OpenCV: stereoRectify), or R and T, here or in another file"
        )
    values, source = file.values, file.source
    own_size = stated_size(values)
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
            raise FormatError("does not say how large the images are: give the size, width and height")
        turn, shift = rotation("R", values["R"]), numbers("T", values["T"], None)
        if len(shift) != _AXES:
            raise FormatError(f"T: expected {_AXES} numbers, got {len(shift)}")
        _check_unit(float(np.linalg.norm(shift)), unit_m)
        return Unrectified(cameras, turn, shift * (unit_m or 1.0), size, source)
    if right[0, 0] > 0:
        _check_unit(abs(right[0, 3] / right[0, 0]), unit_m)
    for matrix in (left, right):
        matrix[:, 3] *= unit_m or 1.0
    raw = None if cameras is None or turns is None or size is None else raw_cameras(cameras, turns, size)
    return Projections(left, right, own_size, source, raw=raw, lens_fault=fault)


def _check_unit(baseline: float, unit_m: float | None) -> None:
    if unit_m is None and baseline > LONGEST_M:
        raise FormatError(
            f"the baseline would be {baseline:g} m: the file is probably not in metres. Give the unit (mm, cm or m) "
            "of the calibration board's squares"
        )


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
