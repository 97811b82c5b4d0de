"""The black borders of rectified photographs: pixels whose place in the raw photograph lay outside it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

# JPEG turns black into levels up to this one.
_BLACK = 3
# Black at an edge is a border if it covers at least `_LEAST` of a photograph and leaves at least `_LEAST_INSIDE`; else
# it is a dark object.
_LEAST, _LEAST_INSIDE = 1e-3, 0.5
# `_EDGE`: largest share of black pixels along an edge of the inside. `_MIXED_PX`: pixels beside a border that are cut
# off too, since interpolation mixed them with black.
_EDGE, _MIXED_PX = 0.005, 2
# Fewest black corners of an image with a border that lies on no two opposite edges.
_CORNERS = 2


class Inside(NamedTuple):
    """A rectangle of an upright image, px."""

    left_px: int
    top_px: int
    width_px: int
    height_px: int


def black_border(image: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return where an image is black from its edge on, along its row or its column.

    Args:
        image: (H, W, 3) RGB or (H, W) grey, uint8.

    Returns:
        (H, W) bool.
    """
    border = np.zeros(image.shape[:2], np.bool_)
    if not any(_is_black(edge).any() for edge in (image[:1], image[-1:], image[:, :1], image[:, -1:])):
        return border
    black = _is_black(image)
    for axis in (0, 1):
        border |= np.logical_and.accumulate(black, axis=axis)
        border |= np.flip(np.logical_and.accumulate(np.flip(black, axis), axis=axis), axis)
    return border


def inside_borders(image: NDArray[np.uint8]) -> Inside:
    """Return the rectangle of an image inside its black borders; the whole image where it has none.

    Edges are moved inwards, the blackest first, until each has next to nothing black.

    Args:
        image: (H, W, 3) RGB or (H, W) grey, uint8.
    """
    border = black_border(image)
    height, width = border.shape
    whole = Inside(0, 0, width, height)
    if border.mean() < _LEAST or not _is_of_rectification(border):
        return whole
    top, bottom, left, right = 0, height, 0, width
    while (bottom - top) * (right - left) > _LEAST_INSIDE * height * width:
        part = border[top:bottom, left:right]
        edges = [float(edge.mean()) for edge in (part[0], part[-1], part[:, 0], part[:, -1])]
        if max(edges) <= _EDGE:
            left, top = (start + _MIXED_PX * (start > 0) for start in (left, top))
            right, bottom = (end - _MIXED_PX * (end < side) for end, side in ((right, width), (bottom, height)))
            return Inside(left, top, right - left, bottom - top) if right > left and bottom > top else whole
        worst = int(np.argmax(edges))
        top, bottom, left, right = top + (worst == 0), bottom - (worst == 1), left + (worst == 2), right - (worst == 3)
    return whole


def _is_of_rectification(border: NDArray[np.bool_]) -> bool:
    """Return whether a border lies on opposite edges or takes two corners: a dark thing in one corner does neither."""
    top, bottom, left, right = (
        float(edge.mean()) > _EDGE for edge in (border[0], border[-1], border[:, 0], border[:, -1])
    )
    corners = int(border[[0, 0, -1, -1], [0, -1, 0, -1]].sum())
    return (top and bottom) or (left and right) or corners >= _CORNERS


def _is_black(image: NDArray[np.uint8]) -> NDArray[np.bool_]:
    levels: NDArray[np.uint8] = image if image.ndim == 2 else image.max(axis=2)
    return levels <= _BLACK
