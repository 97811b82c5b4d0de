"""Flow and change of disparity: of one view by itself, against the other view, and against the next frame."""

from collections.abc import Mapping
from math import inf

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.frame.channels import CHANNELS, OCCLUDED, OUTSIDE, VISIBLE, View
from semisynth_gl.judge.agreement import (
    UNCERTAIN,
    Agreement,
    Points,
    all_components,
    check_mask_agreement,
    check_mask_values,
    dot,
    ends,
    follow,
    inside_px,
    is_smooth,
)
from semisynth_gl.judge.findings import Verdict
from semisynth_gl.judge.images import check_images
from semisynth_gl.judge.lens import find_flow_borders, find_lost_change
from semisynth_gl.judge.single_view import LAST_VALID_PX, always_valid, count_beyond, neighbours

Values = NDArray[np.float32]
Where = NDArray[np.bool_]

OPPOSITE: Mapping[str, str] = {"flow": "flow_backward", "flow_backward": "flow"}
"""The two channels of flow, each with the channel of the opposite direction."""
HIDDEN_PX = 0.25
"""A point is hidden where all pixels around it have a disparity that is larger by more than this, px."""
# Bounds of flow; docs/verify.md has them.
_FLOW_PX = 1e-3
_FLOW_SHARE = 1e-5


def has_flow(flow: NDArray[np.float32]) -> Where:
    """Return where both components of flow (H, W, 2) are finite, (H, W) bool."""
    return all_components(np.isfinite(flow))


