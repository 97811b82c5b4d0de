"""Bilinear interpolation at points between pixels, and KITTI's way to fill holes of disparity maps."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating]


def pixels_around(array: Floats, x: Floats, y: Floats) -> Floats:
    """Return an array's values (4, N, C) in the pixels around N points: top left, top right, bottom left, bottom right.

    The ``array`` is (H, W, C), or (H, W) for C = 1. Columns ``x`` (N,) are from 0 to W - 1, and rows ``y`` (N,) from 0
    to H - 1. A point with a whole x has the same pixels on its left and right; with a whole y, above and below.
    """
    left, right, top, bottom = (side.astype(np.intp) for side in (np.floor(x), np.ceil(x), np.floor(y), np.ceil(y)))
    array = array.reshape(*array.shape[:2], -1)
    return np.stack([array[row, column] for row in (top, bottom) for column in (left, right)])


def interpolate(around: Floats, x: Floats, y: Floats) -> Floats:
    """Return the bilinearly interpolated values (N, C) at points, from the `pixels_around` them, (4, N, C)."""
    along, down = (x % 1)[:, None], (y % 1)[:, None]
    top, bottom = around[::2] * (1 - along) + around[1::2] * along
    return np.asarray(top * (1 - down) + bottom * down)


def fill_holes(disparity: NDArray[np.float32]) -> NDArray[np.float32]:
    """Fill the holes of a disparity map (H, W), px, as KITTI's development kit does; inf and nan are holes.

    A hole gets the smaller of the nearest values on its left and right in its row, since most holes are background that
    only one eye sees. If only one side has a value, the hole gets this value. Rows above the first row with a value
    become copies of that row, and rows below the last row with a value copies of that one. Other rows without a value
    get -1, KITTI's value for no disparity.
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
