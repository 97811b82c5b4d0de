"""Which triangles share an edge: what following a surface to its silhouette needs."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.geometry.mesh import Mesh

NO_NEIGHBOUR = 0xFFFFFFFF


def welded(mesh: Mesh) -> NDArray[np.int64]:
    """Number vertices so that those of equal positions, to the bit, have one number: UV seams do not cut a surface.

    Returns:
        (V,) int64, from 0 without gaps.
    """
    # Adding 0 turns -0.0 into 0.0, whose bits differ.
    bits = np.ascontiguousarray(mesh.positions + np.float32(0)).view(np.uint32).astype(np.uint64)
    key = bits[:, 0] | (bits[:, 1] << np.uint64(32))
    order = np.lexsort((bits[:, 2], key))
    sorted_key, sorted_z = key[order], bits[order, 2]
    begins = np.ones(len(order), bool)
    begins[1:] = (sorted_key[1:] != sorted_key[:-1]) | (sorted_z[1:] != sorted_z[:-1])
    numbers = np.empty(len(order), np.int64)
    numbers[order] = np.cumsum(begins) - 1
    return numbers


def neighbours(mesh: Mesh) -> NDArray[np.uint32]:
    """Find the triangle across each edge.

    Vertices are the same where `welded` says so.

    Returns:
        (T, 3) uint32; entry k is the triangle across the edge from corner k to corner k + 1, or `NO_NEIGHBOUR` at a
        border and where more than two triangles meet.
    """
    vertex = welded(mesh)
    corners = vertex[mesh.triangles.astype(np.int64)]
    start, stop = corners.reshape(-1), np.roll(corners, -1, axis=1).reshape(-1)
    edge = np.minimum(start, stop) * (int(vertex.max()) + 1) + np.maximum(start, stop)
    by_edge = np.argsort(edge, kind="stable")
    first = np.flatnonzero(np.r_[True, np.diff(edge[by_edge]) != 0])
    count = np.diff(np.r_[first, len(by_edge)])
    pairs = first[count == 2]
    one, two = by_edge[pairs], by_edge[pairs + 1]
    result = np.full(len(edge), NO_NEIGHBOUR, np.uint32)
    result[one], result[two] = two // 3, one // 3
    return result.reshape(-1, 3)
