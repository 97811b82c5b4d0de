"""Compares borders, raw images and maps into raw images with the lens in the pair's provenance."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.pair_files import StoredFrame
from semisynth_gl.frame.camera import OTHER_EYE, Eye
from semisynth_gl.frame.channels import VISIBLE
from semisynth_gl.frame.raw_camera import RawCamera
from semisynth_gl.judge.findings import Verdict
from semisynth_gl.judge.interpolation import Floats, between, corners
from semisynth_gl.lens.borders import valid_at

# Bounds, px, which docs/verify.md lists. Pixels that map to points nearer to the raw image's border are not judged.
_BORDER_PX, _MAP_PX = 0.01, 1e-3
# Errors by float32: of OpenCV's maps, as a share of the distance beyond the sensor; of a vector's end, px.
_MAP_SHARE, _END_PX = 1e-5, 1e-3
# Number of steps per pixel to which OpenCV rounds a position, along each axis.
_PHASES = 32


def find_borders(
    frame: StoredFrame, eye: Eye, channel: str, vectors: Floats, error_px: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the pixels of a view whose point a sensor cannot have seen, at the pixel or at the end of its vector.

    There are two masks, (H, W) bool each: pixels for which this is certain, and pixels for which it is possible within
    the rounding of ``vectors`` (H, W, 2) px. Both are False for a pair without ``valid``. ``channel``, disparity or
    flow, is the channel from which the vectors come.
    """
    view = frame.view(eye)
    goal = frame.view(OTHER_EYE[eye]) if channel == "disparity" else view
    if "valid" not in view or "valid" not in goal:
        none = np.zeros(vectors.shape[:2], bool)
        return none, none
    valid, valid_there, (along, down) = view.valid == VISIBLE, goal.valid == VISIBLE, np.moveaxis(vectors, 2, 0)
    steps = (-error_px - _END_PX, error_px + _END_PX)
    ends = [valid_at(valid_there, along + x, down + y) for x in steps for y in steps]
    return ~(valid & np.logical_or.reduce(ends)), ~(valid & np.logical_and.reduce(ends))


def check_lens(frame: StoredFrame, eye: Eye, verdict: Verdict) -> None:
    """Compare a view's ``valid``, ``raw_map`` and ``raw``, if present, with the lens of the pair's provenance.

    The mask and the map must agree with the positions in the raw image to which the lens leads. Bilinear interpolation
    of the raw image at these positions must give the view's image.
    """
    view = frame.view(eye)
    present = [name for name in ("valid", "raw_map", "raw") if name in view]
    if not present:
        return
    try:
        raw = RawCamera.from_record(frame.provenance["lens"][eye])
    except (KeyError, TypeError, ValueError):
        verdict.add(present[0], f"{present[0]}_{eye}: the pair's provenance has no valid camera lens.{eye}")
        return
    y_px, x_px = np.mgrid[: view.image.shape[0], : view.image.shape[1]].astype(np.float64)
    # Points behind the raw camera are nan.
    positions = np.stack(raw.to_raw(frame.camera.matrix(eye), x_px, y_px), axis=2)
    # How far inside the sensor's outermost pixels a position lies.
    within_px = np.minimum(positions, np.array([raw.width_px, raw.height_px]) - 1 - positions).min(axis=2)
    if "valid" in view:
        wrong = np.where(view.valid == VISIBLE, ~(within_px >= -_BORDER_PX), within_px > _BORDER_PX)
        verdict.add_pixels("valid", eye, "disagrees with the lens", wrong)
    if "raw_map" in view:
        # Beyond the sensor, distorted positions become large fast, and float32 rounds them in proportion.
        bounds = _MAP_PX + _MAP_SHARE * np.nan_to_num(np.maximum(-within_px, 0), posinf=0)[..., None]
        expected = np.where(np.isnan(positions), np.inf, positions)
        wrong = ~np.isclose(view["raw_map"], expected, rtol=0, atol=bounds).all(axis=2)
        verdict.add_pixels("raw_map", eye, "disagrees with the lens", wrong)
    if "raw" in view:
        wrong, seen = np.zeros(within_px.shape, bool), within_px >= 0
        around = corners(view["raw"].astype(np.float32), *positions[seen].T)
        # The bound allows a position rounded by half a step along both axes, and a rounded level.
        bound = np.ptp(around, axis=0) / _PHASES + 1
        levels = view.image[seen].reshape(len(bound), -1)
        wrong[seen] = (np.abs(levels - between(around, *positions[seen].T)) > bound).any(axis=1)
        verdict.add_pixels("raw", eye, "does not rectify to the image", wrong)
