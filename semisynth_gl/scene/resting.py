"""Finds the surface below a point, and lowers resting particles onto surfaces."""

from collections.abc import Sequence

import numpy as np

from semisynth_gl.geometry.mesh import Mesh, cross, least_aligned_axis, lengths
from semisynth_gl.scene import Floats, Ints
from semisynth_gl.scene.scene import transform_vertices

# Cosine of the steepest slope on which a model comes to rest.
_STEEPEST = 0.5


def surfaces_below(corners: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Find the nearest triangle below each point.

    Points (P, 3) and the corners of triangles (T, 3, 3) are in a frame whose z points up. For a point with z = inf, the
    highest triangle is found.

    Returns:
        The height of the surface below each point, (P,), and the surface's upward unit normal, (P, 3); both are 0 where
        no triangle is below the point.
    """
    point, triangle = _pairs_over(corners[..., :2], points[:, :2])
    first = corners[triangle, 0]
    edge_1, edge_2 = corners[triangle, 1] - first, corners[triangle, 2] - first
    # From above, the point is at  first + u * edge_1 + v * edge_2.  (from_x, from_y) leads from the point to `first`.
    flat = corners[triangle, :, :2] - points[point, None, :2]
    (from_x, from_y), (x_1, y_1), (x_2, y_2) = flat[:, 0].T, (flat[:, 1] - flat[:, 0]).T, (flat[:, 2] - flat[:, 0]).T
    area = x_1 * y_2 - y_1 * x_2
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (from_y * x_2 - from_x * y_2) / area
        v = (from_x * y_1 - from_y * x_1) / area
        height = first[:, 2] + u * edge_1[:, 2] + v * edge_2[:, 2]
        found = np.flatnonzero((u >= 0) & (v >= 0) & (u + v <= 1) & (height <= points[point, 2]))
    # Sort so that the highest triangle of each point comes first.
    found = found[np.lexsort((-height[found], point[found]))]
    reached, number = np.unique(point[found], return_index=True)
    highest = found[number]
    up = cross(edge_1[highest], edge_2[highest])
    up *= (np.sign(up[:, 2]) / lengths(up))[:, None]
    heights, normals = np.zeros(len(points)), np.zeros((len(points), 3))
    heights[reached], normals[reached] = height[highest], up
    return heights, normals


def _pairs_over(corners: Floats, points: Floats) -> tuple[Ints, Ints]:
    """Return all pairs of a point (P, 2) and a triangle (T, 3, 2) whose bounding box contains it, as index arrays."""
    (low_x, low_y), (high_x, high_y) = corners.min(axis=1).T.copy(), corners.max(axis=1).T.copy()
    found = []
    for x, y in points.tolist():
        column = np.flatnonzero((low_x <= x) & (x <= high_x))
        found.append(column[(low_y[column] <= y) & (y <= high_y[column])])
    point = np.repeat(np.arange(len(points)), [len(numbers) for numbers in found])
    return point, np.concatenate([np.empty(0, np.int64), *found])


def triangles_of(models: Sequence[Mesh], model: Ints, poses: Floats) -> Floats:
    """Return the corners (T, 3, 3) of all triangles of N instances, given their models (N,) and poses (N, 4, 4)."""
    meshes = [models[number] for number in model.tolist()]
    parts = [transform_vertices(mesh, pose)[mesh.triangles] for mesh, pose in zip(meshes, poses, strict=True)]
    return np.concatenate([np.empty((0, 3, 3)), *parts])


def come_to_rest(poses: Floats, meshes: Sequence[Mesh], corners: Floats, up: Floats) -> dict[int, Floats]:
    """Lower P particles onto the surfaces below them.

    A particle keeps its rotation, and moves until it touches the plane of the surface below its centre. A particle with
    no surface below its centre, or with a slope of more than 60 degrees there, does not come to rest.

    ``poses`` (P, 4, 4) are world_from_model of the ``meshes``. The ``corners`` (T, 3, 3) of triangles that may carry
    particles, and the unit vector ``up`` (3,), are in the world's frame. Returns the poses (4, 4) of the particles that
    come to rest, by their number.
    """
    aside = np.cross(up, least_aligned_axis(up))
    aside /= np.linalg.norm(aside)
    upright_from_world = np.stack([aside, np.cross(up, aside), up])
    centres = np.array([upright_from_world @ pose[:3, 3] for pose in poses]).reshape(-1, 3)
    heights, normals = surfaces_below(corners @ upright_from_world.T, centres)
    rested = dict[int, Floats]()
    for number in np.flatnonzero(normals[:, 2] >= _STEEPEST).tolist():
        pose, normal = poses[number].copy(), upright_from_world.T @ normals[number]
        lowest = float((meshes[number].positions.astype(np.float64) @ pose[:3, :3].T @ normal).min())
        pose[:3, 3] = upright_from_world.T @ (*centres[number, :2], heights[number]) - lowest * normal
        rested[number] = pose
    return rested
