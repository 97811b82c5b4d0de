"""What lies below a place: the surface that a thing can stand on."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.geometry.cells import covered_cells
from semisynth_gl.geometry.mesh import cross, lengths

Floats = NDArray[np.float64]


class Support(NamedTuple):
    """A place on a surface.

    Attributes:
        height: its third coordinate.
        normal: (3,) float64, unit, upwards.
    """

    height: float
    normal: Floats


def surface_below(corners: Floats, x: float, y: float, height: float = np.inf) -> Support | None:
    """Find the highest surface at a place that is not above a height; None where there is none.

    Args:
        corners: (T, 3, 3) float64, corners of triangles in a frame whose z points up.
        x: the place.
        y: the same.
        height: the height.
    """
    numbers = np.arange(3 * len(corners)).reshape(-1, 3).T
    triangle, _, u, v = covered_cells(corners[..., 0].ravel() - x, corners[..., 1].ravel() - y, numbers, 1, 1)
    hit = corners[triangle]
    first, second = hit[:, 1] - hit[:, 0], hit[:, 2] - hit[:, 0]
    heights = hit[:, 0, 2] + u * first[:, 2] + v * second[:, 2]
    below = np.flatnonzero(heights <= height)
    if not below.size:
        return None
    highest = below[heights[below].argmax()]
    normal = cross(first[highest : highest + 1], second[highest : highest + 1])[0]
    return Support(float(heights[highest]), normal * (np.sign(normal[2]) / lengths(normal)))
