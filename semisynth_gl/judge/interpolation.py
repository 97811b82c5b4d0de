"""Interpolates arrays at points between their pixels, and fills holes of disparity maps."""

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
        (4, N, C), with C = 1 for (H, W). If a point lies on a row or column, its four pixels coincide in pairs.
    """
    left, right, top, bottom = (place.astype(np.intp) for place in (np.floor(x), np.ceil(x), np.floor(y), np.ceil(y)))
    array = array.reshape(*array.shape[:2], -1)
    return np.stack([array[row, column] for row in (top, bottom) for column in (left, right)])


def between(around: Floats, x: Floats, y: Floats) -> Floats:
    """Return the interpolated values (N, C) at points, from their `corners` (4, N, C)."""
    across, down = (x % 1)[:, None], (y % 1)[:, None]
    above, below = around[::2] * (1 - across) + around[1::2] * across
    return np.asarray(above * (1 - down) + below * down)


def fill_holes(disparity: NDArray[np.float32]) -> NDArray[np.float32]:
    """Fill the holes, which are not finite, of a disparity (H, W) px, as KITTI's development kit does.

    A hole gets the smaller of the nearest values to its left and right in its row, or the only one of them: most holes
    are background that only one eye sees. Rows above the first row with a value become copies of that row, and so on
    below the last. Other rows without any value get -1, KITTI's value for no disparity.
    """
    known, column = np.isfinite(disparity), np.arange(disparity.shape[1])
    before = np.maximum.accumulate(np.where(known, column, 0), axis=1)
    after = np.minimum.accumulate(np.where(known, column, column[-1])[:, ::-1], axis=1)[:, ::-1]
    disparity = np.where(known, disparity, np.float32(np.nan))
    # If only one side has a value, fmin returns it.
    filled = np.fmin(np.take_along_axis(disparity, before, axis=1), np.take_along_axis(disparity, after, axis=1))
    rows = np.flatnonzero(known.any(axis=1))
    if rows.size:
        filled[: rows[0]], filled[rows[-1] + 1 :] = filled[rows[0]], filled[rows[-1]]
    return np.where(np.isnan(filled), np.float32(-1), filled)
