"""What lenses leave in a pair: borders, raw images and maps into them, against the lens in the pair's provenance."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.frame.channels import OUTSIDE, VISIBLE
from semisynth_gl.lens.borders import bordered
from semisynth_gl.lens.raw_camera import RawCamera, pinhole_of
from semisynth_gl.verification.verdict import Verdict, format_vector

# Bounds; docs/verify.md derives them.
_BORDER_PX = 0.01
"""Pixels whose place in the raw image is nearer to its border than this are not judged."""
_MAP_PX = 1e-3
"""Largest error of a map where the raw image has the pixel, px."""
_PHASES = 32
"""OpenCV rounds a position to so many steps a pixel, along each axis."""


def find_borders(frame: StoredFrame, eye: Eye) -> NDArray[np.bool_] | None:
    """Return where a sensor saw nothing of a view's point, (H, W) bool; None for a pair without ``valid``."""
    valid = {each: frame.view(each)["valid"] == VISIBLE for each in EYES if "valid" in frame.view(each)}
    return bordered(frame, eye, valid) if len(valid) == len(EYES) else None


def check_lens(frame: StoredFrame, eye: Eye, verdict: Verdict) -> None:
    """Check a view's ``valid``, ``raw_map`` and ``raw``, where it has them, by the lens of the pair's provenance.

    The mask and the map must be where the lens leads into the raw image, and the image must be what a bilinear filter
    makes of the raw one there.
    """
    view = frame.view(eye)
    checks = {"valid": _check_valid, "raw_map": _check_map, "raw": _check_raw}
    present = [name for name in checks if name in view]
    if not present:
        return
    try:
        raw = RawCamera.from_record(frame.provenance["lens"][eye])
    except (KeyError, TypeError, ValueError):
        fault = f"expected the camera lens.{eye} in the pair's provenance, found none that is whole"
        verdict.add(present[0], f"{present[0]}_{eye}: {fault}")
        return
    y_px, x_px = np.mgrid[: view.image.shape[0], : view.image.shape[1]].astype(np.float64)
    positions = np.stack(raw.raw(pinhole_of(frame.camera, eye), x_px, y_px), axis=2)
    ends = np.array([raw.width_px - 1, raw.height_px - 1])
    # Points that are not before the raw camera are nan.
    within = np.minimum(positions, ends - positions).min(axis=2)
    for name in present:
        checks[name](frame, eye, positions, within, verdict)


def _check_valid(
    frame: StoredFrame, eye: Eye, positions: NDArray[np.float64], within: NDArray[np.float64], verdict: Verdict
) -> None:
    del positions
    mask, name = frame.view(eye)["valid"], f"valid_{eye}"
    verdict.add_pixels("valid", name, "is neither 0 nor 255", (mask != VISIBLE) & (mask != OUTSIDE))
    wrong = np.where(mask == VISIBLE, ~(within >= -_BORDER_PX), within > _BORDER_PX)
    verdict.add_pixels("valid", name, "is not where the lens leads into the raw image", wrong)


def _check_map(
    frame: StoredFrame, eye: Eye, positions: NDArray[np.float64], within: NDArray[np.float64], verdict: Verdict
) -> None:
    found = frame.view(eye)["raw_map"]
    wrong = (within >= 0) & ~(np.abs(found - positions).max(axis=2) <= _MAP_PX)

    def places(at: tuple[int, int]) -> str:
        return f", which has {format_vector(found[at])}, where the lens leads to {format_vector(positions[at])}"

    verdict.add_pixels("raw_map", f"raw_map_{eye}", "is not where the lens leads", wrong, places)


def _check_raw(
    frame: StoredFrame, eye: Eye, positions: NDArray[np.float64], within: NDArray[np.float64], verdict: Verdict
) -> None:
    if not frame.encodings.image.lossless:
        return
    image, raw = (np.atleast_3d(each).astype(np.float32) for each in (frame.view(eye).image, frame.view(eye)["raw"]))
    row, column = np.nonzero(within >= _BORDER_PX)
    x, y = positions[row, column].T
    # The last whole position mixes with nothing beyond it.
    left = np.floor(x).astype(np.intp).clip(max=raw.shape[1] - 2)
    top = np.floor(y).astype(np.intp).clip(max=raw.shape[0] - 2)
    corners = np.stack([raw[top + down, left + right] for down in (0, 1) for right in (0, 1)])
    across, along = ((at - low)[:, None].astype(np.float32) for at, low in ((x, left), (y, top)))
    mixed = (corners[0] * (1 - across) + corners[1] * across) * (1 - along)
    mixed += (corners[2] * (1 - across) + corners[3] * across) * along
    # A position that is rounded by half a step along both axes, and a rounded level.
    bound = np.ptp(corners, axis=0) / _PHASES + 1
    wrong = np.zeros(within.shape, bool)
    wrong[row, column] = (np.abs(image[row, column] - mixed) > bound).any(axis=1)
    verdict.add_pixels("raw", f"the {eye} image", f"is not what raw_{eye} gives through the lens", wrong)
