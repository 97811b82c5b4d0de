"""The cameras of a rig before rectification, from the matrices that calibration tools write, and their rectification.

OpenCV's names hold: K is a camera matrix, D are the coefficients of a lens, R and T lead from the left camera's frame
to the right one's, R1 and R2 from each raw camera's frame to the rectified one's, and P1 and P2 project rectified
points.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from semisynth_gl.calibration.file_values import FormatError, Matrix, numbers
from semisynth_gl.calibration.rig import Projections, Size, turned_size_fault, vertical_fault
from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.frame.raw_camera import COEFFICIENTS, LensModel, RawCamera
from semisynth_gl.inputs.errors import shown
from semisynth_gl.inputs.opencv import open_opencv

WIDEST_FISHEYE_DEG = 100.0
"""Angle that the width of a fisheye's rectified images takes at most by default; its tangent keeps the middle sharp."""

# What tools call the two models of a lens: OpenCV, ROS and Kalibr.
_MODELS: Mapping[str, LensModel] = {
    "plumb_bob": "radial-tangential",
    "rational_polynomial": "radial-tangential",
    "radtan": "radial-tangential",
    "radial-tangential": "radial-tangential",
    "equidistant": "fisheye",
    "kannala_brandt": "fisheye",
    "kannala_brandt4": "fisheye",
    "fisheye": "fisheye",
}
# OpenCV's 14 coefficients end with the tilt of a sensor.
_WITH_TILT, _WITHOUT_TILT = 14, 12
# Shorter translations, in any unit, are none.
_NO_SHIFT = 1e-9
# Matrices are printed with six digits.
_PRINTED = 1e-4


class Intrinsics(NamedTuple):
    """One camera before rectification, without its rotation: K (3, 3), D (N,), and the model of its lens."""

    matrix: Matrix
    distortion: Matrix
    model: LensModel

    def camera(self, rotation: Matrix, size: Size) -> RawCamera:
        """Return the camera with the rotation (3, 3) that rectifies it, whose images have a size."""
        (fx, _, cx), (_, fy, cy), _ = self.matrix.tolist()
        rows = tuple(tuple(row) for row in rotation.tolist())
        return RawCamera(*size, fx, fy, cx, cy, self.model, tuple(self.distortion.tolist()), rows)


class Unrectified(NamedTuple):
    """A rig whose file does not say how to rectify it.

    Attributes:
        cameras: the left camera and the right one.
        turn: R, (3, 3).
        shift_m: T, (3,), metres.
        size: of the raw and of the rectified images.
        source: the file's name.
    """

    cameras: tuple[Intrinsics, Intrinsics]
    turn: Matrix
    shift_m: Matrix
    size: Size
    source: str

    def rectified(self, alpha: float | None, fov_deg: float | None) -> Projections:
        """Rectify the rig by OpenCV's stereoRectify with equal principal points.

        Args:
            alpha: from 0, for images without borders, to 1, for as much of the raw images as they can show; None for
                OpenCV's default. A fisheye's is OpenCV's ``balance``.
            fov_deg: angle that the width of the rectified images takes, instead of ``alpha``. Without either, it is at
                most `WIDEST_FISHEYE_DEG` for a fisheye: OpenCV's default would shrink the middle of a wide view.

        Raises:
            FormatError: where the cameras have different models of lens or the same position, one stands above the
                other, or the size is written as height and width.
            InputError: where OpenCV is missing.
        """
        cv2 = open_opencv("rectifying by R and T, as the calibration has no P1 and P2,")
        left, right = self.cameras
        if left.model != right.model:
            raise FormatError(f"expected lenses of one model, got {left.model} left and {right.model} right")
        if np.linalg.norm(self.shift_m) < _NO_SHIFT:
            raise FormatError("expected cameras apart from each other, got a translation of 0 between them")
        right_m, down_m, _ = (-self.turn.T @ self.shift_m.ravel()).tolist()
        fault = vertical_fault(right_m, down_m) or turned_size_fault(self.size, left.matrix, right.matrix)
        if fault is not None:
            raise FormatError(fault)
        matrices = left.matrix, left.distortion, right.matrix, right.distortion
        placed = tuple(self.size), np.array(self.turn), np.array(self.shift_m).reshape(3, 1)
        fisheye = left.model == "fisheye"
        chosen = {} if alpha is None else {"balance" if fisheye else "alpha": alpha}
        rectify = cv2.fisheye.stereoRectify if fisheye else cv2.stereoRectify
        r1, r2, p1, p2, *_ = rectify(*matrices, *placed, flags=cv2.CALIB_ZERO_DISPARITY, **chosen)
        raw = raw_cameras(self.cameras, (r1, r2), self.size)
        how = "its default alpha" if alpha is None else f"alpha {alpha:g}"
        half_px = self.size.width_px / 2
        if fov_deg is None and alpha is None and fisheye and p1[0, 0] < half_px / _tangent(WIDEST_FISHEYE_DEG):
            fov_deg = WIDEST_FISHEYE_DEG
        if fov_deg is not None:
            baseline_m = p2[0, 3] / p2[0, 0]
            p1[:2, :3] = half_px / _tangent(fov_deg) * np.eye(2, 3)
            p1[:2, 2] = (np.array(self.size) - 1) / 2
            p2 = p1.copy()
            p2[0, 3] = baseline_m * p2[0, 0]
            how = f"a view of {fov_deg:g} degrees across"
        return Projections(p1, p2, self.size, f"{self.source}, rectified by stereoRectify with {how}", raw=raw)


