"""The edges of a mesh, each with the triangles on both sides: seen from some places, a surface ends at them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.geometry.mesh import Mesh, cross
from semisynth_gl.geometry.topology import NO_NEIGHBOUR, neighbours


@dataclass(frozen=True, slots=True, eq=False)
class MeshEdges:
    """E edges, each with the triangles on its two sides; an edge at a border has the same triangle twice.

    Attributes:
        corners: (2, E, 3) uint32, for the triangle on each side: the vertices that the edge goes from and to, and the
            opposite vertex. Seen from outside of a solid, these corners of the first triangle run anticlockwise, those
            of the second triangle clockwise.
        plane: (2, 4, E) float32, the plane n . x = n . p of the triangle on each side: n = (to - from) x
            (opposite - from), and n . p with p = from.
        below: (2, E) bool, whether the opposite corner of the other side lies below this plane, where n . x < n . p.
        border: (E,) bool, whether the edge has only one triangle.
    """

    corners: NDArray[np.uint32]
    plane: NDArray[np.float32]
    below: NDArray[np.bool_]
    border: NDArray[np.bool_]


def find_edges(mesh: Mesh) -> MeshEdges:
    """Find the edges of a mesh; where more than two triangles share an edge, each of them has a border there."""
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
    # A neighbour of the same winding runs along the edge in the opposite direction.
    turned = (points[first[:, 0]] != points[second[:, 0]]).any(axis=1)
    second[turned] = second[turned][:, [1, 0, 2]]
    corners = np.stack([first, second])
    start, stop, opposite = np.moveaxis(points[corners], 2, 0)
    normal = cross(stop - start, opposite - start)
    at = (normal * start).sum(axis=-1)
    plane = np.concatenate([np.moveaxis(normal, -1, 1), at[:, None]], axis=1)
    below = (normal * opposite[::-1]).sum(axis=-1) < at
    return MeshEdges(corners, plane.astype(np.float32), below, border)
