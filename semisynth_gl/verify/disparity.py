"""What one view's disparity must satisfy by itself, and with calibration and depth."""

from math import isfinite

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.camera import StereoCamera
from semisynth_gl.dataset.stored import StoredFrame
from semisynth_gl.verify.finding import Verdict

VIEWS = ("left", "right")

# calib.txt writes vmin and vmax with six digits: at most 5e-6 of the value is lost.
_SIX_DIGITS = 1e-5
# d = f B / Z - doffs in float32: f B and doffs are rounded once each, GPUs may divide with 2.5 units in the last place,
# and depth and difference are rounded once each. 8 units of 2**-23 leave a margin of two.
_FLOAT32 = 8 * 2.0**-23
# A surface that leaves the valid range does so through 0; this much lies between its last valid pixel and the next.
LAST_VALID_PX = 2.0


def check_disparity(frame: StoredFrame, most: float | None, verdict: Verdict) -> None:
    """Check both disparities: no NaN, positive, inf only where the rig makes it so.

    Args:
        frame: the pair as it was read.
        most: the largest that the config allows, px, or None.
        verdict: takes findings and measures.
    """
    invalid = pixels = 0
    for side, disparity in zip(VIEWS, (frame.disparity_left, frame.disparity_right), strict=True):
        if disparity is None:
            continue
        pixels += disparity.size
        infinite = np.isposinf(disparity)
        valid = np.isfinite(disparity)
        invalid += int(infinite.sum())
        broken = ~(valid | infinite)
        if broken.any():
            verdict.add("disparity", f"{side}: {count_of(broken)} NaN or -inf, the first at {first_of(broken)}")
        not_positive = valid & (disparity <= 0)
        if not_positive.any():
            least = float(disparity[not_positive].min())
            verdict.add(
                "disparity",
                f"{side}: {count_of(not_positive)} not positive, the first at {first_of(not_positive)}, "
                f"least {least:g} px",
            )
        if most is not None and valid.any():
            largest = float(disparity[valid].max())
            if largest > most * (1 + _SIX_DIGITS) + float(frame.rounding_px(largest)):
                verdict.add("disparity", f"{side}: largest {largest:g} px, the config allows {most:g} px")
        if infinite.any():
            _check_invalid(
                side,
                disparity,
                infinite,
                beyond(frame, "disparity_beyond", side, frame.disparity_largest_px),
                frame.camera,
                verdict,
            )
    verdict.measures["invalid_share"] = invalid / pixels


def _check_invalid(
    side: str,
    disparity: NDArray[np.float32],
    infinite: NDArray[np.bool_],
    lost: int,
    camera: StereoCamera,
    verdict: Verdict,
) -> None:
    """Check that inf stands only where a surface may have left the valid range.

    The background closes the view, so each pixel has a depth, and d = f B / Z - doffs is above 0 unless doffs is
    positive and the surface far enough. A surface that goes so far passes through 0 first. Where the encoding could not
    say disparities, ``lost`` of them, only their number can be judged.
    """
    if lost:
        count = int(infinite.sum())
        if count < lost or (camera.doffs_px <= 0 and count != lost):
            verdict.add(
                "disparity", f"{side}: {count_of(infinite)} inf, the provenance counts {lost} beyond the encoding"
            )
        return
    share = f"{infinite.mean():.4%} of the pixels, the first at {first_of(infinite)}"
    if camera.doffs_px <= 0:
        verdict.add("disparity", f"{side}: inf in {share}, though a doffs of {camera.doffs_px:g} px rules it out")
        return
    around = disparity[beside(infinite) & np.isfinite(disparity)]
    if around.size and float(around.min()) > LAST_VALID_PX:
        verdict.add("disparity", f"{side}: inf in {share}, beside disparities of at least {float(around.min()):g} px")


def beyond(frame: StoredFrame, key: str, side: str, largest_px: float) -> int:
    """Return how many values of a view the encoding could not say, by the provenance's ``key``.

    ``largest_px`` is the largest that it can; where there is no such limit, 0.
    """
    counts = frame.provenance.get(key)
    count = counts.get(side) if isinstance(counts, dict) and isfinite(largest_px) else 0
    return count if isinstance(count, int) else 0


