"""How triangles are connected: neighbours across edges, edges, and whether a surface is closed.

trimesh has similar functions, but takes longer to load than the rest of the program.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.geometry.mesh import Mesh, cross

NO_NEIGHBOUR = 0xFFFFFFFF
"""Entry of `neighbours` for an edge without a neighbour."""


def neighbours(mesh: Mesh) -> NDArray[np.uint32]:
    """Return the index of the neighbouring triangle across each edge of each triangle; (T, 3) uint32.

    Column k is for the edge from corner k to the next corner. The entry is `NO_NEIGHBOUR` at a border, and if more than
    two triangles share the edge.
    """
    start, stop, count = _edges(mesh)
    edge = np.minimum(start, stop) * count + np.maximum(start, stop)
    by_edge = np.argsort(edge, kind="stable")
    first = np.flatnonzero(np.r_[True, np.diff(edge[by_edge]) != 0])
    sharing = np.diff(np.r_[first, len(by_edge)])
    pairs = by_edge[first[sharing == 2][:, None] + [0, 1]]
    result = np.full(len(edge), NO_NEIGHBOUR, np.uint32)
    result[pairs] = pairs[:, ::-1] // 3
    return result.reshape(-1, 3)


@dataclass(frozen=True, slots=True, eq=False)
class MeshEdges:
    """E edges with two adjacent triangles each; an edge at a border has the same triangle twice.

    Attributes:
        corners: (2, E, 3) uint32, for both triangles: start and end of the edge, and the opposite vertex. Seen from
            outside of a solid, they run anticlockwise in the first triangle, and clockwise in the second triangle.
        plane: (2, 4, E) float32, n and n . p of the plane n . x = n . p through the triangle, where
            n = (end - start) x (opposite - start) and p = start.
        below: (2, E) bool, whether the opposite vertex of the second triangle has n . x < n . p for the plane of the
            first triangle; and the reverse.
        border: (E,) bool, whether the edge has only one triangle.
    """

    corners: NDArray[np.uint32]
    plane: NDArray[np.float32]
    below: NDArray[np.bool_]
    border: NDArray[np.bool_]


def find_edges(mesh: Mesh) -> MeshEdges:
    """Find the edges of a mesh. An edge of n > 2 triangles occurs n times, as a border of one triangle each."""
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
    # A neighbour with the same winding has the edge in the opposite direction.
    is_reversed = (points[first[:, 0]] != points[second[:, 0]]).any(axis=1)
    second[is_reversed] = second[is_reversed][:, [1, 0, 2]]
    corners = np.stack([first, second])
    start, stop, opposite = np.moveaxis(points[corners], 2, 0)
    normal = cross(stop - start, opposite - start)
    at = (normal * start).sum(axis=-1)
    plane = np.concatenate([np.moveaxis(normal, -1, 1), at[:, None]], axis=1)
    below = (normal * opposite[::-1]).sum(axis=-1) < at
    return MeshEdges(corners, plane.astype(np.float32), below, border)


def is_solid(mesh: Mesh) -> bool:
    """Return whether a surface is closed, and all its triangles are anticlockwise seen from outside.

    Every edge must occur as often in one direction as in the other, and every connected part must enclose a positive
    volume. The first triangle that a ray from outside meets then shows its front, unless a part crosses itself.
    """
    from scipy.sparse import coo_array  # noqa: PLC0415 - slow to load, and most processes take models from the cache
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415

    start, stop, count = _edges(mesh)
    if not np.array_equal(np.sort(start * count + stop), np.sort(stop * count + start)):
        return False
    a, b, c = np.moveaxis(mesh.positions.astype(np.float64)[mesh.triangles], 1, 0)
    volumes = np.einsum("tk,tk->t", a, cross(b, c)) / 6
    edges = coo_array((np.ones(len(start)), (start, stop)), (count, count))
    part = connected_components(edges, directed=False)[1][start[::3]]
    return bool((np.bincount(part, volumes)[np.unique(part)] > 0).all())


def marked_solid(mesh: Mesh) -> Mesh:
    """Return the mesh with ``solid`` set to the result of `is_solid`."""
    return replace(mesh, solid=is_solid(mesh))


def _edges(mesh: Mesh) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Return the start and the end of the three edges of each triangle in turn, (3 T,) each, and the number of points.

    Vertices at equal positions are one point, since UV seams do not cut a surface.
    """
    # The 12 bytes of a position identify it. Adding 0 turns -0.0 into 0.0, whose bytes differ.
    positions = np.ascontiguousarray(mesh.positions + np.float32(0)).view("V12").ravel()
    points, number = np.unique(positions, return_inverse=True)
    corners = number[mesh.triangles]
    return corners.reshape(-1), np.roll(corners, -1, axis=1).reshape(-1), len(points)
