"""Correspondences compared with disparities and the camera; views of a deviating rig compared with each other."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame.camera import EYES, OTHER_EYE, Eye
from semisynth_gl.frame.channels import OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.verification.agreement import (
    UNCERTAIN,
    Agreement,
    Points,
    all_components,
    check_visibility,
    ends,
    inside_px,
)
from semisynth_gl.verification.flow_consistency import follow_flow
from semisynth_gl.verification.lens import find_borders
from semisynth_gl.verification.photometry import check_flow_images
from semisynth_gl.verification.single_view import DEVIATING_PX
from semisynth_gl.verification.verdict import Verdict
from semisynth_gl.verification.view_consistency import HIDDEN_PX

# Within this distance of the image's border, px, a point may count as inside or outside.
_BORDER_PX = 2e-3


def check_correspondence(frame: StoredFrame, eye: Eye, verdict: Verdict) -> None:
    """Check a view's correspondences: where there are any, and whether they fit the disparities and the camera."""
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
    expected = frame.correspondences(eye)
    error = np.abs(np.where(both[..., None], way - expected, 0))[..., 1]
    # The rounding of a disparity makes the depth, and with it y, less certain.
    wrong = ~(error <= DEVIATING_PX + frame.rounding_px(disparity))
    verdict.measures[f"{name}_largest_y_px"] = float(error[~wrong].max(initial=0.0))

    def descent(at: tuple[int, int]) -> str:
        return f", which goes {way[at][1]:g} px down, and by the camera {expected[at][1]:g} px"

    verdict.add_pixels("correspondence", name, "does not go down as the camera says", wrong, descent)


def check_deviating_views(frame: StoredFrame, verdict: Verdict, *, imperfect: bool) -> None:
    """Compare both views of a pair whose right camera deviates; ``imperfect`` is as in `check_images`."""
    ways = {eye: frame.correspondences(eye) for eye in EYES}
    for eye in EYES:
        other = OTHER_EYE[eye]
        targets = follow_flow(ways[eye].astype(np.float32), frame.view(eye)["disparity"])
        names = f"the way from the {eye} view", f"the reverse of that from the {other} view at its end"
        error_px = 2 * frame.encodings.disparity.error_px
        agreement = Agreement(names, ways[eye], -targets.corners(ways[other]), targets, error_px)
        surface = agreement.close
        seen = surface & agreement.agree
        mask = frame.view(eye).get("visibility")
        if mask is not None:
            _check_mask(frame, eye, ways[eye], targets, seen, verdict)
        visible = seen if mask is None else mask[targets.row, targets.column] == VISIBLE
        agreement.check("left-right", f"left_right_{eye}", visible & agreement.known, surface, verdict)
        if eye == "left":
            images, judged = (frame.left["image"], frame.right["image"]), targets.select(visible & surface)
            name = "the way from the left view"
            check_flow_images("images", name, "images", images, judged, verdict, imperfect=imperfect)


def _check_mask(
    frame: StoredFrame, eye: Eye, way: NDArray[np.float64], targets: Points, seen: NDArray[np.bool_], verdict: Verdict
) -> None:
    """Check a view's mask by the points that the other eye surely sees, (N,) bool, or surely does not see."""
    disparity, mask = frame.view(eye)["disparity"], frame.view(eye)["visibility"]
    nearest = targets.corners(frame.view(OTHER_EYE[eye])["disparity"][..., None])[..., 0]
    hidden_px = disparity[targets.row, targets.column] + HIDDEN_PX + 2 * frame.encodings.disparity.error_px
    hidden = np.isfinite(nearest).all(axis=0) & (nearest.min(axis=0) > hidden_px)
    known = all_components(np.isfinite(way))
    expected = np.full(mask.shape, UNCERTAIN, np.uint8)
    expected[~known | (inside_px(*ends(way)) < -_BORDER_PX)] = OUTSIDE
    for value, where in ((VISIBLE, seen), (OCCLUDED, hidden)):
        expected[targets.row[where], targets.column[where]] = value
    borders = find_borders(frame, eye)
    if borders is not None:
        expected[borders & known & (inside_px(*ends(way)) > _BORDER_PX)] = OCCLUDED
    check_visibility(f"visibility_{eye}", mask, known, expected, verdict)
