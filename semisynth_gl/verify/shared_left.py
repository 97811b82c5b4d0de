"""The left views of the pairs that show one scene are one view; their disparities differ by the baseline alone."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame import CHANNELS
from semisynth_gl.verify.agreement import all_components
from semisynth_gl.verify.single_view import FLOAT32
from semisynth_gl.verify.verdict import Verdict


def check_lefts(frame: StoredFrame, other: StoredFrame, verdict: Verdict) -> None:
    """Check the left view of a pair against that of another pair of the same scene.

    Args:
        frame: the pair as it was read.
        other: the other one, of the same size; findings name it.
        verdict: takes findings.
    """
    own, camera = frame.camera.left_alone, other.camera.left_alone
    if own != camera:
        verdict.add("lefts", f"the left camera is not that of {other.name}: it is {own}, there {camera}")
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
            depths = [pair.camera.depth_m(pair.left.disparity[y, x]) for pair in (one, two)]
            detail = f", by whose baseline it is {depths[1]:g} m away and by this one's {depths[0]:g} m"
            array = f"disparity_left of {one.name}"
            verdict.add_pixels("lefts", array, f"is not that of {two.name}", wrong, detail)
            return


def _of_another_depth(frame: StoredFrame, other: StoredFrame) -> NDArray[np.bool_]:
    """Return where a pair's left disparity is not that of the depth that another pair has there, (H, W) bool.

    Where the other one has no disparity, nothing is said.
    """
    disparity, its = frame.left.disparity, other.left.disparity.astype(np.float64)
    doffs_px, its_doffs_px = frame.camera.doffs_px, other.camera.doffs_px
    if not (frame.camera.focal_baseline and other.camera.focal_baseline):
        return np.zeros(disparity.shape, bool)
    ratio = frame.camera.focal_baseline / other.camera.focal_baseline
    with np.errstate(invalid="ignore"):
        expected = ratio * (its + its_doffs_px) - doffs_px
        bound = ratio * (FLOAT32 * (np.abs(its) + 2 * abs(its_doffs_px)) + other.rounding_px(its))
        bound += FLOAT32 * (np.abs(expected) + 2 * abs(doffs_px)) + frame.rounding_px(disparity)
        missing = np.isfinite(its) & (expected > bound)
        missing &= expected < frame.encodings.disparity.limit_px - bound
        return np.where(
            np.isfinite(disparity), np.isfinite(its) & ~(np.abs(disparity - expected) <= bound), missing
        ).astype(np.bool_)
