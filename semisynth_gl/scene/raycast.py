"""A float64 ray caster in plain numpy: the scene sampler measures visible surfaces with it, and the oracle judges.

The caster shares nothing with `semisynth_gl.render` but the scene's arrays: rays come from the camera's intrinsics,
triangles from the models' vertices (float32 as the renderer has them) placed in float64. It is slow on purpose.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.camera import Eye, StereoCamera
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.scene.scene import Scene

# Rays are compared with triangles' bounding boxes this many comparisons at a time, to bound memory.
_COMPARISONS = 4_000_000
# Bounding boxes are wider by this margin, so that rounding of the projection never loses a ray on an edge.
_BOX_MARGIN_PX = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """The first surfaces that R rays hit.

    Attributes:
        depth_m: (R,) float64 planar depth; inf where a ray hits nothing.
        instance: (R,) int64, -1 where a ray hits nothing.
        triangle: (R,) int64, index into the instance's model.
    """

    depth_m: NDArray[np.float64]
    instance: NDArray[np.int64]
    triangle: NDArray[np.int64]


def cast_rays(
    scene: Scene, models: Sequence[Mesh], eye: Eye, x_px: NDArray[np.float64], y_px: NDArray[np.float64]
) -> Hits:
    """Cast rays from one eye through pixel positions, whole or fractional.

    Of surfaces at one depth, the first instance and triangle wins. Rays pass through surfaces nearer than
    ``scene.near_m``, which the renderer does not draw.

    Args:
        scene: the instances and the camera.
        models: the meshes, in the order of the indices in ``scene.model``.
        eye: "left" or "right".
        x_px: (R,) float64, columns of the positions; pixel centres are whole numbers.
        y_px: (R,) float64, rows of the positions.

    Returns:
        The R hits.
    """
    camera = scene.camera
    x, y = np.asarray(x_px, np.float64).ravel(), np.asarray(y_px, np.float64).ravel()
    rays = camera.rays(eye, x, y)
    hits = Hits(np.full(len(x), np.inf), np.full(len(x), -1), np.full(len(x), -1))
    for number in range(len(scene)):
        mesh = models[int(scene.model[number])]
        view_from_model = scene.camera_from_world @ scene.world_from_model[number]
        vertices = mesh.positions.astype(np.float64) @ view_from_model[:3, :3].T + view_from_model[:3, 3]
        vertices[:, 0] -= camera.offset_m(eye)
        corners = vertices[mesh.triangles]
        x0, x1, y0, y1 = _boxes(camera, eye, corners, scene.near_m).T
        candidates = np.flatnonzero((x >= x0.min()) & (x <= x1.max()) & (y >= y0.min()) & (y <= y1.max()))
        for part in np.array_split(candidates, max(1, len(candidates) * len(corners) // _COMPARISONS)):
            column, row = x[part, None], y[part, None]
            ray, triangle = np.nonzero((column >= x0) & (column <= x1) & (row >= y0) & (row <= y1))
            ray = part[ray]
            depth_m = _depths(rays[ray], corners[triangle], scene.near_m)
            order = np.flatnonzero(np.isfinite(depth_m))
            # Ascending depth with the lowest triangle first, then the first of each ray.
            order = order[np.lexsort((triangle[order], depth_m[order], ray[order]))]
            order = order[np.unique(ray[order], return_index=True)[1]]
            nearer = order[depth_m[order] < hits.depth_m[ray[order]]]
            hits.depth_m[ray[nearer]] = depth_m[nearer]
            hits.instance[ray[nearer]] = number
            hits.triangle[ray[nearer]] = triangle[nearer]
    return hits


def _boxes(camera: StereoCamera, eye: Eye, corners: NDArray[np.float64], near_m: float) -> NDArray[np.float64]:
    """Return bounding boxes (T, 4), x0 x1 y0 y1, of triangles on the image; all of its plane for a crossed z = near."""
    depth = corners[:, :, 2]
    safe = np.where(depth > 0, depth, 1.0)
    x = camera.focal_px * corners[:, :, 0] / safe + camera.cx_px(eye)
    y = camera.focal_px * corners[:, :, 1] / safe + camera.cy_px
    boxes = np.stack([x.min(axis=1), x.max(axis=1), y.min(axis=1), y.max(axis=1)], axis=1)
    boxes += np.array([-1, 1, -1, 1]) * _BOX_MARGIN_PX
    boxes[(depth < near_m).any(axis=1)] = -np.inf, np.inf, -np.inf, np.inf
    boxes[(depth < near_m).all(axis=1)] = np.inf, -np.inf, np.inf, -np.inf
    return boxes


def _depths(direction: NDArray[np.float64], corners: NDArray[np.float64], near_m: float) -> NDArray[np.float64]:
    """Return the depths at which rays hit their triangles (Moller and Trumbore 1997), inf where a ray misses.

    Directions have z = 1, so the ray's parameter is the planar depth.
    """
    edge_1, edge_2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(direction, edge_2)
    determinant = (edge_1 * p).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / determinant
        from_corner = -corners[:, 0]
        u = (from_corner * p).sum(axis=1) * inverse
        q = np.cross(from_corner, edge_1)
        v = (direction * q).sum(axis=1) * inverse
        depth = (edge_2 * q).sum(axis=1) * inverse
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (depth >= near_m)
    return np.where(hit, depth, np.inf)
