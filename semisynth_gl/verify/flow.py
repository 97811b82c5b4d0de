"""Flow and change of disparity within one pair: their values, their masks, and the left view's against the right's."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.stored import StoredFrame
from semisynth_gl.frame import OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.verify.compared import Compared, check_compared
from semisynth_gl.verify.consistency import Match, one_surface
from semisynth_gl.verify.disparity import LAST_VALID_PX, beside, beyond, count_of, first_of
from semisynth_gl.verify.finding import Verdict
from semisynth_gl.verify.landing import both, has_flow, is_smooth, spread

Floats = NDArray[np.floating]
Where = NDArray[np.bool_]
FlowKind = Literal["flow", "flow_backward"]

OPPOSITE: dict[FlowKind, FlowKind] = {"flow": "flow_backward", "flow_backward": "flow"}
"""The arrays of flow, without the view, each with that of the other direction."""

# Bounds; docs/verify.md derives them.
_ERROR_PX = 1e-3
_ERROR_SHARE = 1e-5


def flow_of(frame: StoredFrame, kind: FlowKind, view: str) -> NDArray[np.float32] | None:
    """Return the (H, W, 2) flow of a view in one direction, px; None where the pair has none."""
    flow: NDArray[np.float32] | None = getattr(frame, f"{kind}_{view}")
    return flow


def mask_of(frame: StoredFrame, kind: FlowKind, view: str) -> NDArray[np.uint8] | None:
    """Return its mask, (H, W)."""
    mask: NDArray[np.uint8] | None = getattr(frame, f"{kind}_visibility_{view}")
    return mask


def flow_bound_px(flow: Floats, encoding_px: float = 0.0) -> NDArray[np.float64]:
    """Return the most that the renderer and the encoding put a component of flow, or a change of disparity, off by.

    Args:
        flow: (..., C) px, finite.
        encoding_px: the encoding's part.

    Returns:
        (...) px.
    """
    length: NDArray[np.float64] = np.sqrt(sum(flow[..., k].astype(np.float64) ** 2 for k in range(flow.shape[-1])))
    return _ERROR_PX + _ERROR_SHARE * length + encoding_px


def check_flow(frame: StoredFrame, kind: FlowKind, view: str, verdict: Verdict) -> None:
    """Check a view's flow in one direction: numbers, both of a pixel or none, and its mask where that follows from it.

    A mask is 0 just where there is no flow, or it leads out of the image.
    """
    flow, mask, name = flow_of(frame, kind, view), mask_of(frame, kind, view), f"{kind}_{view}"
    if flow is None:
        return
    none = np.isposinf(flow)
    broken = ~both(np.isfinite(flow) | none)
    if broken.any():
        verdict.add("flow", f"{name}: {count_of(broken)} NaN or -inf, the first at {first_of(broken)}")
    half = none[..., 0] != none[..., 1]
    if half.any():
        verdict.add("flow", f"{name}: {count_of(half)} with one component inf, the first at {first_of(half)}")
    there = has_flow(flow)
    lost = beyond(frame, f"{kind}_beyond", view, frame.flow_largest_px)
    lacking = int((~there).sum())
    if lacking < lost:
        verdict.add("flow", f"{name}: {lacking} pixels without flow, the provenance counts {lost} beyond the encoding")
    verdict.measures[f"{name}_none_share"] = lacking / there.size
    if mask is not None:
        _check_outside(f"{kind}_visibility_{view}", flow, there, mask, frame.flow_error_px, verdict)


def _check_outside(
    name: str, flow: NDArray[np.float32], there: Where, mask: NDArray[np.uint8], encoding_px: float, verdict: Verdict
) -> None:
    values = np.unique(mask)
    strange = values[~np.isin(values, (OUTSIDE, OCCLUDED, VISIBLE))]
    if strange.size:
        verdict.add("flow-mask", f"{name}: expected the values 0, 128 and 255, got {', '.join(map(str, strange[:5]))}")
    none = ~there & (mask != OUTSIDE)
    if none.any():
        verdict.add("flow-mask", f"{name}: {count_of(none)} without flow not 0, the first at {first_of(none)}")
    height, width = mask.shape
    known = np.where(there[..., None], flow, 0)
    x = np.arange(width) + known[..., 0].astype(np.float64)
    y = np.arange(height)[:, None] + known[..., 1].astype(np.float64)
    # How far the point is inside the image; its border lies half a pixel beyond the last centres.
    inside = np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y)) + 0.5
    margin = flow_bound_px(known, encoding_px)
    for wrong, wanted in (
        (there & (inside > margin) & (mask == OUTSIDE), "leads into the image, where 128 or 255 was expected"),
        (there & (inside < -margin) & (mask != OUTSIDE), "leads out of the image, where 0 was expected"),
    ):
        if wrong.any():
            row, column = np.argwhere(wrong)[0]
            verdict.add(
                "flow-mask",
                f"{name}: {count_of(wrong)} wrong: flow {wanted}; the first, at ({column}, {row}), has "
                f"{mask[row, column]} and goes to ({x[row, column]:.6g}, {y[row, column]:.6g})",
            )


def check_change(frame: StoredFrame, view: str, most: float | None, verdict: Verdict) -> None:
    """Check a view's change of disparity: finite just where disparity and flow are, and what it leads to is possible.

    Args:
        frame: the pair as it was read.
        view: "left" or "right".
        most: the largest disparity that the config allows, px, or None.
        verdict: takes findings and measures.
    """
    change, disparity = getattr(frame, f"disparity_change_{view}"), getattr(frame, f"disparity_{view}")
    if change is None or disparity is None:
        return
    name, flow = f"disparity_change_{view}", flow_of(frame, "flow", view)
    there, none = np.isfinite(change), np.isposinf(change)
    broken = ~(there | none)
    if broken.any():
        verdict.add("change", f"{name}: {count_of(broken)} NaN or -inf, the first at {first_of(broken)}")
    foreign = there & ~np.isfinite(disparity)
    if foreign.any():
        verdict.add(
            "change", f"{name}: {count_of(foreign)} without disparity not inf, the first at {first_of(foreign)}"
        )
    with np.errstate(invalid="ignore"):
        then = disparity.astype(np.float64) + change
    bound = _ERROR_PX + _ERROR_SHARE * np.abs(np.where(there, then, 0)) + frame.rounding_px(disparity)
    impossible = there & ~foreign & (then < -bound)
    if most is not None:
        impossible |= there & ~foreign & (then > most + bound)
    if impossible.any():
        row, column = np.argwhere(impossible)[0]
        verdict.add(
            "change",
            f"{name}: {count_of(impossible)} leading to no possible disparity, at ({column}, {row}) from "
            f"{disparity[row, column]:g} to {then[row, column]:g} px",
        )
    if flow is not None:
        _check_where(frame, view, then, has_flow(flow), verdict)


def _check_where(frame: StoredFrame, view: str, then: NDArray[np.float64], flows: Where, verdict: Verdict) -> None:
    """Check that a view's disparity changes, to ``then`` (H, W), just where it has flow, ``flows`` (H, W)."""
    name, disparity = f"disparity_change_{view}", getattr(frame, f"disparity_{view}")
    there = np.isfinite(then)
    lost = beyond(frame, "flow_beyond", view, frame.flow_largest_px)
    without_flow = there & ~flows
    if int(without_flow.sum()) > lost:
        verdict.add(
            "change",
            f"{name}: {count_of(without_flow)} without flow not inf, the first at {first_of(without_flow)}; the "
            f"provenance counts {lost} whose flow is beyond the encoding",
        )
    missing = np.isfinite(disparity) & flows & np.isposinf(then)
    if not missing.any():
        return
    # A disparity that leaves the valid range passes through 0, which it can where doffs is positive.
    around = then[beside(missing) & there]
    if frame.camera.doffs_px <= 0 or (around.size and float(around.min()) > LAST_VALID_PX):
        verdict.add(
            "change", f"{name}: {count_of(missing)} inf that have disparity and flow, the first at {first_of(missing)}"
        )


