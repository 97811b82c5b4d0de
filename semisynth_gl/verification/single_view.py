"""Checks of one view by itself: disparity, calibration, depth, instances, sky, normals, flow, change of disparity.

Each check takes a pair as it was read, and adds findings and measures to the verdict.
"""

from collections.abc import Mapping
from math import inf, isclose, isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.frame.channels import CHANNELS, OUTSIDE, SKY, VISIBLE, Channel, View
from semisynth_gl.inputs.errors import counted
from semisynth_gl.verification.agreement import all_components, check_mask_values, dot, ends, inside_px
from semisynth_gl.verification.lens import find_flow_borders, find_lost_change
from semisynth_gl.verification.verdict import Verdict, count_pixels

Where = NDArray[np.bool_]

OPPOSITE: Mapping[str, str] = {"flow": "flow_backward", "flow_backward": "flow"}
"""The two channels of flow, each with the channel of the opposite direction."""
# Bounds of flow; docs/verify.md derives them.
_FLOW_PX = 1e-3
_FLOW_SHARE = 1e-5
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
# A surface that leaves the valid range passes through 0. Largest disparity, px, of its last valid pixel.
_LAST_VALID_PX = 2.0


def check_single_views(frame: StoredFrame, largest_px: float | None, verdict: Verdict) -> None:
    """Check each view by itself; ``largest_px`` is the largest disparity that the config allows, None for no limit."""
    _check_disparity(frame, largest_px, verdict)
    for check in (_check_depth, _check_instances):
        for eye in EYES:
            check(frame, eye, verdict)
    for eye in EYES:
        _check_sky(frame, eye, verdict)
        check_normals(frame, eye, verdict)
        for channel in OPPOSITE:
            _check_flow(frame, channel, eye, verdict)
        check_change(frame, eye, largest_px, verdict)


def _check_disparity(frame: StoredFrame, largest_px: float | None, verdict: Verdict) -> None:
    """Check both disparities.

    No disparity may be NaN, or above the config's limit. Disparities must be positive or, if signed, at least that of
    infinity. They may be inf only where the rig allows it.
    """
    invalid = pixels = 0
    for eye in EYES:
        disparity, name = frame.view(eye).get("disparity"), f"disparity_{eye}"
        if disparity is None:
            continue
        valid, infinite = np.isfinite(disparity), np.isposinf(disparity)
        pixels += disparity.size
        invalid += int(infinite.sum())
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
    verdict.measures["invalid_share"] = invalid / pixels


def _always_valid(frame: StoredFrame) -> bool:
    """Return whether the rig and the encoding give every surface but the sky a valid disparity."""
    return frame.encodings.signed or (frame.camera.doffs_px <= 0 and frame.camera.rectified)


def _lacking(frame: StoredFrame, eye: Eye, infinite: Where) -> Where | None:
    """Return where a disparity is inf, except in a sky that has none; None where the place of the sky is not known."""
    if frame.encodings.signed or (frame.camera.doffs_px < 0 and frame.camera.rectified):
        return infinite
    sky = frame.sky(eye)
    return None if sky is None else infinite & ~sky


def _check_sky(frame: StoredFrame, eye: Eye, verdict: Verdict) -> None:
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
    beyond = _count_beyond(frame, View.disparity, eye)
    if beyond:
        count = int(infinite.sum())
        if count < beyond or (_always_valid(frame) and count != beyond):
            fault = f"is inf in {count_pixels(infinite)}, the provenance counts {beyond} beyond the encoding"
            verdict.add("disparity", f"{name} {fault}")
        return
    if _always_valid(frame):
        why = "a signed encoding" if frame.encodings.signed else f"a doffs of {doffs_px:g} px"
        verdict.add_pixels("disparity", name, "is inf", infinite, f"; {why} rules that out")
        return
    around = disparity[_neighbours(infinite) & np.isfinite(disparity)]
    if around.size and float(around.min()) > _LAST_VALID_PX:
        least = f"; the disparities beside them are {float(around.min()):g} px or more"
        verdict.add_pixels("disparity", name, "is inf", infinite, least)


def _count_beyond(frame: StoredFrame, channel: Channel[Any], eye: Eye) -> int:
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


def _check_depth(frame: StoredFrame, eye: Eye, verdict: Verdict) -> None:
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


def _check_instances(frame: StoredFrame, eye: Eye, verdict: Verdict) -> None:
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
    beyond, sky = _count_beyond(frame, View.disparity, eye), frame.sky(eye)
    seen |= False if sky is None else sky
    always_disparity = _always_valid(frame) and camera.focal_baseline > 0 and beyond == 0
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


def has_flow(flow: NDArray[np.float32]) -> Where:
    """Return where both components of flow (H, W, 2) are finite, (H, W) bool."""
    return all_components(np.isfinite(flow))


