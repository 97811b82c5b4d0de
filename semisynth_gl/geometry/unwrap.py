"""UV for models without a UV map: every triangle is projected along the nearest of 26 fixed directions."""

import itertools
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from semisynth_gl.geometry.mesh import Floats, Mesh, cross, face_normals, lengths, make_part


def facing_axes(normals: Floats) -> tuple[Floats, Floats]:
    """Return the texture's u and v axes on planes with unit normals, (N, 3); (N, 3) unit vectors each.

    Seen from outside, u points to the right and v downwards: towards -z, or towards -y on planes that face along z. So
    u, -v and the normal are right-handed.
    """
    upright = np.abs(normals[:, 2:]) < 1 - 1e-9
    up = np.where(upright, [0.0, 0.0, 1.0], [0.0, 1.0, 0.0])
    u = cross(up, normals)
    u /= lengths(u)[:, None]
    return u, -cross(normals, u)


_STEPS = np.array([step for step in itertools.product((-1, 0, 1), repeat=3) if any(step)], np.float64)
DIRECTIONS: Final = _STEPS / lengths(_STEPS)[:, None]
"""(26, 3) unit vectors of projection, from a cube's centre to its 6 faces, 12 edges and 8 corners."""


def project_uv(name: str, positions: ArrayLike, triangles: ArrayLike) -> Mesh:
    """Make a mesh with UV in model units from positions, (V, 3), and triangles, (T, 3) indices.

    A length on the surface is 1 to 1.13 times its length in UV. If the triangles at a vertex are projected along
    several directions, the mesh has the vertex once per direction.
    """
    points, index = np.asarray(positions, np.float64), np.asarray(triangles, np.int64)
    # einsum, since the rounding of BLAS depends on the machine and could choose a different one of two near directions.
    direction = np.argmax(np.einsum("ti,di->td", face_normals(points[index]), DIRECTIONS), axis=1)
    # Each pair of a vertex and a direction becomes a vertex of the mesh.
    unique, renumbered = np.unique(index * len(DIRECTIONS) + direction[:, None], return_inverse=True)
    vertex, chart = np.divmod(unique, len(DIRECTIONS))
    u, v = facing_axes(DIRECTIONS)
    uv = np.stack([(points[vertex] * axis[chart]).sum(axis=1) for axis in (u, v)], axis=1)
    return make_part(name, points[vertex], uv, renumbered.reshape(-1, 3))
