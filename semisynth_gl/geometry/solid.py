"""Which models are solid bodies: only the fronts of their triangles need be drawn."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.geometry.adjacency import welded
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.geometry.vectors import cross


def is_solid(mesh: Mesh) -> bool:
    """Whether a surface is closed, consistently wound, and every connected part of it is wound anticlockwise.

    For parts that do not turn inside out by crossing themselves this means that a ray from outside meets the front of a
    triangle first: every edge is passed as often in one direction as in the other, and every part encloses a positive
    volume.
    """
    vertex = welded(mesh)
    corners = vertex[mesh.triangles.astype(np.int64)]
    count = int(vertex.max()) + 1
    start, stop = corners.reshape(-1), np.roll(corners, -1, axis=1).reshape(-1)
    if not np.array_equal(np.sort(start * count + stop), np.sort(stop * count + start)):
        return False
    a, b, c = np.moveaxis(mesh.positions.astype(np.float64)[mesh.triangles], 1, 0)
    volumes = np.einsum("tk,tk->t", a, cross(b, c)) / 6
    part = _parts(start, stop, count)[corners[:, 0]]
    return bool((np.bincount(part, volumes)[np.unique(part)] > 0).all())


def marked_solid(mesh: Mesh) -> Mesh:
    """Return the mesh with ``solid`` set to what `is_solid` finds."""
    return replace(mesh, solid=is_solid(mesh))


def _parts(start: NDArray[np.int64], stop: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Least number of a vertex that each vertex is connected with."""
    label = np.arange(count)
    while True:
        lower = label.copy()
        np.minimum.at(lower, start, label[stop])
        lower = lower[lower]
        if np.array_equal(lower, label):
            return label
        label = lower
