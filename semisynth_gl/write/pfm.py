"""PFM, the benchmarks' format for float disparity."""

import numpy as np
from numpy.typing import NDArray


def encode_pfm(image: NDArray[np.float32]) -> bytes:
    """Encode one channel: little-endian float32, rows from bottom to top, as every reader of the field expects.

    The scale is -1.0: its sign means little-endian, and OpenCV multiplies by its magnitude.

    Args:
        image: (H, W) float32; inf marks pixels without truth.
    """
    height, width = image.shape
    header = f"Pf\n{width} {height}\n-1.0\n".encode()
    return b"".join([header, np.ascontiguousarray(image[::-1], "<f4").data])
