"""Where flow takes the pixels of one frame in another one."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.verify.consistency import SMOOTH_PX

Values = NDArray[np.float32]
Where = NDArray[np.bool_]

# Enough for shares and medians; more would only take time.
_MOST = 200_000


@dataclass(frozen=True, slots=True, eq=False)
class Landing:
    """Where flow takes N pixels of one frame in another one.

    Attributes:
        row: (N,) int64, where they are.
        column: (N,) int64.
        x: (N,) float64, where they come to.
        y: (N,) float64.
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    x: NDArray[np.float64]
    y: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.row)

    def own(self, array: Values) -> Values:
        """What an array (H, W, C) of the frame that they are of has at them, (N, C)."""
        values: Values = array[self.row, self.column]
        return values

    def corners(self, array: Values) -> Values:
        """What an array (H, W, C) of the other frame has in the four pixels around where they come to, (4, N, C)."""
        left, top = np.floor(self.x).astype(np.int64), np.floor(self.y).astype(np.int64)
        right, bottom = np.minimum(left + 1, array.shape[1] - 1), np.minimum(top + 1, array.shape[0] - 1)
        return np.stack([array[top, left], array[top, right], array[bottom, left], array[bottom, right]])

    def between(self, corners: Values) -> NDArray[np.float64]:
        """Interpolate (4, N, C) to where they come to, (N, C)."""
        across, down = (self.x - np.floor(self.x))[:, None], (self.y - np.floor(self.y))[:, None]
        with np.errstate(invalid="ignore"):
            above = corners[0] * (1 - across) + corners[1] * across
            below = corners[2] * (1 - across) + corners[3] * across
            result: NDArray[np.float64] = above * (1 - down) + below * down
        return result

    def only(self, where: NDArray[np.intp]) -> "Landing":
        """Keep those of these numbers."""
        return Landing(self.row[where], self.column[where], self.x[where], self.y[where])


def land(flow: Values, disparity: Values) -> Landing:
    """Follow pixels along their flow: those that stay in the image, and whose surface goes on to all sides.

    Of more than 200,000, as many evenly spread are taken.

    Args:
        flow: (H, W, 2) float32 px.
        disparity: (H, W) float32 px.
    """
    height, width = disparity.shape
    whole = has_flow(flow) & is_smooth(disparity[..., None]) & is_smooth(flow)
    known = np.where(whole[..., None], flow, 0).astype(np.float64)
    x, y = np.arange(width) + known[..., 0], np.arange(height)[:, None] + known[..., 1]
    whole &= (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    row, column = np.divmod(spread(np.flatnonzero(whole)), width)
    return Landing(row, column, x[row, column], y[row, column])


def both(where: Where) -> Where:
    """Whether something is true of both components, (H, W) of (H, W, 2)."""
    # Faster by far than numpy's reduction of an axis so short.
    result: Where = where[..., 0] & where[..., 1]
    return result


def has_flow(flow: Values) -> Where:
    """Where there is flow, (H, W)."""
    return both(np.isfinite(flow))


def is_smooth(values: Values) -> Where:
    """Where (H, W, C) bends little, along the row and the column: such pixels and their neighbours are one surface."""
    smooth = np.zeros(values.shape[:2], bool)
    inner = smooth[1:-1, 1:-1]
    inner[...] = True
    for channel in np.moveaxis(values, 2, 0):
        with np.errstate(invalid="ignore"):
            inner &= np.abs(np.diff(channel[1:-1], 2, axis=1)) < SMOOTH_PX
            inner &= np.abs(np.diff(channel[:, 1:-1], 2, axis=0)) < SMOOTH_PX
    return smooth


def spread(pixels: NDArray[np.intp], most: int = _MOST) -> NDArray[np.intp]:
    """Return at most so many pixels, evenly spread over all."""
    return pixels[:: max(1, -(-len(pixels) // most))]
