"""Holes of disparity maps, filled within each row."""

import numpy as np
from numpy.typing import NDArray


def fill_rows(disparity: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return a disparity (H, W) px in which each nan pixel has the smaller of the nearest values to its left and right.

    At the ends of a row, it has the only one. Rows without any value stay nan.
    """
    known, column = np.isfinite(disparity), np.arange(disparity.shape[1])
    before = np.maximum.accumulate(np.where(known, column, 0), axis=1)
    after = np.minimum.accumulate(np.where(known, column, column[-1])[:, ::-1], axis=1)[:, ::-1]
    # Where only one side has a value, fmin takes it.
    return np.fmin(np.take_along_axis(disparity, before, axis=1), np.take_along_axis(disparity, after, axis=1))