def flow_bound_px(flow: NDArray[np.floating], encoding_px: float | NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the largest error (...) px of finite flow or changes of disparity (..., C) px.

    It is the sum of the renderer's error and the encoding's, ``encoding_px``, which is one number or (...).
    """
    return _FLOW_PX + _FLOW_SHARE * np.sqrt(dot(flow, flow)) + encoding_px


def check_flow(frame: StoredFrame, eye: Eye, verdict: Verdict) -> None:
    """Check a view's flow in both directions by itself."""
    for channel in OPPOSITE:
        _check_direction(frame, channel, eye, verdict)


def _check_direction(frame: StoredFrame, channel: str, eye: Eye, verdict: Verdict) -> None:
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
    beyond = count_beyond(frame, CHANNELS[channel], eye)
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
    within, margin = inside_px(flow), flow_bound_px(flow, encoding_px)

    def goal(at: tuple[int, int]) -> str:
        return f", which has {mask[at]} and goes to ({x[at]:.6g}, {y[at]:.6g})"

    wrong = known & (within > margin) & (mask == OUTSIDE)
    verdict.add_pixels("flow-mask", name, "is 0 for flow into the image", wrong, goal)
    wrong = known & (within < -margin) & (mask != OUTSIDE)
    verdict.add_pixels("flow-mask", name, "is neither 0 nor 128 for flow out of the image", wrong, goal)


def check_change(frame: StoredFrame, eye: Eye, verdict: Verdict, *, largest_px: float | None) -> None:
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
    most_px = inf if largest_px is None else largest_px
    impossible = known & ((later < least_px - bound) | (later > most_px + bound))

    def step(at: tuple[int, int]) -> str:
        return f", which goes from {disparity[at]:g} to {later[at]:g} px"

    verdict.add_pixels("change", name, "leads to an impossible disparity", impossible, step)
    if flow is None:
        return
    lost, perhaps_lost = find_lost_change(frame, eye)
    verdict.add_pixels("change", name, "is finite though a border hides the point at a frame", finite & lost)
    flows = has_flow(flow)
    beyond = count_beyond(frame, View.flow, eye)
    if int((known & ~flows).sum()) > beyond:
        detail = f"; the provenance counts {beyond} with flow beyond the encoding"
        verdict.add_pixels("change", name, "is finite without flow", known & ~flows, detail)
    missing = np.isfinite(disparity) & flows & infinite & ~perhaps_lost
    if missing.any():
        # A disparity leaves the valid range only through 0, and only if doffs is positive or the right camera deviates.
        around = later[neighbours(missing) & known]
        if always_valid(frame) or (around.size and float(around.min()) > LAST_VALID_PX):
            verdict.add_pixels("change", name, "is inf in spite of disparity and flow", missing)


def check_flow_views(frame: StoredFrame, points: Points, visible: Where, surface: Where, verdict: Verdict) -> None:
    """Compare the left view's flow and change of disparity with the right view's at x - d, where both see a point.

    The point at x - d moves to x + u - (d + change). So the right u is the left u less the change, and v and the change
    are the same in both views. Backward flow has no change of disparity to subtract, so only v is judged.

    Args:
        frame: the pair, rectified.
        points: N pixels of the left view, and their points in the right view.
        visible: (N,) bool, where both views see the point.
        surface: (N,) bool, where pixel and point lie on one surface.
        verdict: gets the findings and measures.
    """
    left, right = frame.view("left"), frame.view("right")
    for channel in OPPOSITE.keys() & left.keys():
        visible = visible & points.of(is_smooth(left[channel]))

    def check(check: str, measure: str, names: tuple[str, str], own: Values, other: Values, error_px: float) -> None:
        """Compare arrays (H, W, C) of the left and of the right view."""
        agreement = Agreement((names[0], f"{names[1]} at x - d"), own, points.corners(other), points, error_px)
        known = visible & agreement.known
        agreement.check(check, measure, known, surface & agreement.close, verdict)

    change, right_change = left.get("disparity_change"), right.get("disparity_change")
    for channel in OPPOSITE:
        own, other = left.get(channel), right.get(channel)
        if own is None or other is None:
            continue
        names = f"{channel}_left", f"{channel}_right"
        if channel == "flow" and change is not None:
            own = own.copy()
            own[..., 0] -= change
            names = f"{names[0]} less disparity_change_left", names[1]
        else:
            own, other = own[..., 1:], other[..., 1:]
            names = f"the v of {names[0]}", f"the v of {names[1]}"
        check("flow-views", f"{channel}_views", names, own, other, 2 * frame.encodings.flow.error_px)
    if change is not None and right_change is not None:
        names = "disparity_change_left", "disparity_change_right"
        check("change", "disparity_change_views", names, change[..., None], right_change[..., None], 0.0)


def check_frames(before: StoredFrame, after: StoredFrame, verdict: Verdict, *, images: bool) -> None:
    """Check flow, its masks and changes of disparity between a frame and the next frame of its sequence.

    Both frames must have the same size. ``images`` says whether both images show the same textures, apart from
    resampling, so that they can be compared too.
    """
    for eye in EYES:
        for channel in OPPOSITE:
            start, end = (before, after) if channel == "flow" else (after, before)
            _check_frames_one_way(channel, eye, start, end, verdict, images=images)


def _check_frames_one_way(
    channel: str, eye: Eye, start: StoredFrame, end: StoredFrame, verdict: Verdict, *, images: bool
) -> None:
    own, other = start.view(eye), end.view(eye)
    if not own.keys() >= {channel, f"{channel}_visibility", "disparity"} or "disparity" not in other:
        return
    flow, disparity, name = own[channel], own["disparity"], f"{channel}_{eye}"
    points = follow(flow, disparity[..., None])
    values = points.of(own[f"{channel}_visibility"])
    visible = values == VISIBLE
    corners = points.corners(other["disparity"][..., None])
    surface = np.ptp(corners, axis=0)[:, 0] < 1
    agrees, hidden = np.ones_like(surface), np.zeros_like(surface)
    agreements: list[tuple[str, str, Agreement]] = []

    flow_back = other.get(OPPOSITE[channel])
    if flow_back is not None:
        names = f"{name} of {start.name}", f"the reverse of {OPPOSITE[channel]}_{eye} of {end.name} at x + flow"
        agreement = Agreement(names, flow, -points.corners(flow_back), points, 2 * start.encodings.flow.error_px)
        agreements.append(("flow-frames", f"{name}_frames", agreement))
        surface &= agreement.close

    # Compare the disparities at the later time, to which the earlier frame's change leads.
    forward = channel == "flow"
    change = (own if forward else other).get("disparity_change")
    if change is not None:
        now, later = f"disparity_{eye}", f"disparity_{eye} plus disparity_change_{eye}"
        names = (later, now) if forward else (now, later)
        names = f"{names[0]} of {start.name}", f"{names[1]} of {end.name} at x + flow"
        if forward:
            disparity = disparity + change
        else:
            corners = corners + points.corners(change[..., None])
        error_px = start.encodings.disparity.error_px + end.encodings.disparity.error_px
        agreement = Agreement(names, disparity[..., None], corners, points, error_px)
        agreements.append(("change", f"{name}_change", agreement))
        nearer = corners.min(axis=0) > agreement.vectors + HIDDEN_PX + error_px
        hidden = (nearer & np.isfinite(agreement.references))[:, 0]

    for check, measure, agreement in agreements:
        agrees &= agreement.agree
        # A point that moves in front of the near plane, or a value beyond the encoding, has no reference.
        agreement.check(check, measure, visible & agreement.known, surface, verdict)
    if agreements:
        # Only the flow back tells two surfaces of similar disparity apart.
        seen = surface & agrees & (flow_back is not None)
        expected = np.where(hidden, OCCLUDED, np.where(seen, VISIBLE, UNCERTAIN)).astype(np.uint8)
        # Each single pixel of a border is judged with its own view.
        expected[points.of(find_flow_borders(start, eye, channel)[1])] = UNCERTAIN
        label = f"{channel}_visibility_{eye} of {start.name}"
        check_mask_agreement("flow-mask", label, values, expected, end.name, verdict)
    if images:
        label = f"{name} of {start.name} to {end.name}"
        both = own["image"], other["image"]
        check_images("flow-images", label, f"{name}_", both, points.select(visible & surface), verdict)
