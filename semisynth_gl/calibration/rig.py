"""Rectified rigs: from the P1 and P2 of a calibration, or by OpenCV's stereoRectify."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from semisynth_gl.calibration.aliases import ArrayPair
from semisynth_gl.calibration.finder import StereoArrays, projections
from semisynth_gl.calibration.sizes import ImageSize
from semisynth_gl.calibration.tree import Array
from semisynth_gl.frame.camera import EYES, Eye, StereoCamera, camera_matrix
from semisynth_gl.frame.raw_camera import RawCamera
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.inputs.opencv import open_opencv

# Largest differences, relative and in px, of values that count as equal: calibrations may be rounded to six digits.
_SAME_FOCAL = 1e-4
_SAME_CY_PX = 0.05
# Largest distance of a rectified right camera from the x axis, as a fraction of the baseline. KITTI's is 0.5 % off.
_OFF_BASELINE = 0.01
# The widest rectified view of a fisheye by default, as the tangent of half the angle. In a wider view, OpenCV gives the
# middle too few pixels.
_WIDEST_FISHEYE = math.tan(math.radians(50))


@dataclass(frozen=True, slots=True)
class RectifiedRig:
    """A rectified rig.

    Attributes:
        camera: the rectified cameras.
        source: name of the file or files, for messages.
        raw: the cameras before rectification; None if they are unknown, or if their images are rectified already.
        notes: sentences on what was guessed, and what was ignored.
    """

    camera: StereoCamera
    source: str
    raw: Mapping[Eye, RawCamera] | None = None
    notes: tuple[str, ...] = ()

    @property
    def size(self) -> ImageSize:
        """Size of the images."""
        return ImageSize(self.camera.width_px, self.camera.height_px)

    def scaled(self, scale: float) -> "RectifiedRig":
        """Return the rig of images whose sides are multiplied by ``scale``: reduced below 1, enlarged above."""
        width_px, height_px = self.size.scaled(scale)
        camera = self.camera.scaled(scale, scale, (height_px, width_px))
        raw = self.raw and {eye: each.scaled(scale) for eye, each in self.raw.items()}
        return replace(self, camera=camera, raw=raw)


def make_rig(arrays: StereoArrays, size: ImageSize, alpha: float | None = None) -> RectifiedRig:
    """Return the rig of a calibration for images of ``size``: from P1 and P2, or else by OpenCV's stereoRectify.

    ``alpha`` is passed to stereoRectify; for a fisheye, it is passed as ``balance``. None is OpenCV's default, but
    limits a fisheye's view to 100 degrees.

    Raises:
        InputError: if P1 and P2 do not describe a rectified pair, the baseline is not above 0, both cameras have the
            same position or one is above the other, or OpenCV is needed and missing.
    """
    source, p, rectification, k, d = arrays.source, arrays.p, arrays.rectification, arrays.k, arrays.d
    if p is not None and alpha is not None:
        raise InputError(f"{source} has rectified cameras already: do not give alpha", argument="alpha")
    try:
        if p is None:
            p, rectification = _stereo_rectify(arrays, size, alpha)
            source += ", rectified by stereoRectify"
        left, right = p
        baseline_m = _baseline_m(left, right)
        (fx, _, cx_left, _), (_, fy, cy, _), _ = left.tolist()
        camera = StereoCamera(*size, fx, baseline_m, cx_left, float(right[0, 2]), cy, fy_over_fx=fy / fx)
    except InputError as error:
        raise InputError(f"{source}: {error}") from None
    raw = dict[Eye, RawCamera]()
    if k is not None and d is not None and rectification is not None:
        record = {"width_px": size.width_px, "height_px": size.height_px, "model": arrays.model}
        for index, eye in enumerate(EYES):
            raw[eye] = RawCamera.from_record(record | {"K": k[index], "D": d[index], "R": rectification[index]})
    is_rectified = all(each.is_rectified(camera, eye) for eye, each in raw.items())
    return RectifiedRig(camera, source, None if is_rectified else raw, tuple(arrays.notes))


def _stereo_rectify(arrays: StereoArrays, size: ImageSize, alpha: float | None) -> tuple[ArrayPair, ArrayPair]:
    """Compute (P1, P2) and (R1, R2) from K, D, R and T by OpenCV's stereoRectify."""
    k, d, pose = arrays.k, arrays.d, arrays.pose
    if k is None or d is None or pose is None:
        raise InputError("expected K and D of both cameras, R and T")
    cv2 = open_opencv("rectifying by R and T, as the calibration has no P1 and P2,")
    turn, shift_m = pose[:3, :3].copy(), pose[:3, 3:].copy()  # OpenCV needs contiguous arrays
    right_m, down_m, _ = (-turn.T @ shift_m).ravel().tolist()
    if abs(right_m) <= max(abs(down_m), 1e-9):  # equal positions differ by rounding
        raise InputError(
            f"expected cameras apart and side by side, but the right one is {right_m:.6g} m to the right of the left "
            f"one and {down_m:.6g} m below it: rotate images of a vertical rig by 90 degrees, and calibrate again"
        )
    fisheye = arrays.model == "fisheye"
    chosen = {} if alpha is None else {"balance" if fisheye else "alpha": alpha}
    rectify = cv2.fisheye.stereoRectify if fisheye else cv2.stereoRectify
    flags = cv2.CALIB_ZERO_DISPARITY
    r1, r2, p1, p2, *_ = rectify(k[0], d[0], k[1], d[1], tuple(size), turn, shift_m, flags=flags, **chosen)
    least_focal_px = size.width_px / 2 / _WIDEST_FISHEYE
    if alpha is None and fisheye and p1[0, 0] < least_focal_px:
        centre = ((side - 1) / 2 for side in size)
        centred = camera_matrix(least_focal_px, least_focal_px, *centre)
        p1, p2 = projections(centred, centred, -p2[0, 3] / p2[0, 0])
    return (p1, p2), (r1, r2)


def _baseline_m(left: Array, right: Array) -> float:
    """Return the baseline of two projection matrices; raises InputError if they describe no rectified pair.

    Both matrices of a rectified pair are K [I | t], where both K have the same fx, fy and cy, and t is along x.
    """
    (fx, *_), (_, fy, cy, _), _ = left.tolist()
    refusal = InputError(
        f"is not rectified: the projection matrices are {left.tolist()} and {right.tolist()}. Rectify first "
        "(OpenCV: stereoRectify), and give the calibration of the rectified images"
    )
    largest = [[_SAME_FOCAL * fx] * 3, [_SAME_FOCAL * fx] * 2 + [_SAME_CY_PX], [_SAME_FOCAL] * 3]
    off = [np.abs(matrix[:, :3] - camera_matrix(fx, fy, matrix[0, 2], cy)) for matrix in (left, right)]
    if not (min(fx, fy) > 0 and (off <= np.array(largest)).all()):  # written so that nan fails too
        raise refusal
    # The translations t, metres. Their difference is the right camera's position.
    left_m, right_m = (np.linalg.solve(matrix[:, :3], matrix[:, 3]) for matrix in (left, right))
    baseline_m, down_m, forward_m = map(float, left_m - right_m)
    if np.hypot(down_m, forward_m) > _OFF_BASELINE * abs(baseline_m):
        raise refusal
    if baseline_m == 0:
        raise InputError("the baseline is 0 m: expected one above 0")
    if baseline_m < 0:
        raise InputError(
            f"the baseline is {baseline_m:g} m: swap left and right, in the calibration and in your images"
        )
    return baseline_m
