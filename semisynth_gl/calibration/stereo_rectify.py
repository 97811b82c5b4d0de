"""Rectification of cameras by R and T, as OpenCV's stereoRectify does it."""

import math
from dataclasses import replace

import numpy as np

from semisynth_gl.calibration.arrays import Size, StereoArrays
from semisynth_gl.calibration.rig import turned_size_fault, vertical_fault
from semisynth_gl.calibration.tree import FormatError
from semisynth_gl.inputs.opencv import open_opencv

WIDEST_FISHEYE_DEG = 100.0
"""Angle that the width of a fisheye's rectified images takes at most by default; its tangent keeps the middle sharp."""

# Shorter translations, in any unit, are none.
_NO_SHIFT = 1e-9


def stereo_rectify(arrays: StereoArrays, size: Size, alpha: float | None, fov_deg: float | None) -> StereoArrays:
    """Return a calibration with R1, R2, P1 and P2, which follow from K, D, R and T, with equal principal points.

    Args:
        arrays: a calibration with K of both cameras, R and T.
        size: of the raw and of the rectified images.
        alpha: from 0, for images without borders, to 1, for as much of the raw images as they can show; None for
            OpenCV's default. A fisheye's is OpenCV's ``balance``.
        fov_deg: angle that the width of the rectified images takes, instead of ``alpha``. Without either, it is at
            most `WIDEST_FISHEYE_DEG` for a fisheye: OpenCV's default would shrink the middle of a wide view.

    Raises:
        FormatError: where the cameras have different models of lens or the same position, one stands above the
            other, or the size is written as height and width.
        InputError: where OpenCV is missing.
    """
    left, right, turn, shift_m = arrays.left, arrays.right, arrays.r, arrays.t_m
    if arrays.lens_fault is not None:
        raise FormatError(arrays.lens_fault)
    if left.k is None or right.k is None or turn is None or shift_m is None:
        raise FormatError("expected K of both cameras, R and T")
    cv2 = open_opencv("rectifying by R and T, as the calibration has no P1 and P2,")
    if np.linalg.norm(shift_m) < _NO_SHIFT:
        raise FormatError("expected cameras apart from each other, got a translation of 0 between them")
    right_m, down_m, _ = (-turn.T @ shift_m).tolist()
    fault = vertical_fault(right_m, down_m) or turned_size_fault(size, left.k, right.k)
    if fault is not None:
        raise FormatError(fault)
    placed = tuple(size), np.array(turn), np.array(shift_m).reshape(3, 1)
    fisheye = left.model == "fisheye"
    chosen = {} if alpha is None else {"balance" if fisheye else "alpha": alpha}
    rectify = cv2.fisheye.stereoRectify if fisheye else cv2.stereoRectify
    r1, r2, p1, p2, *_ = rectify(left.k, left.d, right.k, right.d, *placed, flags=cv2.CALIB_ZERO_DISPARITY, **chosen)
    how = "its default alpha" if alpha is None else f"alpha {alpha:g}"
    half_px = size.width_px / 2
    if fov_deg is None and alpha is None and fisheye and p1[0, 0] < half_px / _tangent(WIDEST_FISHEYE_DEG):
        fov_deg = WIDEST_FISHEYE_DEG
    if fov_deg is not None:
        baseline_m = p2[0, 3] / p2[0, 0]
        p1[:2, :3] = half_px / _tangent(fov_deg) * np.eye(2, 3)
        p1[:2, 2] = (np.array(size) - 1) / 2
        p2 = p1.copy()
        p2[0, 3] = baseline_m * p2[0, 0]
        how = f"a view of {fov_deg:g} degrees across"
    return replace(
        arrays,
        source=f"{arrays.source}, rectified by stereoRectify with {how}",
        size=size,
        left=replace(left, r=r1, p=p1),
        right=replace(right, r=r2, p=p2),
    )


def _tangent(fov_deg: float) -> float:
    """Return the tangent of half a field of view."""
    return math.tan(math.radians(fov_deg) / 2)
