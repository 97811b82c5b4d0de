"""Flow and change of disparity against those of the other view, and against the next frame of a sequence."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.camera import EYES, Eye
from semisynth_gl.dataset.stored import StoredFrame
from semisynth_gl.frame import OCCLUDED, VISIBLE
from semisynth_gl.verify.agreement import (
    UNCERTAIN,
    Correspondences,
    Targets,
    check_agreement,
    check_mask_agreement,
    spread_evenly,
)
from semisynth_gl.verify.photometry import check_flow_images
from semisynth_gl.verify.single_view import OPPOSITE, FlowChannel, flow_and_mask, has_flow, view_of
from semisynth_gl.verify.verdict import Verdict
from semisynth_gl.verify.view_consistency import HIDDEN_PX, SEEN_PX, SMOOTH_PX, ViewMatch, one_surface

Values = NDArray[np.float32]
Where = NDArray[np.bool_]

# Enough for shares and medians; more would only take time.
_MAX_PIXELS = 200_000


def check_flow_views(frame: StoredFrame, match: ViewMatch, visible: Where, verdict: Verdict) -> None:
    """Check the left view's flow and change of disparity against the right view's at x - d, where both see a point.

    The point at x - d moves to x + u - (d + change). So the right u is the left one less the change, and v and the
    change are the same. Backward there is no change to subtract, and v alone is judged.

    Args:
        frame: the pair as it was read.
        match: of the left view.
        visible: (H, W) bool, where both views see the point.
        verdict: takes findings and measures.
    """
    left, right = view_of(frame, "left"), view_of(frame, "right")
    smooth = visible & match.smooth
    for flow in (left.flow, left.flow_backward):
        if flow is not None:
            smooth &= _is_smooth(flow)
    row, column = np.divmod(spread_evenly(np.flatnonzero(smooth), _MAX_PIXELS), visible.shape[1])
    targets = Targets(row, column, match.position[row, column], row.astype(np.float64), on_rows=True)
    surface = one_surface(match, visible)[row, column]

    def check(check: str, measure: str, names: tuple[str, str], own: Values, other: Values, error_px: float) -> None:
        """Compare arrays (H, W, C) of the left view and of the right one."""
        pixels = targets.compare(names[0], own, f"{names[1]} at x - d", other, error_px)
        pixels = replace(pixels, one_surface=surface & pixels.one_surface)
        check_agreement(check, measure, pixels.select(pixels.known), verdict)

    for channel in OPPOSITE:
        own, other = flow_and_mask(left, channel)[0], flow_and_mask(right, channel)[0]
        if own is None or other is None:
            continue
        names = f"{channel}_left", f"{channel}_right"
        if channel == "flow" and left.disparity_change is not None:
            own = own.copy()
            with np.errstate(invalid="ignore"):
                own[..., 0] -= left.disparity_change
            names = f"{names[0]} less disparity_change_left", names[1]
        else:
            own, other = own[..., 1:], other[..., 1:]
            names = f"the v of {names[0]}", f"the v of {names[1]}"
        check("flow-views", f"{channel}_views", names, own, other, 2 * frame.flow_error_px)
    if left.disparity_change is not None and right.disparity_change is not None:
        names = "disparity_change_left", "disparity_change_right"
        changes = left.disparity_change[..., None], right.disparity_change[..., None]
        check("change", "disparity_change_views", names, *changes, 0.0)


def follow_flow(flow: Values, disparity: Values) -> Targets:
    """Follow pixels along their flow, where it stays in the image and the surface goes on to all sides.

    Of more than 200,000 pixels, as many are taken, evenly spread.

    Args:
        flow: (H, W, 2) float32 px.
        disparity: (H, W) float32 px.
    """
    height, width = disparity.shape
    followed = has_flow(flow) & _is_smooth(disparity[..., None]) & _is_smooth(flow)
    known = np.where(followed[..., None], flow, 0).astype(np.float64)
    x, y = np.arange(width) + known[..., 0], np.arange(height)[:, None] + known[..., 1]
    followed &= (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    row, column = np.divmod(spread_evenly(np.flatnonzero(followed), _MAX_PIXELS), width)
    return Targets(row, column, x[row, column], y[row, column])


def check_frames(before: StoredFrame, after: StoredFrame, verdict: Verdict, *, images: bool) -> None:
    """Check flow, its masks and changes of disparity between a frame and the next one of its sequence.

    Args:
        before: the earlier pair as it was read.
        after: the next one; of the same size.
        verdict: takes findings and measures.
        images: whether the images of both show the same textures, bit for bit but for resampling.
    """
    for eye in EYES:
        for channel in OPPOSITE:
            start, end = (before, after) if channel == "flow" else (after, before)
            _check_direction(channel, eye, start, end, verdict, images=images)


def _check_direction(
    channel: FlowChannel, eye: Eye, start: StoredFrame, end: StoredFrame, verdict: Verdict, *, images: bool
) -> None:
    own, other = view_of(start, eye), view_of(end, eye)
    flow, mask = flow_and_mask(own, channel)
    if flow is None or mask is None or own.disparity is None or other.disparity is None:
        return
    name = f"{channel}_{eye}"
    targets = follow_flow(flow, own.disparity)
    values = mask[targets.row, targets.column]
    visible = values == VISIBLE
    with np.errstate(invalid="ignore"):
        surface = np.ptp(targets.corners(other.disparity[..., None]), axis=0)[:, 0] < 1
    agrees, hidden = np.ones_like(surface), np.zeros_like(surface)
    comparisons: list[tuple[str, str, Correspondences]] = []

    flow_back = flow_and_mask(other, OPPOSITE[channel])[0]
    if flow_back is not None:
        names = f"{name} of {start.name}", f"the reverse of {OPPOSITE[channel]}_{eye} of {end.name} at x + flow"
        pixels = targets.compare(names[0], flow, names[1], -flow_back, 2 * start.flow_error_px)
        comparisons.append(("flow-frames", f"{name}_frames", pixels))
        surface &= pixels.one_surface

    # Both frames have the disparity at the later one: the earlier frame's change leads to it.
    forward = channel == "flow"
    change = (own if forward else other).disparity_change
    if change is not None:
        now, later = f"disparity_{eye}", f"disparity_{eye} plus disparity_change_{eye}"
        names = (later, now) if forward else (now, later)
        names = f"{names[0]} of {start.name}", f"{names[1]} of {end.name} at x + flow"
        disparities = own.disparity + (change if forward else 0), other.disparity + (0 if forward else change)
        error_px = start.disparity_error_px + end.disparity_error_px
        pixels = targets.compare(names[0], disparities[0][..., None], names[1], disparities[1][..., None], error_px)
        comparisons.append(("change", f"{name}_change", pixels))
        with np.errstate(invalid="ignore"):
            nearer = pixels.corners.min(axis=0) > pixels.vectors + HIDDEN_PX + error_px
        hidden = (nearer & np.isfinite(pixels.references))[:, 0]

    for check, measure, pixels in comparisons:
        with np.errstate(invalid="ignore"):
            agrees &= (np.abs(pixels.vectors - pixels.references) < SEEN_PX + pixels.error_px).all(axis=1)
        # Points nearer than the near plane, and values beyond an encoding, have no reference.
        judged = visible & pixels.known
        check_agreement(check, measure, replace(pixels, one_surface=surface).select(judged), verdict)
    if comparisons:
        # Two surfaces of similar disparity are told apart by the flow back alone.
        seen = surface & agrees & (flow_back is not None)
        expected = np.where(hidden, OCCLUDED, np.where(seen, VISIBLE, UNCERTAIN)).astype(np.uint8)
        measure = f"{channel}_visibility_{eye}"
        check_mask_agreement("flow-mask", f"{measure} of {start.name}", measure, values, expected, end.name, verdict)
    if images:
        label = f"{name} of {start.name} to {end.name}"
        check_flow_images(label, name, (own.image, other.image), targets.select(visible & surface), verdict)


def _is_smooth(values: Values) -> Where:
    """Return where a pixel and its neighbours in row and column are one surface, as (H, W, C) bends little; (H, W)."""
    smooth = np.zeros(values.shape[:2], bool)
    inner = smooth[1:-1, 1:-1]
    inner[...] = True
    for channel in np.moveaxis(values, 2, 0):
        with np.errstate(invalid="ignore"):
            inner &= np.abs(np.diff(channel[1:-1], 2, axis=1)) < SMOOTH_PX
            inner &= np.abs(np.diff(channel[:, 1:-1], 2, axis=0)) < SMOOTH_PX
    return smooth