def check_calibration(frame: StoredFrame, verdict: Verdict) -> None:
    """Check the camera against the pair's origin, and calib.txt, where there is one, against itself and the truth."""
    calibration, camera = frame.calibration, frame.camera
    _check_camera(frame, verdict)
    if calibration is None:
        return
    # Each number is written with all its digits; their difference is rounded once.
    if not _close(calibration.doffs_px, camera.doffs_px, 1e-9):
        verdict.add("calib", f"doffs {calibration.doffs_px!r} is not cx1 - cx0 = {camera.doffs_px!r}")
    valid = frame.disparity_left[np.isfinite(frame.disparity_left)]
    if not valid.size:
        return
    for name, said, is_ in (
        ("vmin", calibration.vmin_px, float(valid.min())),
        ("vmax", calibration.vmax_px, float(valid.max())),
    ):
        # The encoding rounds what the file has, and six digits what calib.txt has.
        if abs(said - is_) > float(frame.rounding_px(is_)) + _SIX_DIGITS * max(1.0, abs(said), abs(is_)):
            verdict.add("calib", f"{name} is {said:g}, the left disparity's is {is_:g} px")
    largest = float(valid.max())
    if calibration.ndisp < largest * (1 - _SIX_DIGITS) - float(frame.rounding_px(largest)):
        verdict.add("calib", f"ndisp {calibration.ndisp} is below the largest disparity, {largest:g} px")


def _check_camera(frame: StoredFrame, verdict: Verdict) -> None:
    recorded = frame.provenance.get("camera")
    if not isinstance(recorded, dict):
        verdict.add("calib", "the pair's provenance has no camera to compare with")
        return
    for name in frame.camera.__slots__:
        ours = getattr(frame.camera, name)
        theirs = recorded.get(name)
        # Through millimetres and back the baseline may lose its last digit.
        if not (isinstance(theirs, int | float) and _close(ours, theirs, 1e-12)):
            verdict.add("calib", f"{name} is {ours!r}, in the pair's provenance {theirs!r}")


def check_depth(frame: StoredFrame, verdict: Verdict) -> None:
    """Check Z = f B / (d + doffs) where there are depth files, to float32's rounding and the encoding's."""
    camera = frame.camera
    for name in VIEWS:
        disparity, depth = getattr(frame, f"disparity_{name}"), getattr(frame, f"depth_{name}")
        if depth is None or disparity is None:
            continue
        seen = np.isfinite(depth) & (depth > 0)
        valid = np.isfinite(disparity)
        with np.errstate(divide="ignore", invalid="ignore"):
            expected = camera.focal_baseline / depth.astype(np.float64) - camera.doffs_px
            bound = _FLOAT32 * (np.abs(expected) + 2 * abs(camera.doffs_px)) + frame.rounding_px(disparity)
            sayable = expected < frame.disparity_largest_px - bound
            wrong = np.where(valid, ~(np.abs(disparity - expected) <= bound), seen & (expected > bound) & sayable)
        if wrong.any():
            y, x = np.argwhere(wrong)[0]
            verdict.add(
                "depth",
                f"{name}: {count_of(wrong)} off; at ({x}, {y}) {depth[y, x]:g} m is {expected[y, x]:g} px, "
                f"the disparity there is {disparity[y, x]:g} px",
            )


def check_instances(frame: StoredFrame, verdict: Verdict) -> None:
    """Check that instance ids count rows of pair.json's ``instances``, and that 0 stands where nothing is seen."""
    rows = frame.provenance.get("instances")
    for name in VIEWS:
        disparity, ids = getattr(frame, f"disparity_{name}"), getattr(frame, f"instances_{name}")
        if ids is None or disparity is None:
            continue
        if not isinstance(rows, list):
            verdict.add("instances", f"{name}: there are ids, but the pair's provenance has no list of instances")
        elif int(ids.max()) > len(rows):
            verdict.add("instances", f"{name}: id {int(ids.max())}, but the provenance lists {len(rows)} instances")
        nothing = (ids == 0) & np.isfinite(disparity)
        if nothing.any():
            verdict.add("instances", f"{name}: {count_of(nothing)} without an instance have a disparity")


def count_of(where: NDArray[np.bool_]) -> str:
    """Say of how many pixels (H, W) something is true."""
    number = int(where.sum())
    return f"{number} pixel{'' if number == 1 else 's'}"


def first_of(where: NDArray[np.bool_]) -> str:
    """Say which is the first of them, column and row."""
    y, x = np.argwhere(where)[0]
    return f"({x}, {y})"


def beside(where: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the neighbours, in the row and the column, of the pixels (H, W) of which something is true."""
    found = np.zeros_like(where)
    found[1:] |= where[:-1]
    found[:-1] |= where[1:]
    found[:, 1:] |= where[:, :-1]
    found[:, :-1] |= where[:, 1:]
    return found


def _close(one: float, other: float, relative: float) -> bool:
    return bool(abs(one - other) <= relative * max(1.0, abs(one), abs(other)))
