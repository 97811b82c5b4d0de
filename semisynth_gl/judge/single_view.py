"""Checks the channels of one view against each other, and the pair's calibration."""

from math import inf, isclose, isfinite

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.pair_files import StoredFrame
from semisynth_gl.frame.camera import Eye
from semisynth_gl.frame.channels import CHANNELS, OCCLUDED, OUTSIDE, SKY, VISIBLE
from semisynth_gl.judge.findings import CheckResults
from semisynth_gl.judge.lens import hidden_by_borders

Where = NDArray[np.bool_]

# Bounds, which docs/verify.md lists. The rounding of float32, and of the six digits of vmin and vmax in calib.txt, as
# shares of a value.
_FLOAT32_SHARE, _TEXT_SHARE = 1e-6, 1e-5
# Bounds of errors of correspondences, of disparities plus their change, and of the lengths of normals.
_VECTOR_PX, _CHANGED_PX, _UNIT_LENGTH = 1e-3, 0.01, 1e-5
# A pixel beside an edge may show a surface that its ray meets from behind. Rasterisers move vertices by up to 1/32 px
# along each axis (see rays.py); this is twice as much, an upper bound of the ray's error.
_EDGE_PX = 1 / 16
# On a surface whose disparity falls below 0, the last valid pixel has at most this disparity.
_LAST_VALID_PX = 2.0
_MASK_VALUES = {
    **dict.fromkeys(("visibility", "flow_visibility", "flow_backward_visibility"), (OUTSIDE, OCCLUDED, VISIBLE)),
    "valid": (OUTSIDE, VISIBLE),
    "sky": (0, SKY),
}


def check_view(frame: StoredFrame, eye: Eye, largest_px: float, results: CheckResults) -> None:
    """Check the arrays of a view; ``largest_px`` is the config's maximum disparity."""
    for name, array in frame.view(eye).items():
        if name in _MASK_VALUES:
            fault = f"is not one of {', '.join(map(str, _MASK_VALUES[name]))}"
            results.add_pixels(name, eye, fault, ~np.isin(array, _MASK_VALUES[name]))
        elif CHANNELS[name].fill == inf:
            values = array.reshape(*array.shape[:2], -1)
            infinite = np.isposinf(values)
            results.add_pixels(name, eye, "is NaN or -inf", (np.isnan(values) | np.isneginf(values)).any(axis=2))
            mixed = infinite != infinite[..., :1]
            results.add_pixels(name, eye, "is inf in only one component", mixed.any(axis=2))
    if "disparity" in frame.view(eye):
        _check_disparity(frame, eye, largest_px, results)
        _check_change(frame, eye, largest_px, results)
        _check_geometry(frame, eye, results)
        _check_instances(frame, eye, results)


def _check_disparity(frame: StoredFrame, eye: Eye, largest_px: float, results: CheckResults) -> None:
    """Check that a view's disparity is in its range, and that no pixel lacks one without a reason.

    A disparity d = f B / Z - doffs is at most ``largest_px``, and positive or, if signed, at least -doffs. A pixel may
    lack d in a border, beyond the encoding's range and, if unsigned, where d would be 0 or below, as in the sky.
    """
    disparity, camera = frame.view(eye)["disparity"], frame.camera
    finite, error_px = np.isfinite(disparity), frame.encodings.disparity.error_px
    if not frame.encodings.signed:
        results.add_pixels("disparity", eye, "is 0 or below", finite & (disparity <= 0))
    elif camera.rectified:
        least_px = -camera.doffs_px - _TEXT_SHARE * abs(camera.doffs_px) - error_px
        results.add_pixels("disparity", eye, "is below that of infinity", finite & (disparity < least_px))
    too_large = finite & (disparity > largest_px * (1 + _TEXT_SHARE) + error_px)
    results.add_pixels("disparity", eye, f"is above {largest_px} px", too_large)
    border = frame.cut_border(eye)
    results.add_pixels("disparity", eye, "is known in a border", finite & border)
    sky_is_valid = frame.encodings.signed or (camera.doffs_px < 0 and camera.rectified)
    sky = np.zeros_like(finite) if sky_is_valid else frame.sky(eye)
    if sky is None:
        return  # no output says where the sky is
    lacking = np.isposinf(disparity) & ~border & ~sky
    if not _check_beyond(frame, "disparity", eye, lacking, results, exact=_always_valid(frame)):
        _check_lacking(frame, "disparity", eye, lacking, disparity, results)


