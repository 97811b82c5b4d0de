"""What lenses leave in a pair: borders, raw images and maps into them, against the lens in the pair's provenance."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.frame.channels import OUTSIDE, VISIBLE, View
from semisynth_gl.frame.raw_camera import RawCamera, pinhole_of
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
_ROWS = 64
"""Rows that are judged at a time, to save memory."""

Positions = NDArray[np.float64]


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
    present = [name for name in _CHECKS if name in view]
    if not present:
        return
    try:
        raw = RawCamera.from_record(frame.provenance["lens"][eye])
    except (KeyError, TypeError, ValueError):
        fault = f"expected the camera lens.{eye} in the pair's provenance, found it missing or invalid"
        verdict.add(present[0], f"{present[0]}_{eye}: {fault}")
        return
    if "valid" in view:
        mask = view["valid"]
        verdict.add_pixels("valid", f"valid_{eye}", "is neither 0 nor 255", (mask != VISIBLE) & (mask != OUTSIDE))
    height, width = view.image.shape[:2]
    wrong = {name: np.zeros((height, width), bool) for name in present}
    pinhole, columns = pinhole_of(frame.camera, eye), np.arange(width, dtype=np.float64)
    for first in range(0, height, _ROWS):
        rows = slice(first, min(first + _ROWS, height))
        x_px, y_px = np.meshgrid(columns, np.arange(rows.start, rows.stop, dtype=np.float64))
        # Points behind the raw camera are nan.
        positions = np.stack(raw.raw(pinhole, x_px, y_px), axis=2)
        for name, found in wrong.items():
            found[rows] = _CHECKS[name](view, rows, positions, (raw.width_px, raw.height_px))
    for name, found in wrong.items():
        verdict.add_pixels(name, f"{name}_{eye}", _FAULTS[name], found)


def _wrong_valid(view: View, rows: slice, positions: Positions, sides: tuple[int, int]) -> NDArray[np.bool_]:
    within, seen = _within_px(positions, sides), view["valid"][rows] == VISIBLE
    wrong: NDArray[np.bool_] = (seen & ~(within >= -_BORDER_PX)) | (~seen & (within > _BORDER_PX))
    return wrong


def _wrong_map(view: View, rows: slice, positions: Positions, sides: tuple[int, int]) -> NDArray[np.bool_]:
    """Beyond the sensor, a bent position grows fast, and float32 rounds it in proportion."""
    beyond_px = np.maximum(-_within_px(positions, sides), 0)[..., None]
    bounds = _MAP_PX + _FLOAT32 * np.where(np.isfinite(beyond_px), beyond_px, 0)
    agree = np.abs(view["raw_map"][rows] - positions) <= bounds
    unknown = np.isnan(positions) & np.isposinf(view["raw_map"][rows])
    return np.asarray(~(agree | unknown).all(axis=2))


def _wrong_raw(view: View, rows: slice, positions: Positions, sides: tuple[int, int]) -> NDArray[np.bool_]:
    wrong = np.zeros(positions.shape[:2], bool)
    row, column = np.nonzero(_within_px(positions, sides) >= 0)
    x, y = positions[row, column].T
    raw = np.atleast_3d(view["raw"])
    left, top = np.floor(x).astype(np.intp), np.floor(y).astype(np.intp)
    # The last column and the last row mix with nothing beyond them.
    right, bottom = np.minimum(left + 1, sides[0] - 1), np.minimum(top + 1, sides[1] - 1)
    corners = np.stack([raw[each] for each in ((top, left), (top, right), (bottom, left), (bottom, right))])
    corners = corners.astype(np.float32)
    across, along = ((at - low)[:, None].astype(np.float32) for at, low in ((x, left), (y, top)))
    mixed = (corners[0] * (1 - across) + corners[1] * across) * (1 - along)
    mixed += (corners[2] * (1 - across) + corners[3] * across) * along
    # A position that is rounded by half a step along both axes, and a rounded level.
    bound = np.ptp(corners, axis=0) / _PHASES + 1
    image = np.atleast_3d(view.image[rows])[row, column].astype(np.float32)
    wrong[row, column] = (np.abs(image - mixed) > bound).any(axis=1)
    return wrong


def _within_px(positions: Positions, sides: tuple[int, int]) -> Positions:
    """Return how far inside the sensor's outermost pixels positions (H, W, 2) lie, (H, W) px; negative beyond."""
    inside: Positions = np.minimum(positions, np.array(sides) - 1 - positions).min(axis=2)
    return inside


_CHECKS = {"valid": _wrong_valid, "raw_map": _wrong_map, "raw": _wrong_raw}
_FAULTS = {
    "valid": "disagrees with the lens",
    "raw_map": "disagrees with the lens",
    "raw": "does not rectify to the image",
}
