"""Measures of meshes: stretch, topology, volume, crossings."""

import numpy as np
from trimesh import Trimesh
from trimesh.graph import connected_component_labels

from semisynth_gl.geometry.mesh import Mesh

# `project_uv` projects along the directions of a cube's faces, edges and corners. The worst normal is at equal angles
# to three neighbouring directions, the rows of F: it is parallel to x, where F x = (1, 1, 1). The cosine of that
# angle, 1 / |x|, is how much a projected length shrinks at most.
_FACE_EDGE_CORNER = np.array([[0, 0, 1], [0, 1, 1], [1, 1, 1]]) / np.sqrt([[1], [2], [3]])
STRETCH_BOUND = float(np.linalg.norm(np.linalg.solve(_FACE_EDGE_CORNER, np.ones(3))))
"""Largest ratio of a length on the surface to its length in UV, about 1.13; the smallest ratio is 1."""


def stretch(mesh: Mesh) -> np.ndarray:
    """Return how much UV stretches or squeezes each triangle in its worst direction, (T,); 1 is undistorted."""
    singular = np.linalg.svd(jacobians(mesh), compute_uv=False)
    return np.maximum(singular[:, 0], 1 / np.maximum(singular[:, 1], 1e-12))


def jacobians(mesh: Mesh) -> np.ndarray:
    """Return the derivatives of uv by position in each triangle's plane, (T, 2, 2), seen from the normal's side."""
    corners, uv = mesh.positions.astype(float)[mesh.triangles], mesh.uv.astype(float)[mesh.triangles]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    x = first / np.linalg.norm(first, axis=1, keepdims=True)
    normal = np.cross(first, second)
    y = np.cross(normal / np.linalg.norm(normal, axis=1, keepdims=True), x)
    flat = np.stack([[(edge * axis).sum(axis=1) for edge in (first, second)] for axis in (x, y)]).transpose(2, 0, 1)
    texture = np.stack([uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]], axis=2)
    return texture @ np.linalg.inv(flat)


def areas(mesh: Mesh) -> np.ndarray:
    return Trimesh(mesh.positions, mesh.triangles, process=False).area_faces


def surface(mesh: Mesh) -> Trimesh:
    """Merge vertices at the same position."""
    grid = np.round(mesh.positions.astype(float) / (1e-5 * np.abs(mesh.positions).max())).astype(np.int64)
    _, first, vertex = np.unique(grid, axis=0, return_index=True, return_inverse=True)
    return Trimesh(mesh.positions[first], vertex.ravel()[mesh.triangles], process=False)


def edge_balance(mesh: Mesh) -> int:
    """Count the edges whose triangles do not use both directions equally often; 0 for a closed, oriented surface."""
    bare = surface(mesh)
    sense = np.where(bare.edges[:, 0] < bare.edges[:, 1], 1, -1)
    return int((np.bincount(bare.edges_unique_inverse, sense) != 0).sum())


def edge_sharing(mesh: Mesh) -> np.ndarray:
    """Count the triangles at each edge, (E,); all 2 for a closed manifold surface."""
    return np.bincount(surface(mesh).edges_unique_inverse)


def euler_characteristic(mesh: Mesh) -> int:
    """Return vertices - edges + faces: 2 - 2 * handles for one closed surface."""
    return surface(mesh).euler_number


def volume(mesh: Mesh) -> float:
    """Return the volume inside a closed surface, positive if its normals point outwards."""
    return Trimesh(mesh.positions, mesh.triangles, process=False).volume


def components(mesh: Mesh) -> list[Mesh]:
    """Split a mesh into connected parts; vertices at the same position connect."""
    bare = surface(mesh)
    part = connected_component_labels(bare.edges)[bare.faces[:, 0]]
    return [Mesh(mesh.name, mesh.positions, mesh.uv, mesh.triangles[part == each]) for each in np.unique(part)]


def crossings(mesh: Mesh, origin: np.ndarray, direction: np.ndarray) -> int:
    """Count the triangles that a ray hits."""
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
