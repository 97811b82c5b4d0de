"""Flow between two successive frames: against the way back, and against what the other frame shows."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.stored import StoredFrame
from semisynth_gl.frame import OCCLUDED, VISIBLE
from semisynth_gl.verify.compared import Compared, check_compared
from semisynth_gl.verify.consistency import HIDDEN_PX, SEEN_PX, judge_mask
from semisynth_gl.verify.disparity import VIEWS
from semisynth_gl.verify.finding import Verdict
from semisynth_gl.verify.flow import OPPOSITE, FlowKind, flow_of, mask_of
from semisynth_gl.verify.landing import Landing, land
from semisynth_gl.verify.warp import check_warped

Values = NDArray[np.float32]


def check_frames(before: StoredFrame, after: StoredFrame, verdict: Verdict, *, images: bool) -> None:
    """Check flow, its masks and changes of disparity between a frame and the next one of its sequence.

    Args:
        before: the pair as it was read.
        after: the next one; of the same size.
        verdict: takes findings and measures.
        images: whether the images of both show the same textures, bit for bit but for resampling.
    """
    for view in VIEWS:
        for kind in OPPOSITE:
            start, end = (before, after) if kind == "flow" else (after, before)
            _check_direction(kind, view, start, end, verdict, images=images)


def _check_direction(
    kind: FlowKind, view: str, start: StoredFrame, end: StoredFrame, verdict: Verdict, *, images: bool
) -> None:
    flow, mask = flow_of(start, kind, view), mask_of(start, kind, view)
    disparity, other_disparity = getattr(start, f"disparity_{view}"), getattr(end, f"disparity_{view}")
    if flow is None or mask is None or disparity is None or other_disparity is None:
        return
    landing = land(flow, disparity)
    marked = mask[landing.row, landing.column]
    with np.errstate(invalid="ignore"):
        flat = np.ptp(landing.corners(other_disparity[..., None]), axis=0)[:, 0] < 1
    agrees, hidden = np.ones_like(flat), np.zeros_like(flat)
    comparisons: list[tuple[str, str, Compared]] = []

    back = flow_of(end, OPPOSITE[kind], view)
    if back is not None:
        names = f"{kind}_{view} of {start.name}", f"{OPPOSITE[kind]}_{view} of {end.name}, turned round"
        compared = _compared(names, landing, flow, -back, 2 * start.flow_error_px)
        comparisons.append(("flow-frames", f"{kind}_{view}_frames", compared))
        flat &= compared.flat

    # What the disparity of a point is at the later frame can be told from both: the change leads from the first to it.
    own, there = _later_disparity(start, view, kind == "flow"), _later_disparity(end, view, kind != "flow")
    if own is not None and there is not None:
        error_px = start.disparity_error_px + end.disparity_error_px
        compared = _compared((own[0], there[0]), landing, own[1], there[1], error_px)
        comparisons.append(("change", f"{kind}_{view}_change", compared))
        with np.errstate(invalid="ignore"):
            nearer = compared.corners.min(axis=0) > compared.own + HIDDEN_PX + error_px
        hidden = (nearer & np.isfinite(compared.between))[:, 0]

    visible = marked == VISIBLE
    for check, measure, compared in comparisons:
        with np.errstate(invalid="ignore"):
            agrees &= (np.abs(compared.own - compared.between) < SEEN_PX + compared.error_px).all(axis=1)
        # Nothing is said of points that are nearer than the near plane, or that an encoding cannot say.
        judged = visible & compared.known
        check_compared(check, measure, replace(compared, flat=flat).only(judged), verdict)
    if comparisons:
        expected = np.where(hidden, OCCLUDED, VISIBLE).astype(np.uint8)
        judge_mask(
            "flow-mask",
            (f"{kind}_visibility_{view} of {start.name}", f"{kind}_visibility_{view}"),
            marked,
            expected,
            # Surfaces of like disparity are not told apart without the way back.
            hidden | (flat & agrees & (back is not None)),
            end.name,
            verdict,
        )
    if images:
        pictures = getattr(start, view), getattr(end, view)
        name = f"{kind}_{view} of {start.name}, {end.name} warped"
        check_warped(name, f"{kind}_{view}", pictures, landing.only(np.flatnonzero(visible & flat)), verdict)


def _compared(names: tuple[str, str], landing: Landing, own: Values, there: Values, error_px: float) -> Compared:
    """Compare what one frame says of its pixels with what the other one says where they come to, both (H, W, C)."""
    corners = landing.corners(there)
    with np.errstate(invalid="ignore"):
        flat = (np.ptp(corners, axis=0) < 1).all(axis=1)
    return Compared(
        name=names[0],
        other=f"{names[1]} at x + flow",
        own=landing.own(own),
        corners=corners,
        between=landing.between(corners),
        flat=flat,
        error_px=error_px,
        place=np.stack([landing.column, landing.row], axis=1),
    )


def _later_disparity(frame: StoredFrame, view: str, is_first: bool) -> tuple[str, Values] | None:  # noqa: FBT001
    """Return what one of two frames says of disparities at the later one, (H, W, 1) px, and its name; None if nothing.

    ``is_first`` says which of the two it is.
    """
    disparity, change = getattr(frame, f"disparity_{view}"), getattr(frame, f"disparity_change_{view}")
    if not is_first:
        return f"disparity_{view} of {frame.name}", disparity[..., None]
    if change is None:
        return None
    return f"disparity_{view} and its change of {frame.name}", (disparity + change)[..., None]
