"""What lenses leave in a pair: borders, raw images and maps into them, against the lens in the pair's provenance."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.frame.channels import OUTSIDE, VISIBLE
from semisynth_gl.frame.raw_camera import RawCamera, pinhole_of
from semisynth_gl.judge.agreement import Points, all_components
from semisynth_gl.judge.findings import Verdict
from semisynth_gl.lens.borders import bordered, valid_at

# Bounds; docs/verify.md has them.
_BORDER_PX = 0.01
"""Pixels whose place in the raw image is nearer to its border than this are not judged."""
_MAP_PX = 1e-3
"""Largest error of a map where the raw image has the pixel, px."""
_PHASES = 32
"""OpenCV rounds a position to so many steps a pixel, along each axis."""
_FLOAT32 = 1e-5
"""Error of OpenCV's maps beyond the sensor, as a share of the distance from it."""


def find_borders(frame: StoredFrame, eye: Eye) -> NDArray[np.bool_] | None:
    """Return where a sensor saw nothing of a view's point, (H, W) bool; None for a pair without ``valid``."""
    valid = {each: frame.view(each)["valid"] == VISIBLE for each in EYES if "valid" in frame.view(each)}
    return bordered(frame, eye, valid) if len(valid) == len(EYES) else None


def find_flow_borders(frame: StoredFrame, eye: Eye, channel: str) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return where a view's sensor saw nothing of a point, now or where its flow leads, (H, W) bool each.

    The first array is where that is sure, the second where it may be, up to the rounding of stored flow. Both are empty
    for a view without ``valid``, and without the ``channel`` of flow.
    """
    view, error_px = frame.view(eye), frame.encodings.flow.error_px
    if "valid" not in view or channel not in view:
        none = np.zeros(view.image.shape[:2], bool)
        return none, none
    valid, (along, down) = view.valid == VISIBLE, np.moveaxis(view[channel], 2, 0)
    # Rounding moves the end of flow by less than a pixel, so the corners of its range meet all pixels.
    steps = sorted({-error_px, error_px})
    ends = [valid_at(valid, along + np.float32(x), down + np.float32(y)) for x in steps for y in steps]
    return ~(valid & np.logical_or.reduce(ends)), ~(valid & np.logical_and.reduce(ends))


def find_lost_change(frame: StoredFrame, eye: Eye) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return where a change of disparity must, and where it may be missing for a border; see `find_flow_borders`."""
    if frame.border_disparity:
        none = np.zeros(frame.view(eye).image.shape[:2], bool)
        return none, none
    return find_flow_borders(frame, eye, "flow")


def check_lens(frame: StoredFrame, eye: Eye, verdict: Verdict) -> None:
    """Check a view's ``valid``, ``raw_map`` and ``raw``, where it has them, by the lens of the pair's provenance.

    The mask and the map must be where the lens leads into the raw image, and the image must be what a bilinear filter
    makes of the raw one there.
    """
    view = frame.view(eye)
    present = [name for name in ("valid", "raw_map", "raw") if name in view]
    if not present:
        return
    try:
        raw = RawCamera.from_record(frame.provenance["lens"][eye])
    except (KeyError, TypeError, ValueError):
        fault = f"expected the camera lens.{eye} in the pair's provenance, found it missing or invalid"
        verdict.add(present[0], f"{present[0]}_{eye}: {fault}")
        return
    height, width = view.image.shape[:2]
    x_px, y_px = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    # Points behind the raw camera are nan.
    positions = np.stack(raw.raw(pinhole_of(frame.camera, eye), x_px, y_px), axis=2)
    sides = np.array([raw.width_px, raw.height_px])
    # How far inside the sensor's outermost pixels a position lies.
    within_px = np.minimum(positions, sides - 1 - positions).min(axis=2)
    if "valid" in view:
        mask, seen = view.valid, view.valid == VISIBLE
        verdict.add_pixels("valid", f"valid_{eye}", "is neither 0 nor 255", (mask != VISIBLE) & (mask != OUTSIDE))
        wrong = np.where(seen, ~(within_px >= -_BORDER_PX), within_px > _BORDER_PX)
        verdict.add_pixels("valid", f"valid_{eye}", "disagrees with the lens", wrong)
    if "raw_map" in view:
        # Beyond the sensor, a bent position grows fast, and float32 rounds it in proportion.
        beyond_px = np.maximum(-within_px, 0)[..., None]
        bounds = _MAP_PX + _FLOAT32 * np.where(np.isfinite(beyond_px), beyond_px, 0)
        agree = np.abs(view["raw_map"] - positions) <= bounds
        unknown = np.isnan(positions) & np.isposinf(view["raw_map"])
        wrong = ~all_components(agree | unknown)
        verdict.add_pixels("raw_map", f"raw_map_{eye}", "disagrees with the lens", wrong)
    if "raw" in view:
        wrong = np.zeros((height, width), bool)
        row, column = np.nonzero(within_px >= 0)
        points = Points(row, column, *positions[row, column].T)
        corners = points.corners(np.atleast_3d(view["raw"]).astype(np.float32))
        # A position that is rounded by half a step along both axes, and a rounded level.
        bound = np.ptp(corners, axis=0) / _PHASES + 1
        image = points.of(np.atleast_3d(view.image)).astype(np.float32)
        wrong[row, column] = (np.abs(image - points.between(corners)) > bound).any(axis=1)
        verdict.add_pixels("raw", f"raw_{eye}", "does not rectify to the image", wrong)
