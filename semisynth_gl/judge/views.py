"""The two views of a pair compared with each other, and pairs of one scene, which share their left view."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame.camera import EYES, OTHER_EYE, Eye
from semisynth_gl.frame.channels import CHANNELS, OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.judge.agreement import (
    UNCERTAIN,
    Agreement,
    Points,
    all_components,
    check_mask_agreement,
    check_mask_values,
    follow,
    inside_px,
)
from semisynth_gl.judge.findings import Verdict, count_pixels
from semisynth_gl.judge.flow import HIDDEN_PX, check_flow_views
from semisynth_gl.judge.images import check_images
from semisynth_gl.judge.lens import find_borders
from semisynth_gl.judge.single_view import DEVIATING_PX, FLOAT32

Where = NDArray[np.bool_]

# Within this distance of the image's border, px, a point may count as inside or outside.
_BORDER_PX = 2e-3


def check_views(frame: StoredFrame, verdict: Verdict, *, imperfect: bool) -> None:
    """Compare both views by disparity: disparities, masks, flow and images, at the same points.

    ``imperfect`` says whether the images have the imperfections of a rig, or a lossy encoding.
    """
    if any("disparity" not in frame.view(eye) for eye in EYES):
        return
    ways = {eye: frame.correspondences(eye) for eye in EYES}
    for eye in EYES:
        other, disparity = OTHER_EYE[eye], frame.view(eye)["disparity"]
        points = follow(ways[eye], disparity[..., None], on_rows=frame.camera.rectified)
        names = f"disparity_{eye}", f"disparity_{other} at the same point"
        error_px = 2 * frame.encodings.disparity.error_px
        agreement = Agreement(names, ways[eye], -points.corners(ways[other]), points, error_px)
        surface = agreement.close
        nearest = points.corners(frame.view(other)["disparity"][..., None])[..., 0].min(axis=0)
        covered = nearest > points.of(disparity) + HIDDEN_PX + error_px
        mask = frame.view(eye).get("visibility")
        if mask is None:
            visible = ~covered
        else:
            seen = surface & agreement.agree
            _check_mask(frame, eye, ways[eye], points, seen, covered & np.isfinite(nearest), verdict)
            visible = points.of(mask) == VISIBLE
        judged = visible & (agreement.known | frame.camera.rectified)
        agreement.check("left-right", f"left_right_{eye}", judged, surface, verdict)
        if eye == "left":
            surface = visible & surface
            if frame.camera.rectified:
                check_flow_views(frame, points, visible, surface, verdict)
            images = frame.left["image"], frame.right["image"]
            matched = points.select(surface)
            check_images("images", "disparity_left", "", images, matched, verdict, imperfect=imperfect)


def _check_mask(
    frame: StoredFrame,
    eye: Eye,
    way: NDArray[np.float64],
    points: Points,
    seen: Where,
    hidden: Where,
    verdict: Verdict,
) -> None:
    """Check a view's mask by the points that the other eye surely sees, (N,) bool, or surely does not see."""
    name, mask = f"visibility_{eye}", frame.view(eye)["visibility"]
    check_mask_values("mask", name, mask, verdict)
    known, inside = all_components(np.isfinite(way)), inside_px(way)
    invalid = ~known & (mask != OUTSIDE)
    if invalid.any():
        verdict.add("mask", f"{name}: expected 0 without a disparity, got other values in {count_pixels(invalid)}")
    expected = np.full(mask.shape, UNCERTAIN, np.uint8)
    expected[~known | (inside < -_BORDER_PX)] = OUTSIDE
    for value, where in ((VISIBLE, seen), (OCCLUDED, hidden)):
        expected[points.row[where], points.column[where]] = value
    borders = find_borders(frame, eye)
    if borders is not None:
        expected[borders & known & (inside > _BORDER_PX)] = OCCLUDED
    check_mask_agreement("mask", name, mask, expected, "the disparities", verdict)


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

    def descent(at: tuple[int, int]) -> str:
        return f", which goes {way[at][1]:g} px down, and by the camera {expected[at][1]:g} px"

    verdict.add_pixels("correspondence", name, "does not go down as the camera says", wrong, descent)


def check_lefts(frame: StoredFrame, other: StoredFrame, verdict: Verdict) -> None:
    """Compare the left view of a pair with the left view of another pair of the same scene and size."""
    own, camera = frame.camera.left_alone, other.camera.left_alone
    if own != camera:
        verdict.add("lefts", f"the left camera is not that of {other.name}: {own} instead of {camera}")
        return
    for name, channel in CHANNELS.items():
        mine, its = frame.left.get(name), other.left.get(name)
        if channel.of_own_view and mine is not None and its is not None:
            differs = ~all_components((mine == its) if mine.ndim == 3 else (mine == its)[..., None])
            verdict.add_pixels("lefts", channel.role("left"), f"is not that of {other.name}", differs)
    for one, two in ((frame, other), (other, frame)):
        wrong = _of_another_depth(one, two)
        if wrong.any():
            y, x = np.argwhere(wrong)[0]
            at = np.array(float(x)), np.array(float(y))
            depths = [float(pair.camera.depth_at("left", *at, pair.left.disparity[y, x])) for pair in (one, two)]
            detail = f", which is {depths[1]:g} m away and not {depths[0]:g} m"
            verdict.add_pixels("lefts", f"disparity_left of {one.name}", f"is not that of {two.name}", wrong, detail)
            return


def _of_another_depth(frame: StoredFrame, other: StoredFrame) -> NDArray[np.bool_]:
    """Return where a pair's left disparity contradicts the depth in another pair's left view, (H, W) bool."""
    disparity, its = frame.left.disparity, other.left.disparity.astype(np.float64)
    camera, its_camera = frame.camera, other.camera
    if not (camera.focal_baseline and its_camera.focal_baseline):
        return np.zeros(disparity.shape, bool)
    y_px, x_px = np.mgrid[: disparity.shape[0], : disparity.shape[1]].astype(np.float64)
    depth_m = its_camera.depth_at("left", x_px, y_px, its)
    expected = -camera.correspondence("left", x_px, y_px, depth_m)[..., 0]
    bound = FLOAT32 * (np.abs(its) + 2 * abs(its_camera.doffs_px)) + other.rounding_px(its)
    bound *= camera.focal_baseline / its_camera.focal_baseline
    bound += FLOAT32 * (np.abs(expected) + 2 * abs(camera.doffs_px)) + frame.rounding_px(disparity)
    bound += 0.0 if camera.rectified and its_camera.rectified else 2 * DEVIATING_PX
    missing = np.isfinite(its) & (expected > bound) & (expected < frame.encodings.disparity.limit_px - bound)
    wrong = np.isfinite(its) & ~(np.abs(disparity - expected) <= bound)
    result: NDArray[np.bool_] = np.where(np.isfinite(disparity), wrong, missing)
    return result
