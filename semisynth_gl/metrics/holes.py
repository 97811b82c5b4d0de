"""Holes of a prediction, filled as KITTI's kit fills them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

UNFILLED = np.float32(-1)
"""What the kit has where there is no disparity; where it cannot fill, it is compared with the truth like any other."""


def fill_holes(disparity: NDArray[np.float32], valid: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Fill pixels without a value from those around them.

    Source: ``interpolateBackground`` in io_disp.h of KITTI's development kit. Within a row a hole takes the smaller of
    its left and right neighbours; at the row's ends it takes the only one. Rows above the first row that has a value
    take that row's, and rows below the last take the last's. Rows without any value between such rows stay unfilled.

    Args:
        disparity: (H, W) float32 px.
        valid: (H, W) bool, where it counts.

    Returns:
        (H, W) float32 px, `UNFILLED` where nothing could be filled in.
    """
    width = disparity.shape[1]
    column = np.arange(width)
    before = np.maximum.accumulate(np.where(valid, column, -1), axis=1)
    after = np.minimum.accumulate(np.where(valid, column, width)[:, ::-1], axis=1)[:, ::-1]
    # fmin takes the other one where one is NaN: at the ends of a row.
    filled = np.fmin(_taken(disparity, before, before >= 0), _taken(disparity, after, after < width))
    rows = np.flatnonzero(valid.any(axis=1))
    if rows.size:
        first, last = rows[0], rows[-1]
        filled[:first] = filled[first]
        filled[last + 1 :] = filled[last]
    return np.where(np.isnan(filled), UNFILLED, filled)


def _taken(disparity: NDArray[np.float32], columns: NDArray[Any], there: NDArray[np.bool_]) -> NDArray[np.float32]:
    """The values at these columns of each row, NaN where there is none."""
    values = np.take_along_axis(disparity, np.clip(columns, 0, disparity.shape[1] - 1), axis=1)
    return np.where(there, values, np.float32(np.nan))
