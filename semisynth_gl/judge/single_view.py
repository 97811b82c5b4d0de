"""Checks of one view by itself: disparity, depth, instances, sky, normals; and of the pair's calibration.

Each check takes a pair as it was read, and adds findings and measures to the verdict.
"""

from math import isclose, isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame.camera import Eye
from semisynth_gl.frame.channels import SKY, Channel, View
from semisynth_gl.inputs.errors import counted
from semisynth_gl.judge.agreement import all_components, dot
from semisynth_gl.judge.findings import Verdict, count_pixels

Where = NDArray[np.bool_]

# Bounds; docs/verify.md has them.
# calib.txt writes vmin and vmax with six digits, which loses at most 5e-6 of the value.
_SIX_DIGITS = 1e-5
# In d = f B / Z - doffs, f B, doffs, the depth and the difference are each rounded to float32 once, and GPUs may divide
# with an error of 2.5 units in the last place. 8 units of 2**-23 leave a margin of about two.
FLOAT32 = 8 * 2.0**-23
"""Largest error of a disparity that follows from a depth, relative to the disparity, and to f B / Z and doffs."""
DEVIATING_PX = 1e-3
"""Largest error of correspondences where the right camera deviates, px; they are computed in more steps."""
_UNIT_LENGTH = 1e-5
# Rasterisers move edges by less than this, px, so a pixel beside an edge may show a surface that its own ray meets
# from behind.
_EDGE_PX = 1 / 16
LAST_VALID_PX = 2.0
"""Largest disparity of the last valid pixel of a surface that leaves the valid range, px; it passes through 0."""


def check_disparity(frame: StoredFrame, eye: Eye, verdict: Verdict, *, largest_px: float | None) -> None:
    """Check a view's disparity.

    It may not be NaN, or above the config's limit, ``largest_px``. It must be positive or, if signed, at least that of
    infinity. It may be inf only where the rig allows it.
    """
    disparity, name = frame.view(eye).get("disparity"), f"disparity_{eye}"
    if disparity is None:
        return
    valid, infinite = np.isfinite(disparity), np.isposinf(disparity)
    share = float(infinite.mean())
    verdict.measures["invalid_share"] = max(share, verdict.measures.get("invalid_share", 0.0))
    verdict.add_pixels("disparity", name, "is NaN or -inf", ~(valid | infinite))
    negative, fault = valid & (disparity <= 0), "is 0 or below"
    if frame.encodings.signed:
        infinity_px = -frame.camera.doffs_px
        bound = _SIX_DIGITS * abs(infinity_px) + frame.rounding_px(infinity_px)
        # Where the right camera deviates, the disparity of infinity differs from pixel to pixel.
        negative = valid & (disparity < infinity_px - bound) & frame.camera.rectified
        fault = f"is below {infinity_px:g}, which is infinitely far away,"
    least = float(disparity.min(where=negative, initial=np.inf))
    verdict.add_pixels("disparity", name, fault, negative, f"; the least is {least:g} px")
    if largest_px is not None and valid.any():
        largest = float(disparity[valid].max())
        if largest > largest_px + _SIX_DIGITS * abs(largest_px) + float(frame.rounding_px(largest)):
            verdict.add("disparity", f"{name} reaches {largest:g} px, the config allows {largest_px:g} px")
    left_out = frame.left_out(eye)
    verdict.add_pixels("disparity", name, "is known in a border", valid & left_out)
    lacking = _lacking(frame, eye, infinite & ~left_out)
    if lacking is not None and lacking.any():
        _check_infinite(frame, eye, disparity, lacking, verdict)


def always_valid(frame: StoredFrame) -> bool:
    """Return whether the rig and the encoding give every surface but the sky a valid disparity."""
    return frame.encodings.signed or (frame.camera.doffs_px <= 0 and frame.camera.rectified)


def _lacking(frame: StoredFrame, eye: Eye, infinite: Where) -> Where | None:
    """Return where a disparity is inf, except in a sky that has none; None where the place of the sky is not known."""
    if frame.encodings.signed or (frame.camera.doffs_px < 0 and frame.camera.rectified):
        return infinite
    sky = frame.sky(eye)
    return None if sky is None else infinite & ~sky


