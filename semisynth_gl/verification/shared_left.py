"""Pairs that show the same scene share their left view; their disparities differ only by the right camera."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame.channels import CHANNELS
from semisynth_gl.verification.agreement import all_components
from semisynth_gl.verification.single_view import DEVIATING_PX, FLOAT32
from semisynth_gl.verification.verdict import Verdict


def check_lefts(frame: StoredFrame, other: StoredFrame, verdict: Verdict) -> None:
    """Compare the left view of a pair with the left view of another pair of the same scene and size."""
    own, camera = frame.camera.left_alone, other.camera.left_alone
    if own != camera:
        verdict.add("lefts", f"the left camera is not that of {other.name}: {own} instead of {camera}")
        return
    for name, channel in CHANNELS.items():
        mine, its = frame.left.get(name), other.left.get(name)
        if channel.of_own_view and mine is not None and its is not None:
            differs = ~all_components((mine == its) if mine.ndim == 3 else (mine == its)[..., None])
            verdict.add_pixels("lefts", channel.role("left"), f"is not that of {other.name}", differs)
    for one, two in ((frame, other), (other, frame)):
        wrong = _of_another_depth(one, two)
        if wrong.any():
            y, x = np.argwhere(wrong)[0]
            at = np.array(float(x)), np.array(float(y))
            depths = [float(pair.camera.depth_at("left", *at, pair.left.disparity[y, x])) for pair in (one, two)]
            detail = f", which is {depths[1]:g} m away and not {depths[0]:g} m"
            verdict.add_pixels("lefts", f"disparity_left of {one.name}", f"is not that of {two.name}", wrong, detail)
            return


def _of_another_depth(frame: StoredFrame, other: StoredFrame) -> NDArray[np.bool_]:
    """Return where a pair's left disparity contradicts the depth in another pair's left view, (H, W) bool."""
    disparity, its = frame.left.disparity, other.left.disparity.astype(np.float64)
    camera, its_camera = frame.camera, other.camera
    if not (camera.focal_baseline and its_camera.focal_baseline):
        return np.zeros(disparity.shape, bool)
    y_px, x_px = np.mgrid[: disparity.shape[0], : disparity.shape[1]].astype(np.float64)
    depth_m = its_camera.depth_at("left", x_px, y_px, its)
    expected = -camera.correspondence("left", x_px, y_px, depth_m)[..., 0]
    bound = FLOAT32 * (np.abs(its) + 2 * abs(its_camera.doffs_px)) + other.rounding_px(its)
    bound *= camera.focal_baseline / its_camera.focal_baseline
    bound += FLOAT32 * (np.abs(expected) + 2 * abs(camera.doffs_px)) + frame.rounding_px(disparity)
    bound += 0.0 if camera.rectified and its_camera.rectified else 2 * DEVIATING_PX
    missing = np.isfinite(its) & (expected > bound) & (expected < frame.encodings.disparity.limit_px - bound)
    wrong = np.isfinite(its) & ~(np.abs(disparity - expected) <= bound)
    result: NDArray[np.bool_] = np.where(np.isfinite(disparity), wrong, missing)
    return result
