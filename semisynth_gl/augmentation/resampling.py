"""Truth between pixels, extrapolated from the nearest pixel along its surface.

The disparity of a plane is linear in the image, and so is the inverse of its depth. So the truth at a point is the
value of the nearest pixel plus the slope of that pixel's surface times the distance. Three neighbouring pixels in a row
or column are taken for one surface if their values are collinear within a tolerance. A pixel without such neighbours
has the slope 0. Pixels of different surfaces can be collinear by chance: of 1.4 million pixels of packaged configs at
half the size, scaled by 0.8 to 1.31, 0.04 % were more than 0.1 px off, and the worst 4 px.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Positions = NDArray[np.floating[Any]]


class SamplePoints:
    """Points in an image of height and width ``image_size``, or up to half a pixel outside it.

    Columns ``x_px`` are (H, W) or (1, W), rows ``y_px`` are (H, W) or (H, 1).
    """

    def __init__(self, x_px: Positions, y_px: Positions, image_size: tuple[int, int]) -> None:
        self._column = np.rint(x_px).astype(np.intp).clip(0, image_size[1] - 1)
        self._row = np.rint(y_px).astype(np.intp).clip(0, image_size[0] - 1)
        self._right = (x_px - self._column).astype(np.float32)
        self._down = (y_px - self._row).astype(np.float32)

    def nearest(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the values of the nearest pixels, (H, W) or (H, W, C), from an array of the image."""
        found: NDArray[Any] = values[self._row, self._column]
        return found

    def on_surface(self, values: Floats, tolerance: float | Floats) -> Floats:
        """Return values that are linear on planes, (H, W) or (H, W, C), extrapolated from the nearest pixels.

        Inf and NaN are missing values. Neighbours on one surface deviate from a line by at most ``tolerance``.
        """
        found = self.nearest(values)
        for offset, axis in ((self._right, 1), (self._down, 0)):
            if np.any(offset):
                distance = offset if values.ndim == 2 else offset[..., None]
                before, after = (self.nearest(slopes) for slopes in _slopes(values, axis, tolerance))
                found = found + distance * np.where(distance > 0, after, before)
        return found.astype(np.float32)


def _slopes(values: Floats, axis: int, tolerance: float | Floats) -> tuple[Floats, Floats]:
    """Return the slopes along an axis before and after each pixel, per pixel; 0 where they are unknown.

    The two slopes of a pixel differ if two surfaces meet there.
    """
    line = np.moveaxis(values, axis, 0)
    allowed = np.moveaxis(tolerance, axis, 0)[1:-1] if isinstance(tolerance, np.ndarray) else tolerance
    before, after = np.zeros_like(line), np.zeros_like(line)
    if len(line) > 2:
        with np.errstate(invalid="ignore"):
            steps = np.diff(line, axis=0)
            straight = np.abs(np.diff(steps, axis=0)) <= allowed
            middle = (line[2:] - line[:-2]) / 2
        # Each pixel may be first, middle or last of three collinear pixels; later copies replace earlier ones.
        first, second, third = (slice(None, -2), steps[:-1]), (slice(1, -1), middle), (slice(2, None), steps[1:])
        for slopes, order in ((before, (first, second, third)), (after, (third, second, first))):
            for part, found in order:
                np.copyto(slopes[part], found, where=straight)
    return np.moveaxis(before, 0, axis), np.moveaxis(after, 0, axis)
