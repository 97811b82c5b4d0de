"""Finds black borders of rectified photographs, whose pixels come from outside the raw photograph."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

# Levels up to this one count as black, since JPEG changes black a little.
_BLACK = 3
# Minimum shares of a photograph that the border and the inside cover; otherwise the black part is a dark object.
_LEAST_BORDER, _LEAST_INSIDE = 1e-3, 0.5
# Maximum share of black pixels along an edge of the inside.
_MOST_BLACK = 0.005
# Width of the strip along a border that is cut off with it, since interpolation mixed its pixels with black.
_MIXED_PX = 2


class Rectangle(NamedTuple):
    """A rectangle of an upright image, px."""

    left_px: int
    top_px: int
    width_px: int
    height_px: int


def inside_borders(image: NDArray[np.uint8]) -> Rectangle:
    """Return the rectangle of an image inside its black borders; the whole image if it has none.

    The image, (H, W, 3) uint8 RGB, loses the row or column of its blackest edge until no edge has more than a few black
    pixels.
    """
    height, width = image.shape[:2]
    whole = Rectangle(0, 0, width, height)
    if all((edge > _BLACK).any(axis=-1).all() for edge in (image[0], image[-1], image[:, 0], image[:, -1])):
        return whole
    border = _black_border(image.max(axis=2) <= _BLACK)
    # A border is at opposite edges or in two corners. A dark object in one corner is no border.
    top_edge, bottom_edge, left_edge, right_edge = (edge > _MOST_BLACK for edge in _edges(border))
    corners = border[[0, 0, -1, -1], [0, -1, 0, -1]].sum()
    if border.mean() < _LEAST_BORDER or not ((top_edge and bottom_edge) or (left_edge and right_edge) or corners >= 2):
        return whole
    top, bottom, left, right = 0, height, 0, width
    while (bottom - top) * (right - left) > _LEAST_INSIDE * height * width:
        edges = _edges(border[top:bottom, left:right])
        if max(edges) <= _MOST_BLACK:
            left, top = (start + _MIXED_PX * (start > 0) for start in (left, top))
            right, bottom = (end - _MIXED_PX * (end < side) for end, side in ((right, width), (bottom, height)))
            return Rectangle(left, top, right - left, bottom - top) if right > left and bottom > top else whole
        worst = int(np.argmax(edges))
        top, bottom, left, right = top + (worst == 0), bottom - (worst == 1), left + (worst == 2), right - (worst == 3)
    return whole


def _black_border(black: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pixels, (H, W), that are connected to an edge by black pixels of their row or column."""
    border = np.zeros_like(black)
    for axis in (0, 1):
        border |= np.logical_and.accumulate(black, axis=axis)
        border |= np.flip(np.logical_and.accumulate(np.flip(black, axis), axis=axis), axis)
    return border


def _edges(border: NDArray[np.bool_]) -> list[float]:
    """Return the share of True pixels along the top, bottom, left and right edge of a mask, (H, W)."""
    return [float(edge.mean()) for edge in (border[0], border[-1], border[:, 0], border[:, -1])]
