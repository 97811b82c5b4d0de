"""PFM, the benchmarks' format for float disparity, and SceneFlow's for flow."""

import numpy as np
from numpy.typing import NDArray


def encode_pfm(image: NDArray[np.float32]) -> bytes:
    """Encode one or three channels: little-endian float32, rows from bottom to top, as all readers of the field expect.

    The scale is -1.0: its sign means little-endian, and OpenCV multiplies by its magnitude.

    Args:
        image: (H, W) or (H, W, 3) float32; inf marks pixels without truth.
    """
    height, width = image.shape[:2]
    header = f"{'Pf' if image.ndim == 2 else 'PF'}\n{width} {height}\n-1.0\n".encode()
    return b"".join([header, np.ascontiguousarray(image[::-1], "<f4").data])