def check_sky(frame: StoredFrame, eye: Eye, verdict: Verdict) -> None:
    """Check a view's mask of the sky: its values, and whether instances, depth and disparity agree with it."""
    view, name, doffs_px = frame.view(eye), f"sky_{eye}", frame.camera.doffs_px
    mask = view.get("sky")
    if mask is None:
        return
    sky = mask == SKY
    verdict.add_pixels("sky", name, f"is neither 0 nor {SKY}", (mask != 0) & ~sky)
    known = frame.sky_of_instances(eye)
    if known is not None:
        verdict.add_pixels("sky", name, "is not that of the instances in the pair's provenance", sky != known)
    depth, disparity = view.get("depth"), view.get("disparity")
    if depth is not None:
        verdict.add_pixels("sky", name, "has a finite depth", sky & np.isfinite(depth))
    if disparity is None or not frame.camera.rectified:
        return
    if frame.encodings.signed or doffs_px < 0:
        bound = _SIX_DIGITS * abs(doffs_px) + frame.rounding_px(disparity)
        beyond = np.isinf(disparity) & (abs(doffs_px) > frame.encodings.disparity.limit_px)
        wrong = sky & ~frame.left_out(eye) & ~beyond & ~(np.abs(disparity + doffs_px) <= bound)
        verdict.add_pixels("sky", name, f"has another disparity than {-doffs_px:g} px", wrong)
    else:
        verdict.add_pixels("sky", name, "has a disparity", sky & np.isfinite(disparity))


def _check_infinite(
    frame: StoredFrame, eye: Eye, disparity: NDArray[np.float32], infinite: Where, verdict: Verdict
) -> None:
    """Check that a disparity is inf only where a surface may have left the valid range.

    The background fills the view, so each pixel has a depth. Then d = f B / Z - doffs is above 0, unless doffs is
    positive and the surface is far away. A surface that extends so far passes through 0 first, so the disparities
    beside inf must be small. If the provenance counts disparities beyond the encoding, only the number of inf can be
    judged.
    """
    name, doffs_px = f"disparity_{eye}", frame.camera.doffs_px
    beyond = count_beyond(frame, View.disparity, eye)
    if beyond:
        count = int(infinite.sum())
        if count < beyond or (always_valid(frame) and count != beyond):
            fault = f"is inf in {count_pixels(infinite)}, the provenance counts {beyond} beyond the encoding"
            verdict.add("disparity", f"{name} {fault}")
        return
    if always_valid(frame):
        why = "a signed encoding" if frame.encodings.signed else f"a doffs of {doffs_px:g} px"
        verdict.add_pixels("disparity", name, "is inf", infinite, f"; {why} rules that out")
        return
    around = disparity[neighbours(infinite) & np.isfinite(disparity)]
    if around.size and float(around.min()) > LAST_VALID_PX:
        least = f"; the disparities beside them are {float(around.min()):g} px or more"
        verdict.add_pixels("disparity", name, "is inf", infinite, least)


def count_beyond(frame: StoredFrame, channel: Channel[Any], eye: Eye) -> int:
    """Return the number of a view's values that were beyond the encoding, as the provenance counts them."""
    counts = frame.provenance.get(channel.beyond_key)
    limited = isfinite(frame.encodings.codec(channel.codec).limit_px)
    count = counts.get(eye) if isinstance(counts, dict) and limited else 0
    return count if isinstance(count, int) else 0


def _check_camera(frame: StoredFrame, verdict: Verdict) -> None:
    recorded, values = frame.provenance.get("camera"), frame.camera.values()
    if not isinstance(recorded, dict):
        verdict.add("calib", "the pair's provenance has no camera to compare with")
        return
    del values["doffs_px"]
    values.pop("deviation", None)  # the provenance's own
    # Both leave out a ratio of 1.
    recorded, values = ({"fy_over_fx": 1.0} | each for each in (recorded, values))
    for name, value in values.items():
        expected = recorded.get(name)
        # The baseline is stored in millimetres, and fy in px, which may cost a last digit.
        if not (isinstance(expected, int | float) and isclose(value, expected, rel_tol=1e-12, abs_tol=1e-12)):
            verdict.add("calib", f"{name} is {value!r}, in the pair's provenance {expected!r}")


def check_calibration(frame: StoredFrame, verdict: Verdict) -> None:
    """Check the camera against the pair's provenance, and calib.txt, where there is one, against the left disparity."""
    calibration, camera = frame.calibration, frame.camera
    _check_camera(frame, verdict)
    if calibration is None:
        return
    # All numbers are written with all their digits; only their difference is rounded, once.
    if not isclose(calibration.doffs_px, camera.doffs_px, rel_tol=1e-9, abs_tol=1e-9):
        verdict.add("calib", f"doffs is {calibration.doffs_px!r}, cx1 - cx0 is {camera.doffs_px!r}")
    disparity = frame.view("left")["disparity"]
    valid = disparity[np.isfinite(disparity)]
    if not valid.size:
        return
    least, largest = float(valid.min()), float(valid.max())
    for name, written, stored in (("vmin", calibration.vmin_px, least), ("vmax", calibration.vmax_px, largest)):
        # The encoding rounds the file's disparities; calib.txt has six digits.
        if abs(written - stored) > float(frame.rounding_px(stored)) + _SIX_DIGITS * max(1.0, abs(written), abs(stored)):
            verdict.add("calib", f"{name} is {written:g}, the left disparity's is {stored:g} px")
    if calibration.ndisp < largest * (1 - _SIX_DIGITS) - float(frame.rounding_px(largest)):
        verdict.add("calib", f"ndisp {calibration.ndisp} is below the largest disparity, {largest:g} px")


