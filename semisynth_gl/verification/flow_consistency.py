"""Flow and change of disparity compared with the other view, and with the next frame of a sequence."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.frame.channels import OCCLUDED, VISIBLE
from semisynth_gl.verification.agreement import (
    UNCERTAIN,
    Agreement,
    Points,
    check_mask_agreement,
    ends,
    spread_evenly,
)
from semisynth_gl.verification.lens import find_flow_borders
from semisynth_gl.verification.photometry import check_flow_images
from semisynth_gl.verification.single_view import OPPOSITE, has_flow
from semisynth_gl.verification.verdict import Verdict
from semisynth_gl.verification.view_consistency import HIDDEN_PX, SMOOTH_PX, ViewMatch

Values = NDArray[np.float32]
Where = NDArray[np.bool_]

# Enough pixels for shares and medians; more would only take longer.
_MAX_PIXELS = 200_000


def check_flow_views(frame: StoredFrame, match: ViewMatch, visible: Where, surface: Where, verdict: Verdict) -> None:
    """Compare the left view's flow and change of disparity with the right view's at x - d, where both see a point.

    The point at x - d moves to x + u - (d + change). So the right u is the left u less the change, and v and the change
    are the same in both views. Backward flow has no change of disparity to subtract, so only v is judged.

    Args:
        frame: the pair.
        match: the left view's match with the right view.
        visible: (H, W) bool, pixels of the left view that both views see; see `visible_pixels`.
        surface: (H, W) bool; see `one_surface`.
        verdict: gets the findings and measures.
    """
    left, right = frame.view("left"), frame.view("right")
    smooth = visible & match.smooth
    for channel in OPPOSITE.keys() & left.keys():
        smooth &= _is_smooth(left[channel])
    row, column = np.divmod(spread_evenly(np.flatnonzero(smooth), _MAX_PIXELS), visible.shape[1])
    targets, surface = match.points(row, column), surface[row, column]

    def check(check: str, measure: str, names: tuple[str, str], own: Values, other: Values, error_px: float) -> None:
        """Compare arrays (H, W, C) of the left and of the right view."""
        agreement = Agreement((names[0], f"{names[1]} at x - d"), own, targets.corners(other), targets, error_px)
        agreement.check(check, measure, agreement.known, surface & agreement.close, verdict)

    change = left.get("disparity_change")
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
    right_change = right.get("disparity_change")
    if change is not None and right_change is not None:
        names = "disparity_change_left", "disparity_change_right"
        check("change", "disparity_change_views", names, change[..., None], right_change[..., None], 0.0)


def follow_flow(flow: Values, disparity: Values) -> Points:
    """Return pixels, and the points to which their flow (H, W, 2) px leads.

    A pixel is taken where its point lies in the image, and its neighbours are on the same surface, by their disparity
    (H, W) px and their flow. At most 200,000 pixels are taken, evenly spread.
    """
    height, width = disparity.shape
    followed = has_flow(flow) & _is_smooth(disparity[..., None]) & _is_smooth(flow)
    x, y = ends(np.where(followed[..., None], flow, 0))
    followed &= (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    row, column = np.divmod(spread_evenly(np.flatnonzero(followed), _MAX_PIXELS), width)
    return Points(row, column, x[row, column], y[row, column])


def check_frames(before: StoredFrame, after: StoredFrame, verdict: Verdict, *, images: bool) -> None:
    """Check flow, its masks and changes of disparity between a frame and the next frame of its sequence.

    Both frames must have the same size. ``images`` says whether both images show the same textures, apart from
    resampling, so that they can be compared too.
    """
    for eye in EYES:
        for channel in OPPOSITE:
            start, end = (before, after) if channel == "flow" else (after, before)
            _check_direction(channel, eye, start, end, verdict, images=images)


def _check_direction(
    channel: str, eye: Eye, start: StoredFrame, end: StoredFrame, verdict: Verdict, *, images: bool
) -> None:
    own, other = start.view(eye), end.view(eye)
    if not own.keys() >= {channel, f"{channel}_visibility", "disparity"} or "disparity" not in other:
        return
    flow, disparity, other_disparity = own[channel], own["disparity"], other["disparity"]
    name = f"{channel}_{eye}"
    targets = follow_flow(flow, disparity)
    values = own[f"{channel}_visibility"][targets.row, targets.column]
    visible = values == VISIBLE
    corners = targets.corners(other_disparity[..., None])
    surface = np.ptp(corners, axis=0)[:, 0] < 1
    agrees, hidden = np.ones_like(surface), np.zeros_like(surface)
    agreements: list[tuple[str, str, Agreement]] = []

    flow_back = other.get(OPPOSITE[channel])
    if flow_back is not None:
        names = f"{name} of {start.name}", f"the reverse of {OPPOSITE[channel]}_{eye} of {end.name} at x + flow"
        agreement = Agreement(names, flow, -targets.corners(flow_back), targets, 2 * start.encodings.flow.error_px)
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
            corners = corners + targets.corners(change[..., None])
        error_px = start.encodings.disparity.error_px + end.encodings.disparity.error_px
        agreement = Agreement(names, disparity[..., None], corners, targets, error_px)
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
        _, border = find_flow_borders(start, eye, channel)
        expected[border[targets.row, targets.column]] = UNCERTAIN
        measure = f"{channel}_visibility_{eye}"
        check_mask_agreement("flow-mask", f"{measure} of {start.name}", measure, values, expected, end.name, verdict)
    if images:
        label = f"{name} of {start.name} to {end.name}"
        images_of_both = own["image"], other["image"]
        check_flow_images("flow-images", label, name, images_of_both, targets.select(visible & surface), verdict)


def _is_smooth(values: Values) -> Where:
    """Return where a pixel and its neighbours in row and column are one surface, (H, W) bool.

    There, the second differences of the values (H, W, C) px are small.
    """
    smooth = np.zeros(values.shape[:2], bool)
    inner = smooth[1:-1, 1:-1]
    inner[...] = True
    for channel in np.moveaxis(values, 2, 0):
        inner &= np.abs(np.diff(channel[1:-1], 2, axis=1)) < SMOOTH_PX
        inner &= np.abs(np.diff(channel[:, 1:-1], 2, axis=0)) < SMOOTH_PX
    return smooth
