"""KITTI's disparity: a 16-bit PNG that counts 1/256 px, 0 where there is no truth."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.write.png import encode_png

_STEPS = 256
_LARGEST = 65535

BEYOND_PX = (_LARGEST + 0.5) / _STEPS
"""Disparities from here on round to more than 16 bits hold."""


def encode_png16(disparity: NDArray[np.float32]) -> bytes:
    """Encode (H, W) float32 px, rounded to 1/256 px.

    What is not positive, not finite or too large becomes 0. Below 1/512 px a disparity is written as 1/256 px, as
    KITTI's own tools do, since 0 would say that there is none.
    """
    steps = disparity * np.float32(_STEPS)
    valid = (disparity > 0) & (disparity < np.float32(BEYOND_PX))
    stored = np.maximum(np.rint(np.where(valid, steps, np.float32(0))), valid)
    return encode_png(stored.astype(np.uint16))