def intrinsics(
    values: Mapping[str, Any], keys: tuple[str, str], prefix: str = "", model: object = None
) -> Intrinsics | None:
    """Return the camera that a file describes under the keys of K and D.

    Returns None where either is missing, or K is all zeros, as ROS writes for a camera that is not calibrated.

    Args:
        values: the file's values.
        keys: of K and of D.
        prefix: what leads to ``values``, for messages.
        model: the name that the file gives the lens; None for OpenCV's own.

    Raises:
        FormatError: where the lens has another model than OpenCV's two, or a matrix is not one.
    """
    if any(values.get(key) is None for key in keys):
        return None
    matrix = numbers(prefix + keys[0], values[keys[0]], (3, 3))
    if not matrix.any():
        return None
    known = _MODELS.get(str(model).lower()) if model else "radial-tangential"
    if known is None:
        raise FormatError(
            f"{prefix}lens model {shown(model)}: expected {', '.join(_MODELS)}: calibrate with one of these"
        )
    zeros = matrix[0, 1], matrix[1, 0], matrix[2, 0], matrix[2, 1], matrix[2, 2] - 1
    if not (min(matrix[0, 0], matrix[1, 1]) > 0 and max(map(abs, zeros)) < _PRINTED):
        raise FormatError(
            f"{prefix}{keys[0]}: expected [fx 0 cx; 0 fy cy; 0 0 1] with fx and fy above 0, got {matrix.tolist()}"
        )
    # Nothing is written of a lens that does not bend.
    distortion = np.zeros(4 if known == "fisheye" else 5)
    if not _is_empty(values[keys[1]]):
        distortion = numbers(prefix + keys[1], values[keys[1]], None)
    if len(distortion) == _WITH_TILT and not distortion[_WITHOUT_TILT:].any():
        distortion = distortion[:_WITHOUT_TILT]
    if len(distortion) not in COEFFICIENTS[known]:
        counts = " or ".join(map(str, COEFFICIENTS[known]))
        raise FormatError(
            f"{prefix}{keys[1]}: expected {counts} coefficients of a {known} lens, got {len(distortion)}"
            + (": the last two, a tilted sensor's, must be 0" if len(distortion) == _WITH_TILT else "")
        )
    return Intrinsics(matrix, distortion, known)


def raw_cameras(
    cameras: tuple[Intrinsics, Intrinsics], rotations: tuple[Matrix, Matrix], size: Size
) -> dict[Eye, RawCamera]:
    """Return both eyes' cameras of images of a size."""
    return {eye: camera.camera(turn, size) for eye, camera, turn in zip(EYES, cameras, rotations, strict=True)}


def _tangent(fov_deg: float) -> float:
    """Return the tangent of half a field of view."""
    return math.tan(math.radians(fov_deg) / 2)


def _is_empty(node: object) -> bool:
    data = node.get("data") if isinstance(node, Mapping) else node
    return isinstance(data, list) and not data
