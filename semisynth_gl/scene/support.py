"""The surface below a place, on which a thing can stand."""

from typing import NamedTuple

import numpy as np

from semisynth_gl.geometry.mesh import cross, lengths
from semisynth_gl.scene import Floats, Ints


class Support(NamedTuple):
    """A place on a surface."""

    height: float  # z of the place
    normal: Floats  # (3,) the surface's unit normal, upwards


def surfaces_below(corners: Floats, places: Floats) -> list[Support | None]:
    """Find, for each place (P, 3), the nearest of triangles (T, 3, 3) below it; None where there is none.

    Places and triangles are in a frame whose z points up. A place with z = inf finds the highest triangle of all.
    """
    place, triangle = _pairs_over(corners[..., :2], places[:, :2])
    first = corners[triangle, 0]
    edge_1, edge_2 = corners[triangle, 1] - first, corners[triangle, 2] - first
    # Seen from above with the place as the origin: u and v say how far it lies along both edges, in their lengths.
    seen = corners[triangle, :, :2] - places[place, None, :2]
    (from_x, from_y), (x_1, y_1), (x_2, y_2) = seen[:, 0].T, (seen[:, 1] - seen[:, 0]).T, (seen[:, 2] - seen[:, 0]).T
    area = x_1 * y_2 - y_1 * x_2
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (from_y * x_2 - from_x * y_2) / area
        v = (from_x * y_1 - from_y * x_1) / area
        height = first[:, 2] + u * edge_1[:, 2] + v * edge_2[:, 2]
        found = np.flatnonzero((u >= 0) & (v >= 0) & (u + v <= 1) & (height <= places[place, 2]))
    # The highest triangle of each place comes first.
    found = found[np.lexsort((-height[found], place[found]))]
    reached, number = np.unique(place[found], return_index=True)
    highest = found[number]
    normals = cross(edge_1[highest], edge_2[highest])
    normals *= (np.sign(normals[:, 2]) / lengths(normals))[:, None]
    supports: list[Support | None] = [None] * len(places)
    for at, z, normal in zip(reached.tolist(), height[highest].tolist(), normals, strict=True):
        supports[at] = Support(z, normal)
    return supports


def _pairs_over(corners: Floats, places: Floats) -> tuple[Ints, Ints]:
    """Return all pairs of a place (P, 2) and a triangle (T, 3, 2) whose bounding box holds it, as arrays of numbers."""
    (low_x, low_y), (high_x, high_y) = corners.min(axis=1).T.copy(), corners.max(axis=1).T.copy()
    held = []
    for x, y in places.tolist():
        column = np.flatnonzero((low_x <= x) & (x <= high_x))
        held.append(column[(low_y[column] <= y) & (y <= high_y[column])])
    place = np.repeat(np.arange(len(places)), [len(numbers) for numbers in held])
    return place, np.concatenate([np.empty(0, np.int64), *held])
