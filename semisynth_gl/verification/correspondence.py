"""Correspondences against disparities and the camera; and both views against each other, where rows are not shared."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame.camera import EYES, OTHER_EYE, Eye
from semisynth_gl.frame.frame import OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.verification.agreement import (
    UNCERTAIN,
    Agreement,
    Points,
    all_components,
    check_mask_agreement,
    check_mask_values,
)
from semisynth_gl.verification.flow_consistency import follow_flow
from semisynth_gl.verification.photometry import check_flow_images
from semisynth_gl.verification.single_view import DEVIATING_PX
from semisynth_gl.verification.verdict import Verdict, count_pixels
from semisynth_gl.verification.view_consistency import HIDDEN_PX, SEEN_PX

Values = NDArray[np.float64]
Where = NDArray[np.bool_]

# Points may lie on either side of the image's border by this.
_BORDER_PX = 2e-3


def check_correspondence(frame: StoredFrame, eye: Eye, verdict: Verdict) -> None:
    """Check a view's correspondences: where they are, against disparities, and against the camera.

    Args:
        frame: the pair as it was read.
        eye: the view.
        verdict: takes findings and measures.
    """
    view, name = frame.view(eye), f"correspondence_{eye}"
    way, disparity = view.get("correspondence"), view.get("disparity")
    if way is None or disparity is None:
        return
    known = all_components(np.isfinite(way))
    verdict.add_pixels("correspondence", name, "is neither finite nor inf", ~known & ~all_components(np.isposinf(way)))
    verdict.add_pixels("correspondence", name, "is inf in spite of a disparity", np.isfinite(disparity) & ~known)
    both = known & np.isfinite(disparity)
    along = np.where(both, way[..., 0] * (-1 if eye == "left" else 1), 0)
    off = both & (np.abs(along - np.where(both, disparity, 0)) > frame.rounding_px(disparity))
    verdict.add_pixels("correspondence", name, "is not the disparity along the row", off)
    expected = frame.ways(eye)
    error = np.abs(np.where(both[..., None], way - expected, 0))[..., 1]
    # A disparity that was rounded says a little less about the depth.
    wrong = ~(error <= DEVIATING_PX + frame.rounding_px(disparity))
    verdict.measures[f"{name}_largest_y_px"] = float(error[~wrong].max(initial=0.0))
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        detail = f", which goes {way[row, column, 1]:g} px down, and by the camera {expected[row, column, 1]:g} px"
        verdict.add_pixels("correspondence", name, "does not go down as the camera says", wrong, detail)


def check_deviating_views(frame: StoredFrame, verdict: Verdict, *, imperfect: bool) -> None:
    """Check both views of a pair against each other where the right camera deviates.

    Args:
        frame: the pair as it was read, with both disparities.
        verdict: takes findings and measures.
        imperfect: see `check_images`.
    """
    ways = {eye: frame.ways(eye) for eye in EYES}
    for eye in EYES:
        other = OTHER_EYE[eye]
        targets = follow_flow(ways[eye].astype(np.float32), frame.view(eye)["disparity"])
        names = f"the way from the {eye} view", f"the reverse of that from the {other} view at its end"
        error_px = 2 * frame.encodings.disparity.error_px
        agreement = Agreement(names, ways[eye], -targets.corners(ways[other]), targets, error_px)
        seen, hidden = _judged(frame, eye, targets, agreement)
        mask = frame.view(eye).get("visibility")
        if mask is not None:
            _check_mask(eye, mask, ways[eye], targets, (seen, hidden), verdict)
        visible = seen if mask is None else mask[targets.row, targets.column] == VISIBLE
        surface = agreement.close
        agreement.check("left-right", f"left_right_{eye}", visible & agreement.known, surface, verdict)
        if eye == "left":
            images, judged = (frame.left["image"], frame.right["image"]), targets.select(visible & surface)
            name = "the way from the left view"
            check_flow_images("images", name, "images", images, judged, verdict, imperfect=imperfect)


def _judged(frame: StoredFrame, eye: Eye, targets: Points, agreement: Agreement) -> tuple[Where, Where]:
    """Return which of the points are surely seen from the other eye, and which surely hidden there, (N,) bool each."""
    corners = targets.corners(frame.view(OTHER_EYE[eye])["disparity"][..., None])[..., 0]
    disparity = frame.view(eye)["disparity"][targets.row, targets.column]
    with np.errstate(invalid="ignore"):
        hidden = np.isfinite(corners).all(axis=0) & (corners.min(axis=0) > disparity + HIDDEN_PX + agreement.error_px)
        difference = np.abs(agreement.vectors - agreement.references)
    return agreement.close & all_components(difference < SEEN_PX + agreement.error_px), hidden


def _check_mask(
    eye: Eye, mask: NDArray[np.uint8], way: Values, targets: Points, judged: tuple[Where, Where], verdict: Verdict
) -> None:
    name = f"visibility_{eye}"
    check_mask_values("mask", name, mask, verdict)
    known = all_components(np.isfinite(way))
    if (~known & (mask != OUTSIDE)).any():
        count = count_pixels(~known & (mask != OUTSIDE))
        verdict.add("mask", f"{name}: expected 0 without a disparity, got other values in {count}")
    height, width = mask.shape
    x, y = np.arange(width) + way[..., 0], np.arange(height)[:, None] + way[..., 1]
    with np.errstate(invalid="ignore"):
        inside_px = np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y)) + 0.5
    expected = np.full(mask.shape, UNCERTAIN, np.uint8)
    expected[~known | (inside_px < -_BORDER_PX)] = OUTSIDE
    for value, where in zip((VISIBLE, OCCLUDED), judged, strict=True):
        expected[targets.row[where], targets.column[where]] = value
    check_mask_agreement("mask", name, name, mask, expected, "the disparities", verdict)
