"""Connections between triangles: vertices at equal positions, neighbours across edges, closed surfaces, edges.

trimesh has similar functions, but takes longer to load than everything else together.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.geometry.mesh import Mesh, cross

NO_NEIGHBOUR = 0xFFFFFFFF
"""Stands for the neighbour across an edge where a triangle has none."""


def neighbours(mesh: Mesh) -> NDArray[np.uint32]:
    """Find the triangle across each edge of each triangle; (T, 3) uint32.

    Column k has the number of the triangle across the edge from corner k to the next corner. It is `NO_NEIGHBOUR` at a
    border, and where more than two triangles share the edge.
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


def is_solid(mesh: Mesh) -> bool:
    """Return whether a surface is closed and all its connected parts are wound anticlockwise seen from outside.

    Triangles must pass every edge as often in one direction as in the other, and every connected part must enclose a
    positive volume. A ray from outside then meets the front of a triangle first, unless a part turns itself inside out
    by crossing itself.
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
    """Return the mesh with ``solid`` set to the answer of `is_solid`."""
    return replace(mesh, solid=is_solid(mesh))


def _edges(mesh: Mesh) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Return the first and last vertex of the three edges of each triangle in turn, (3 T,) each.

    The third result is the number of vertices. Vertices at equal positions count as one, since UV seams do not cut a
    surface.
    """
    # Adding 0 turns -0.0 into 0.0, whose bits differ.
    x, y, z = np.ascontiguousarray(mesh.positions + np.float32(0)).view(np.uint32).astype(np.uint64).T
    half = np.uint64(32)
    _, xy = np.unique(x << half | y, return_inverse=True)
    points, number = np.unique(xy.astype(np.uint64) << half | z, return_inverse=True)
    corners = number[mesh.triangles]
    return corners.reshape(-1), np.roll(corners, -1, axis=1).reshape(-1), len(points)
