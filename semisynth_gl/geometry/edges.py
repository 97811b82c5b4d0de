"""The edges of a mesh, each with the triangles on both its sides: where a surface may end, seen from somewhere."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.geometry.mesh import Mesh, cross
from semisynth_gl.geometry.topology import NO_NEIGHBOUR, neighbours


@dataclass(frozen=True, slots=True, eq=False)
class MeshEdges:
    """E edges between two triangles, or at a border with the same triangle twice.

    Attributes:
        corners: (2, E, 3) uint32, for the triangle on each side: the vertices that the edge goes from and to, and the
            one opposite. Seen from outside of a solid, the first triangle runs through them anticlockwise and the
            second one clockwise.
        plane: (2, 4, E) float32, n and n . p of each triangle's plane, with n = (to - from) x (opposite - from).
        below: (2, E) bool, the other side's opposite corner lies where n . x < n . p.
        border: (E,) bool.
    """

    corners: NDArray[np.uint32]
    plane: NDArray[np.float32]
    below: NDArray[np.bool_]
    border: NDArray[np.bool_]


def find_edges(mesh: Mesh) -> MeshEdges:
    """Find the edges of a mesh; where more than two triangles meet, each has a border."""
    triangles, across = mesh.triangles, neighbours(mesh)
    own, side = (index.ravel() for index in np.indices(across.shape))
    other = across.ravel().astype(np.int64)
    border = other == NO_NEIGHBOUR
    once = border | (own < other)
    own, side, other, border = own[once], side[once], other[once], border[once]
    other = np.where(border, own, other)
    other_side = np.where(border, side, (across[other] == own[:, None]).argmax(axis=1))
    sides = ((own, side), (other, other_side))
    first, second = (triangles[number[:, None], (begin[:, None] + np.arange(3)) % 3] for number, begin in sides)
    points = mesh.positions.astype(np.float64)
    # A neighbour that is wound alike runs along the edge the other way.
    turned = (points[first[:, 0]] != points[second[:, 0]]).any(axis=1)
    second[turned] = second[turned][:, [1, 0, 2]]
    corners = np.stack([first, second])
    start, stop, opposite = np.moveaxis(points[corners], 2, 0)
    normal = cross(stop - start, opposite - start)
    at = (normal * start).sum(axis=-1)
    plane = np.concatenate([np.moveaxis(normal, -1, 1), at[:, None]], axis=1)
    below = (normal * opposite[::-1]).sum(axis=-1) < at
    return MeshEdges(corners, plane.astype(np.float32), below, border)