def _check_lacking(
    frame: StoredFrame, channel: str, eye: Eye, lacking: Where, disparity: NDArray[np.floating], results: CheckResults
) -> None:
    """Check that ``lacking`` pixels lie beside small disparities, since the disparity of their surface falls below 0.

    Not all pixels of a view may lack a value.
    """
    padded = np.pad(lacking, 1)
    beside = padded[2:, 1:-1] | padded[:-2, 1:-1] | padded[1:-1, 2:] | padded[1:-1, :-2]
    around = disparity[beside & np.isfinite(disparity)]
    allowed = around.min() <= _LAST_VALID_PX if around.size else np.isfinite(disparity).any()
    if _always_valid(frame) or not allowed:
        results.add_pixels(channel, eye, "is inf", lacking)


def _always_valid(frame: StoredFrame) -> bool:
    """Return whether all surfaces except the sky have a valid disparity, whatever their depth."""
    return frame.encodings.signed or (frame.camera.doffs_px <= 0 and frame.camera.rectified)


def _check_beyond(
    frame: StoredFrame, channel: str, eye: Eye, lacking: Where, results: CheckResults, *, exact: bool = False
) -> int:
    """Return the number of values beyond the encoding's range that the provenance records.

    Unless it is 0, at least as many pixels must be ``lacking``; with ``exact``, exactly as many.
    """
    counts = frame.provenance.get(CHANNELS[channel].beyond_key)
    limited = isfinite(frame.encodings.codec(CHANNELS[channel]).limit_px)
    count = counts.get(eye) if isinstance(counts, dict) and limited else 0
    beyond, found = count if isinstance(count, int) else 0, int(lacking.sum())
    if beyond and (found != beyond if exact else found < beyond):
        fault = f"is inf in {found} pixels, the provenance counts {beyond} beyond the encoding"
        results.add(channel, f"{channel}_{eye} {fault}")
    return beyond


def _check_geometry(frame: StoredFrame, eye: Eye, results: CheckResults) -> None:
    """Check that depth and correspondences agree with the disparity, and check normals.

    Normals must be unit vectors that face the eye, or 0 where no other channel has a surface.
    """
    view, camera = frame.view(eye), frame.camera
    disparity, rounding_px = view["disparity"], frame.rounding_px(view["disparity"])
    row, column = np.mgrid[: disparity.shape[0], : disparity.shape[1]].astype(np.float64)
    if "depth" in view:
        depth = view.depth.astype(np.float64)
        expected = camera.correspondence(eye, column, row, depth)[..., 0] * (-1 if eye == "left" else 1)
        bound = _FLOAT32_SHARE * (np.abs(expected) + 2 * abs(camera.doffs_px)) + rounding_px
        bound += 0.0 if camera.rectified else _VECTOR_PX
        encodable = (np.abs(expected) < frame.encodings.disparity.limit_px - bound) & ~frame.cut_border(eye)
        missing = np.isfinite(depth) & (depth > 0) & ((expected > bound) | frame.encodings.signed) & encodable
        wrong = np.where(np.isfinite(disparity), ~(np.abs(disparity - expected) <= bound), missing)
        results.add_pixels("depth", eye, "disagrees with the disparity", wrong)
    if "correspondence" in view:
        near = np.abs(view.correspondence - frame.correspondences(eye)) <= (_VECTOR_PX + rounding_px)[..., None]
        wrong = np.isfinite(disparity) & ~near.all(axis=2)
        results.add_pixels("correspondence", eye, "disagrees with the disparity", wrong)
    if "normals" in view:
        normals = view.normals.astype(np.float64)
        seen = np.isfinite(disparity) | np.isfinite(view.get("depth", inf)) | (view.get("instances", np.uint16(0)) > 0)
        length, zero = np.linalg.norm(normals, axis=2), (normals == 0).all(axis=2)
        wrong = ~(np.abs(length - 1) <= _UNIT_LENGTH) & (seen | ~zero)
        results.add_pixels("normals", eye, "is not a unit vector", wrong)
        edge = _EDGE_PX / min(camera.focal_px, camera.focal_y_px)
        away = (normals * camera.rays_of_eye(eye, column, row)).sum(axis=2) > _UNIT_LENGTH + edge
        results.add_pixels("normals", eye, "points away from the eye", away)


