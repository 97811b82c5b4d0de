"""Disparity as 16-bit PNG that counts fractions of a pixel, 0 where there is no truth: KITTI's 1/256 px, or others."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.write.png import encode_png

KITTI_STEPS = 256
_LARGEST = 65535


def beyond_px(steps: int = KITTI_STEPS) -> float:
    """Return from where on disparities round to more than 16 bits hold."""
    return (_LARGEST + 0.5) / steps


def encode_png16(disparity: NDArray[np.float32], steps: int = KITTI_STEPS) -> bytes:
    """Encode (H, W) float32 px, rounded to a step.

    What is not positive, not finite or too large becomes 0. Below half a step a disparity is written as one step, as
    KITTI's own tools do, since 0 would say that there is none.

    Args:
        disparity: (H, W) float32 px.
        steps: how many make a pixel.
    """
    counted = disparity * np.float32(steps)
    valid = (disparity > 0) & (disparity < np.float32(beyond_px(steps)))
    stored = np.maximum(np.rint(np.where(valid, counted, np.float32(0))), valid)
    return encode_png(stored.astype(np.uint16))
