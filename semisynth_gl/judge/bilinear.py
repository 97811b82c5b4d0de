"""Bilinear interpolation of arrays at points between their pixels."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating]


def corners(array: Floats, x: Floats, y: Floats) -> Floats:
    """Return an array's values in the four pixels around each point.

    Args:
        array: (H, W) or (H, W, C).
        x: (N,) columns, from 0 to W - 1.
        y: (N,) rows, from 0 to H - 1.

    Returns:
        (4, N, C), with C = 1 for (H, W). The four pixels of a point on a row or column coincide in pairs.
    """
    left, right, top, bottom = (place.astype(np.intp) for place in (np.floor(x), np.ceil(x), np.floor(y), np.ceil(y)))
    array = array.reshape(*array.shape[:2], -1)
    return np.stack([array[row, column] for row in (top, bottom) for column in (left, right)])


def between(around: Floats, x: Floats, y: Floats) -> Floats:
    """Return the interpolated values (N, C) at points, from their `corners` (4, N, C)."""
    across, down = (x % 1)[:, None], (y % 1)[:, None]
    above, below = around[::2] * (1 - across) + around[1::2] * across
    return np.asarray(above * (1 - down) + below * down)