def _check_instances(frame: StoredFrame, eye: Eye, results: CheckResults) -> None:
    """Check that each id is 0, without a disparity, or the number, from 1, of a row of ``instances`` in pair.json.

    The sky's mask must agree with the instances, and the sky's depth must be inf.
    """
    view, rows, sky = frame.view(eye), frame.provenance.get("instances"), frame.sky_of_instances(eye)
    if "instances" in view:
        listed = len(rows) if isinstance(rows, list) else 0
        results.add_pixels("instances", eye, f"is above the {listed} that the pair lists", view.instances > listed)
        none = (view.instances == 0) & np.isfinite(view["disparity"])
        results.add_pixels("instances", eye, "is 0 despite a disparity", none)
    if "sky" in view and sky is not None:
        results.add_pixels("sky", eye, "disagrees with the instances", (view.sky == SKY) != sky)
    if "sky" in view and "depth" in view:
        results.add_pixels("sky", eye, "has a finite depth", (view.sky == SKY) & np.isfinite(view.depth))


def _check_change(frame: StoredFrame, eye: Eye, largest_px: float, results: CheckResults) -> None:
    """Check where a view has flow and ``disparity_change``, and that the disparity at the next frame is possible.

    ``disparity_change`` must be finite where disparity and flow are finite, and nowhere else, except in borders.
    """
    view = frame.view(eye)
    beyond = {
        channel: _check_beyond(frame, channel, eye, np.isinf(view[channel]).any(axis=2), results)
        for channel in ("flow", "flow_backward")
        if channel in view
    }
    if "disparity_change" not in view:
        return
    change, disparity = view.disparity_change, view["disparity"]
    known, later = np.isfinite(change) & np.isfinite(disparity), disparity.astype(np.float64) + change
    results.add_pixels("disparity_change", eye, "is finite without a disparity", np.isfinite(change) & ~known)
    margin_px = _CHANGED_PX + frame.encodings.disparity.error_px
    least_px = (-frame.camera.doffs_px if frame.encodings.signed else 0) - margin_px
    impossible = known & ((later < least_px) | (later > largest_px + margin_px))
    results.add_pixels("disparity_change", eye, "leads to an impossible disparity", impossible)
    if "flow" not in view:
        return
    flows = np.isfinite(view.flow).all(axis=2)
    if not beyond["flow"]:
        results.add_pixels("disparity_change", eye, "is finite without flow", known & ~flows)
    missing = np.isfinite(disparity) & flows & np.isposinf(change)
    if not frame.border_disparity:
        lost, perhaps_lost = hidden_by_borders(frame, eye, "flow", view.flow, frame.encodings.flow.error_px)
        hidden = "is finite though a border hides the point at a frame"
        results.add_pixels("disparity_change", eye, hidden, known & lost)
        missing &= ~perhaps_lost
    _check_lacking(frame, "disparity_change", eye, missing, later, results)


def check_calibration(frame: StoredFrame, results: CheckResults) -> None:
    """Compare the camera with the pair's provenance, and calib.txt, if there is one, with the left disparity."""
    recorded, camera, calibration = frame.provenance.get("camera"), frame.camera, frame.calibration
    recorded = recorded if isinstance(recorded, dict) else {}
    # Files omit fy_over_fx if it is 1. doffs is compared below, and calib.txt has no deviation.
    for key, value in ({"fy_over_fx": 1.0} | camera.values()).items():
        expected = ({"fy_over_fx": 1.0} | recorded).get(key)
        if key in ("doffs_px", "deviation"):
            continue
        # The baseline is stored in millimetres, and fy in px; the conversion may change the last digit.
        if not (isinstance(expected, int | float) and isclose(value, expected, rel_tol=1e-12, abs_tol=1e-12)):
            results.add("calib", f"{key} is {value!r}, in the pair's provenance {expected!r}")
    if calibration is None:
        return
    if not isclose(calibration.doffs_px, camera.doffs_px, rel_tol=1e-9, abs_tol=1e-9):
        results.add("calib", f"doffs is {calibration.doffs_px!r}, cx1 - cx0 is {camera.doffs_px!r}")
    valid = frame.left.disparity[np.isfinite(frame.left.disparity)]
    if not valid.size:
        return
    least, largest = float(valid.min()), float(valid.max())
    for name, written, stored in (("vmin", calibration.vmin_px, least), ("vmax", calibration.vmax_px, largest)):
        if abs(written - stored) > float(frame.rounding_px(stored)) + _TEXT_SHARE * max(1.0, abs(stored)):
            results.add("calib", f"{name} is {written:g}, the left disparity's is {stored:g} px")
    if calibration.ndisp < largest * (1 - _TEXT_SHARE) - frame.encodings.disparity.error_px:
        results.add("calib", f"ndisp {calibration.ndisp} is below the largest disparity, {largest:g} px")
