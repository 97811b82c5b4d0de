"""The borders of rectified images: the output ``valid`` against the lens in the pair's provenance."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.frame.channels import OUTSIDE, VISIBLE
from semisynth_gl.lens.borders import bordered
from semisynth_gl.lens.raw_camera import RawCamera, pinhole_of
from semisynth_gl.verification.verdict import Verdict

_BORDER_PX = 0.01
"""Pixels whose place in the raw image is nearer to its border than this are not judged; docs/verify.md derives it."""


def find_borders(frame: StoredFrame, eye: Eye) -> NDArray[np.bool_] | None:
    """Return where a sensor saw nothing of a view's point, (H, W) bool; None for a pair without ``valid``."""
    valid = {each: frame.view(each)["valid"] == VISIBLE for each in EYES if "valid" in frame.view(each)}
    return bordered(frame, eye, valid) if len(valid) == len(EYES) else None


def check_valid(frame: StoredFrame, eye: Eye, verdict: Verdict) -> None:
    """Check a view's ``valid``: its values, and that it is where the lens of pair.json leads into the raw image."""
    mask, name = frame.view(eye).get("valid"), f"valid_{eye}"
    if mask is None:
        return
    verdict.add_pixels("valid", name, "is neither 0 nor 255", (mask != VISIBLE) & (mask != OUTSIDE))
    try:
        raw = RawCamera.from_record(frame.provenance["lens"][eye])
    except (KeyError, TypeError, ValueError):
        verdict.add(
            "valid", f"{name}: expected the camera lens.{eye} in the pair's provenance, found none that is whole"
        )
        return
    y_px, x_px = np.mgrid[: mask.shape[0], : mask.shape[1]].astype(np.float64)
    x, y = raw.raw(pinhole_of(frame.camera, eye), x_px, y_px)
    within = np.minimum(np.minimum(x, raw.width_px - 1 - x), np.minimum(y, raw.height_px - 1 - y))
    # Points that are not before the raw camera are nan.
    wrong = np.where(mask == VISIBLE, ~(within >= -_BORDER_PX), within > _BORDER_PX)
    verdict.add_pixels("valid", name, "is not where the lens leads into the raw image", wrong)