def check_views(frame: StoredFrame, match: Match, visible: Where, verdict: Verdict) -> None:
    """Check the left view's flow and change of disparity against the right one's at x - d, where both see a point.

    The point at x - d then is at x + u - (d + change): so the right u is the left one less the change, and v and the
    change are the same. Backward there is no change to take off, and v alone is judged.

    Args:
        frame: the pair as it was read.
        match: of the left view.
        visible: (H, W) bool, the pixels to judge.
        verdict: takes findings and measures.
    """
    smooth = visible & match.smooth
    for left in (frame.flow_left, frame.flow_backward_left):
        if left is not None:
            smooth &= is_smooth(left)
    pixels = np.flatnonzero(smooth)
    row, column = np.divmod(spread(pixels), visible.shape[1])
    first = np.floor(match.position[row, column]).astype(np.int64)
    second = np.minimum(first + 1, visible.shape[1] - 1)
    fraction = (match.position[row, column] - first)[:, None]
    flat = one_surface(match, visible)[row, column]

    def check(check: str, measure: str, names: tuple[str, str], left: Floats, right: Floats, error_px: float) -> None:
        """Compare what has (H, W, C) of the left view and of the right one."""
        own, corners = left[row, column], np.stack([right[row, first], right[row, second]])
        with np.errstate(invalid="ignore"):
            between = corners[0] * (1 - fraction) + corners[1] * fraction
            alike = (np.abs(corners[1] - corners[0]) < 1).all(axis=1)
        compared = Compared(
            name=names[0],
            other=f"{names[1]} at x - d",
            own=own,
            corners=corners,
            between=between,
            flat=flat & alike,
            error_px=error_px,
            place=np.stack([column, row], axis=1),
        )
        check_compared(check, measure, compared.only(compared.known), verdict)

    change, error_px = frame.disparity_change_left, 2 * frame.flow_error_px
    for kind in OPPOSITE:
        left, right = flow_of(frame, kind, "left"), flow_of(frame, kind, "right")
        if left is None or right is None:
            continue
        names = f"{kind}_left", f"{kind}_right"
        if kind == "flow" and change is not None:
            with np.errstate(invalid="ignore"):
                less = left - np.stack([change, np.zeros_like(change)], axis=2)
            names = f"{names[0]} less disparity_change_left", names[1]
            check("flow-views", f"{kind}_views", names, less, right, error_px)
        else:
            names = f"the v of {names[0]}", f"that of {names[1]}"
            check("flow-views", f"{kind}_views", names, left[..., 1:], right[..., 1:], error_px)
    if change is not None and frame.disparity_change_right is not None:
        names = "disparity_change_left", "disparity_change_right"
        right_change = frame.disparity_change_right
        check("change", "disparity_change_views", names, change[..., None], right_change[..., None], 0.0)
