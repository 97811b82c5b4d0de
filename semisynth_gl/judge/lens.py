"""Compares the channels `valid`, `raw` and `raw_map` with the lens that the pair's provenance records.

A border is the part of a rectified image where the sensor saw nothing.
"""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.pair_files import StoredFrame
from semisynth_gl.frame.camera import OTHER_EYE, Eye
from semisynth_gl.frame.channels import VISIBLE
from semisynth_gl.frame.raw_camera import RawCamera
from semisynth_gl.judge.findings import CheckResults
from semisynth_gl.judge.interpolation import Floats, interpolate, pixels_around
from semisynth_gl.lens.borders import valid_at

# The mask `valid` is not checked where the position in the raw image is nearer than this to the raw image's edge.
_BORDER_PX = 0.01
# Bound of errors of `raw_map`. Outside the raw image, it grows by a share of the distance, since float32 rounds.
_MAP_PX, _MAP_SHARE = 1e-3, 1e-5
# Error of a vector's end, px, by float32.
_END_PX = 1e-3
# OpenCV's `remap` rounds positions to 1/32 px.
_STEPS_PER_PX = 32


def hidden_by_borders(
    frame: StoredFrame, eye: Eye, channel: str, vectors: Floats, error_px: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the pixels of a view whose point lies in a border, of this image or of the second.

    ``vectors`` (H, W, 2) px of a ``channel``, disparity or flow, lead to the points in the second image. The result has
    two masks, (H, W) bool: where a border certainly hides the point, and where it may do so, if the vectors' components
    are wrong by up to ``error_px``. Both are False for a pair without ``valid``.
    """
    view = frame.view(eye)
    second = frame.view(OTHER_EYE[eye]) if channel == "disparity" else view
    if "valid" not in view or "valid" not in second:
        none = np.zeros(vectors.shape[:2], bool)
        return none, none
    valid, valid_second, (along, down) = view.valid == VISIBLE, second.valid == VISIBLE, np.moveaxis(vectors, 2, 0)
    errors = (-error_px - _END_PX, error_px + _END_PX)
    ends = [valid_at(valid_second, along + x, down + y) for x in errors for y in errors]
    return ~(valid & np.logical_or.reduce(ends)), ~(valid & np.logical_and.reduce(ends))


def check_lens(frame: StoredFrame, eye: Eye, results: CheckResults) -> None:
    """Compare a view's ``valid``, ``raw_map`` and ``raw``, if present, with the lens of the pair's provenance.

    The lens maps each pixel to a position in the raw image. ``raw_map`` must equal these positions, and ``valid`` must
    say which of them lie in the raw image. ``raw``, interpolated at the positions, must equal the view's image.
    """
    view = frame.view(eye)
    present = [name for name in ("valid", "raw_map", "raw") if name in view]
    if not present:
        return
    try:
        raw = RawCamera.from_record(frame.provenance["lens"][eye])
    except (KeyError, TypeError, ValueError):
        results.add(present[0], f"{present[0]}_{eye}: the pair's provenance has no valid camera lens.{eye}")
        return
    y_px, x_px = np.mgrid[: view.image.shape[0], : view.image.shape[1]].astype(np.float64)
    # nan for points behind the raw camera.
    positions = np.stack(raw.to_raw(frame.camera.matrix(eye), x_px, y_px), axis=2)
    # Distance to the raw image's edge, which goes through the centres of its outermost pixels; negative outside.
    within_px = np.minimum(positions, np.array([raw.width_px, raw.height_px]) - 1 - positions).min(axis=2)
    if "valid" in view:
        wrong = np.where(view.valid == VISIBLE, ~(within_px >= -_BORDER_PX), within_px > _BORDER_PX)
        results.add_pixels("valid", eye, "disagrees with the lens", wrong)
    if "raw_map" in view:
        bounds = _MAP_PX + _MAP_SHARE * np.nan_to_num(np.maximum(-within_px, 0), posinf=0)[..., None]
        expected = np.where(np.isnan(positions), np.inf, positions)
        wrong = ~np.isclose(view["raw_map"], expected, rtol=0, atol=bounds).all(axis=2)
        results.add_pixels("raw_map", eye, "disagrees with the lens", wrong)
    if "raw" in view:
        wrong, seen = np.zeros(within_px.shape, bool), within_px >= 0
        around = pixels_around(view["raw"].astype(np.float32), *positions[seen].T)
        # OpenCV rounds a position by up to half a step along both axes, and then the level.
        bound = np.ptp(around, axis=0) / _STEPS_PER_PX + 1
        levels = view.image[seen].reshape(len(bound), -1)
        wrong[seen] = (np.abs(levels - interpolate(around, *positions[seen].T)) > bound).any(axis=1)
        results.add_pixels("raw", eye, "does not rectify to the image", wrong)