def check_depth(frame: StoredFrame, eye: Eye, verdict: Verdict) -> None:
    """Check a view's depth, if any, against Z = f B / (d + doffs), up to the rounding of float32 and the encoding."""
    view, camera = frame.view(eye), frame.camera
    disparity, depth = view.get("disparity"), view.get("depth")
    if depth is None or disparity is None:
        return
    y, x = np.mgrid[: depth.shape[0], : depth.shape[1]].astype(np.float64)
    way = camera.correspondence(eye, x, y, depth.astype(np.float64))
    expected = way[..., 0] * (-1 if eye == "left" else 1)
    bound = FLOAT32 * (np.abs(expected) + 2 * abs(camera.doffs_px)) + frame.rounding_px(disparity)
    bound += 0.0 if camera.rectified else DEVIATING_PX
    encodable = (np.abs(expected) < frame.encodings.disparity.limit_px - bound) & ~frame.left_out(eye)
    missing = np.isfinite(depth) & (depth > 0) & ((expected > bound) | frame.encodings.signed) & encodable
    wrong = np.where(np.isfinite(disparity), ~(np.abs(disparity - expected) <= bound), missing)

    def values(at: tuple[int, int]) -> str:
        return f", which has {depth[at]:g} m or {expected[at]:g} px, and a disparity of {disparity[at]:g} px"

    verdict.add_pixels("depth", f"depth_{eye}", "is not that of the disparity", wrong, values)


def check_instances(frame: StoredFrame, eye: Eye, verdict: Verdict) -> None:
    """Check that instance ids are row numbers, from 1, of pair.json's ``instances``, and 0 only without a disparity."""
    view, name, rows = frame.view(eye), f"instances_{eye}", frame.provenance.get("instances")
    ids, disparity = view.get("instances"), view.get("disparity")
    if ids is None or disparity is None:
        return
    if not isinstance(rows, list):
        verdict.add("instances", f"{name}: there are ids, but the pair's provenance has no list of instances")
    elif int(ids.max()) > len(rows):
        listed = counted(len(rows), "instance")
        verdict.add("instances", f"{name} reaches {ids.max()}, the provenance lists {listed}")
    verdict.add_pixels("instances", name, "is 0 in spite of a disparity", (ids == 0) & np.isfinite(disparity))


def check_normals(frame: StoredFrame, eye: Eye, verdict: Verdict) -> None:
    """Check that a view's normals are unit vectors towards the eye, and 0 exactly where nothing is seen.

    A disparity, a depth, an instance id or the sky's mask shows that something is seen. Their absence shows that
    nothing is seen only if the sky is known, and the view has depth or ids or every surface must have a disparity.
    """
    view, camera, name = frame.view(eye), frame.camera, f"normals_{eye}"
    normals, disparity, depth, ids = (view.get(key) for key in ("normals", "disparity", "depth", "instances"))
    if normals is None or disparity is None:
        return
    seen = np.isfinite(disparity)
    seen |= False if depth is None else np.isfinite(depth)
    seen |= False if ids is None else ids > 0
    beyond, sky = count_beyond(frame, View.disparity, eye), frame.sky(eye)
    seen |= False if sky is None else sky
    always_disparity = always_valid(frame) and camera.focal_baseline > 0 and beyond == 0
    nothing_known = sky is not None and (depth is not None or ids is not None or always_disparity)
    zero = all_components(normals == 0)
    verdict.add_pixels("normals", name, "is 0 though something is seen", seen & zero)
    unseen = ~(seen | frame.left_out(eye)) & nothing_known
    verdict.add_pixels("normals", name, "is not 0 where nothing is seen", unseen & ~zero)
    height, width = disparity.shape
    column, row = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    length = np.sqrt(dot(normals, normals))
    edge = _EDGE_PX / min(camera.focal_px, camera.focal_y_px)
    away = dot(normals, camera.rays_of_eye(eye, column, row)) > _UNIT_LENGTH + edge
    wrong = ~zero & ~(np.abs(length - 1) <= _UNIT_LENGTH)
    detail = f"; the lengths of these go up to {length[wrong].max():.6g}" if wrong.any() else ""
    verdict.add_pixels("normals", name, "is no unit vector", wrong, detail)
    verdict.add_pixels("normals", name, "points away from the eye", away)


def neighbours(where: Where) -> Where:
    """Return the pixels that are neighbours, in row or column, of pixels that are True; both arrays are (H, W)."""
    beside = np.zeros_like(where)
    beside[1:] |= where[:-1]
    beside[:-1] |= where[1:]
    beside[:, 1:] |= where[:, :-1]
    beside[:, :-1] |= where[:, 1:]
    return beside