def flow_bound_px(flow: NDArray[np.floating], encoding_px: float | NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the largest error (...) px of finite flow or changes of disparity (..., C) px.

    It is the sum of the renderer's error and the encoding's, ``encoding_px``, which is one number or (...).
    """
    return _FLOW_PX + _FLOW_SHARE * np.sqrt(dot(flow, flow)) + encoding_px


def _check_flow(frame: StoredFrame, channel: str, eye: Eye, verdict: Verdict) -> None:
    """Check a view's flow in one direction: no NaN, and both components of a pixel are finite or both are inf.

    Its mask must be `OUTSIDE` exactly where there is no flow, or the flow leads out of the image, and not `VISIBLE` in
    borders.
    """
    view, name = frame.view(eye), f"{channel}_{eye}"
    flow, mask = view.get(channel), view.get(f"{channel}_visibility")
    if flow is None:
        return
    infinite = np.isposinf(flow)
    verdict.add_pixels("flow", name, "is NaN or -inf", ~all_components(np.isfinite(flow) | infinite))
    verdict.add_pixels("flow", name, "is inf in only one component", infinite[..., 0] != infinite[..., 1])
    missing = int((~has_flow(flow)).sum())
    beyond = _count_beyond(frame, CHANNELS[channel], eye)
    if missing < beyond:
        fault = f"{missing} pixels without flow, the provenance counts {beyond} beyond the encoding"
        verdict.add("flow", f"{name}: {fault}")
    verdict.measures[f"{name}_none_share"] = missing / infinite[..., 0].size
    if mask is not None:
        name = f"{channel}_visibility_{eye}"
        _check_outside(name, flow, mask, frame.encodings.flow.error_px, verdict)
        border, _ = find_flow_borders(frame, eye, channel)
        verdict.add_pixels("flow-mask", name, "is 255 though a border hides the point", border & (mask == VISIBLE))


def _check_outside(
    name: str, flow: NDArray[np.float32], mask: NDArray[np.uint8], encoding_px: float, verdict: Verdict
) -> None:
    check_mask_values("flow-mask", name, mask, verdict)
    known = has_flow(flow)
    verdict.add_pixels("flow-mask", name, "is not 0 without flow", ~known & (mask != OUTSIDE))
    flow = np.where(known[..., None], flow, 0)
    x, y = ends(flow)
    within, margin = inside_px(x, y), flow_bound_px(flow, encoding_px)

    def goal(at: tuple[int, int]) -> str:
        return f", which has {mask[at]} and goes to ({x[at]:.6g}, {y[at]:.6g})"

    wrong = known & (within > margin) & (mask == OUTSIDE)
    verdict.add_pixels("flow-mask", name, "is 0 for flow into the image", wrong, goal)
    wrong = known & (within < -margin) & (mask != OUTSIDE)
    verdict.add_pixels("flow-mask", name, "is neither 0 nor 128 for flow out of the image", wrong, goal)


def check_change(frame: StoredFrame, eye: Eye, largest_px: float | None, verdict: Verdict) -> None:
    """Check a view's change of disparity.

    It must be finite exactly where disparity and flow are, and lead to a disparity that rig and config allow.
    """
    view = frame.view(eye)
    change, disparity, flow = view.get("disparity_change"), view.get("disparity"), view.get("flow")
    if change is None or disparity is None:
        return
    name = f"disparity_change_{eye}"
    finite, infinite = np.isfinite(change), np.isposinf(change)
    verdict.add_pixels("change", name, "is NaN or -inf", ~(finite | infinite))
    known = finite & np.isfinite(disparity)
    verdict.add_pixels("change", name, "is finite without a disparity", finite & ~known)
    later = disparity.astype(np.float64) + change
    bound = flow_bound_px(np.where(finite, later, 0)[..., None], frame.rounding_px(disparity))
    least_px = -frame.camera.doffs_px if frame.encodings.signed else 0.0
    impossible = known & ((later < least_px - bound) | (later > (inf if largest_px is None else largest_px) + bound))

    def step(at: tuple[int, int]) -> str:
        return f", which goes from {disparity[at]:g} to {later[at]:g} px"

    verdict.add_pixels("change", name, "leads to an impossible disparity", impossible, step)
    if flow is None:
        return
    lost, perhaps_lost = find_lost_change(frame, eye)
    verdict.add_pixels("change", name, "is finite though a border hides the point at a frame", finite & lost)
    flows = has_flow(flow)
    beyond = _count_beyond(frame, View.flow, eye)
    if int((known & ~flows).sum()) > beyond:
        detail = f"; the provenance counts {beyond} with flow beyond the encoding"
        verdict.add_pixels("change", name, "is finite without flow", known & ~flows, detail)
    missing = np.isfinite(disparity) & flows & infinite & ~perhaps_lost
    if missing.any():
        # A disparity leaves the valid range only through 0, and only if doffs is positive or the right camera deviates.
        around = later[_neighbours(missing) & known]
        if _always_valid(frame) or (around.size and float(around.min()) > _LAST_VALID_PX):
            verdict.add_pixels("change", name, "is inf in spite of disparity and flow", missing)


def _neighbours(where: Where) -> Where:
    """Return the pixels that are neighbours, in row or column, of pixels that are True; both arrays are (H, W)."""
    beside = np.zeros_like(where)
    beside[1:] |= where[:-1]
    beside[:-1] |= where[1:]
    beside[:, 1:] |= where[:, :-1]
    beside[:, :-1] |= where[:, 1:]
    return beside
