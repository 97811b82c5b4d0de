"""What tests measure of meshes, independently of how they were built."""

import numpy as np
from trimesh import Trimesh
from trimesh.graph import connected_component_labels

from semisynth_gl.geometry.mesh import Mesh

# The unit vector furthest from its nearest direction of projection is equally far from a face, an edge and a corner of
# a cube next to each other: it lies along x with F x = (1, 1, 1), where the rows of F are those three directions. A
# projected length shrinks at most by the cosine of its angle, 1 / |x|.
_FACE_EDGE_CORNER = np.array([[0, 0, 1], [0, 1, 1], [1, 1, 1]]) / np.sqrt([[1], [2], [3]])
STRETCH_BOUND = float(np.linalg.norm(np.linalg.solve(_FACE_EDGE_CORNER, np.ones(3))))
"""Largest ratio of a length on a surface to its length in the UV of `project_uv`, about 1.13; the smallest is 1."""


def stretch(mesh: Mesh) -> np.ndarray:
    """(T,) factor by which the texture is drawn out or squeezed in its worst direction; 1 where it lies true."""
    singular = np.linalg.svd(jacobians(mesh), compute_uv=False)
    return np.maximum(singular[:, 0], 1 / np.maximum(singular[:, 1], 1e-12))


def jacobians(mesh: Mesh) -> np.ndarray:
    """(T, 2, 2) derivatives of uv by position in each triangle's own plane, its normal upwards."""
    corners, uv = mesh.positions.astype(float)[mesh.triangles], mesh.uv.astype(float)[mesh.triangles]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    x = first / np.linalg.norm(first, axis=1, keepdims=True)
    normal = np.cross(first, second)
    y = np.cross(normal / np.linalg.norm(normal, axis=1, keepdims=True), x)
    flat = np.stack([[(edge * axis).sum(axis=1) for edge in (first, second)] for axis in (x, y)]).transpose(2, 0, 1)
    texture = np.stack([uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]], axis=2)
    return texture @ np.linalg.inv(flat)


def areas(mesh: Mesh) -> np.ndarray:
    """(T,) areas of the triangles."""
    return Trimesh(mesh.positions, mesh.triangles, process=False).area_faces


def surface(mesh: Mesh) -> Trimesh:
    """The surface alone: vertices whose positions are equal are one."""
    grid = np.round(mesh.positions.astype(float) / (1e-5 * np.abs(mesh.positions).max())).astype(np.int64)
    _, first, vertex = np.unique(grid, axis=0, return_index=True, return_inverse=True)
    return Trimesh(mesh.positions[first], vertex.ravel()[mesh.triangles], process=False)


def edge_balance(mesh: Mesh) -> int:
    """How many edges are not run through as often in one sense as in the other; 0 for a closed, oriented surface."""
    bare = surface(mesh)
    sense = np.where(bare.edges[:, 0] < bare.edges[:, 1], 1, -1)
    return int((np.bincount(bare.edges_unique_inverse, sense) != 0).sum())


def edge_sharing(mesh: Mesh) -> np.ndarray:
    """(E,) how many triangles share each edge; 2 of all edges for a closed surface without pinches."""
    return np.bincount(surface(mesh).edges_unique_inverse)


def euler_characteristic(mesh: Mesh) -> int:
    """Vertices - edges + faces; 2 - 2 * handles for one closed surface."""
    return surface(mesh).euler_number


def volume(mesh: Mesh) -> float:
    """Volume inside a closed surface, positive where its normals point outwards."""
    return Trimesh(mesh.positions, mesh.triangles, process=False).volume


def components(mesh: Mesh) -> list[Mesh]:
    """Connected parts, by position."""
    bare = surface(mesh)
    part = connected_component_labels(bare.edges)[bare.faces[:, 0]]
    return [Mesh(mesh.name, mesh.positions, mesh.uv, mesh.triangles[part == each]) for each in np.unique(part)]


def crossings(mesh: Mesh, origin: np.ndarray, direction: np.ndarray) -> int:
    """How many triangles a ray meets."""
    corners = mesh.positions.astype(float)[mesh.triangles]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(direction, second)
    determinant = (first * across).sum(axis=1)
    determinant[determinant == 0] = np.nan
    away = origin - corners[:, 0]
    a = (away * across).sum(axis=1) / determinant
    turned = np.cross(away, first)
    b = turned @ direction / determinant
    distance = (second * turned).sum(axis=1) / determinant
    return int(((a >= 0) & (b >= 0) & (a + b <= 1) & (distance > 0)).sum())
