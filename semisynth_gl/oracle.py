"""The oracle: disparity, normals and flow at the hits of float64 rays, with which the renderer's output is compared.

Callers cast the rays by `semisynth_gl.scene.raycast`, which neither the scene sampler nor the renderer uses. In all
functions, ``hits`` are the R hits of one eye's rays through the pixel positions ``x_px`` and ``y_px`` (R,).
``models`` are the meshes that ``scene.model`` indexes. ``signed`` allows disparities of 0 and below.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from semisynth_gl.frame.camera import Eye, StereoCamera
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.scene import Floats, Ints
from semisynth_gl.scene.raycast import RayHits, vertices_in_view
from semisynth_gl.scene.scene import Scene, SceneMotion


def correspondence_px(
    camera: StereoCamera, eye: Eye, x_px: Floats, y_px: Floats, hits: RayHits, *, signed: bool = False
) -> Floats:
    """Return the displacement from each ray's pixel position to the position at which the other eye would see the hit.

    The displacements are (R, 2) float64 px, right and down; inf where nothing is hit, or the disparity is not valid.
    """
    found = camera.correspondence(eye, np.asarray(x_px, np.float64), np.asarray(y_px, np.float64), hits.depth_m)
    disparity = found[:, 0] * (-1 if eye == "left" else 1)
    valid = (hits.instance >= 0) & (disparity > (-np.inf if signed else 0.0))
    return np.where(valid[:, None], found, np.inf)


def disparity_of(eye: Eye, correspondence: Floats) -> Floats:
    """Return the disparities x_left - x_right, (R,), from `correspondence_px`; inf where it is inf."""
    x = correspondence[:, 0]
    return x if eye == "right" else np.where(np.isinf(x), np.inf, -x)


def flow(
    scene: Scene,
    models: Sequence[Mesh],
    motion: SceneMotion,
    eye: Eye,
    x_px: Floats,
    y_px: Floats,
    hits: RayHits,
    *,
    signed: bool = False,
) -> tuple[Floats, Floats, Floats]:
    """Follow the points that one eye's rays hit to the target time of a motion; each point moves with its instance.

    The camera's translation does not move the sky.

    Returns:
        The flow, (R, 2) float64 px, x right and y down; inf where there is no hit, or where the point is nearer than
        the near plane at the target time. The change of disparity in rectified pairs, (R,) float64 px; inf where the
        flow is inf, or the disparity is not valid at both times. The depths at the target time, (R,) float64 m; inf in
        the sky.
    """
    camera = scene.camera
    x, y = np.asarray(x_px, np.float64), np.asarray(y_px, np.float64)
    later, depth_m = np.full((len(x), 3), np.inf), hits.depth_m
    is_sky = np.isin(hits.instance, np.flatnonzero(scene.sky))
    if is_sky.any():
        # A point of the instance represents the sky in its direction.
        depth_m = np.where(is_sky, depth_on_planes(scene, models, eye, x, y, hits), depth_m)
    then = replace(scene, camera_from_world=motion.scene.camera_from_world, world_from_model=motion.world_from_model)
    # Rays without a hit get the depth 0, since the product with inf would be NaN.
    points = camera.rays_of_eye(eye, x, y) * np.where(np.isfinite(depth_m), depth_m, 0.0)[:, None]
    both = zip(_triangles_hit(scene, models, eye, hits), _triangles_hit(then, models, eye, hits), strict=True)
    for (rays, corners, normal), (_, moved, _) in both:
        # Points keep their barycentric coordinates in the moved triangles. The instance's matrix cannot be inverted if
        # the model is flat.
        across, area = points[rays] - corners[:, 0], (normal**2).sum(axis=1)
        edge_1, edge_2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        second = (np.cross(across, edge_2) * normal).sum(axis=1) / area
        third = (np.cross(edge_1, across) * normal).sum(axis=1) / area
        weights = np.stack([1 - second - third, second, third], axis=1)
        later[rays] = (weights[:, :, None] * moved).sum(axis=1)
    cx, cy, *focal = camera.intrinsics_px(eye)
    with np.errstate(invalid="ignore"):
        least_m = np.where(is_sky, np.finfo(np.float64).tiny, scene.near_of(eye))
        seen = np.isfinite(later[:, 2]) & (later[:, 2] >= least_m)
        position = np.array(focal) * later[:, :2] / later[:, 2:] + (cx, cy)
        later_m = np.where(is_sky, np.inf, later[:, 2])
        disparity, later_disparity = camera.disparity_px(hits.depth_m), camera.disparity_px(later_m)
    valid = seen & (signed | ((disparity > 0) & (later_disparity > 0)))
    return (
        np.where(seen[:, None], position - np.stack([x, y], axis=1), np.inf),
        np.where(valid, later_disparity - disparity, np.inf),
        later_m,
    )


def normals(scene: Scene, models: Sequence[Mesh], eye: Eye, hits: RayHits) -> Floats:
    """Return the normals of the triangles that one eye's rays hit, towards this eye.

    They are (R, 3) float64 unit vectors in the eye's frame, and 0 where a ray hits nothing.
    """
    result = np.zeros((len(hits.depth_m), 3))
    for hit, corners, normal in _triangles_hit(scene, models, eye, hits):
        unit = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        away = (unit * corners[:, 0]).sum(axis=1, keepdims=True) > 0
        result[hit] = np.where(away, -unit, unit)
    return result


def _triangles_hit(
    scene: Scene, models: Sequence[Mesh], eye: Eye, hits: RayHits
) -> Iterator[tuple[Ints, Floats, Floats]]:
    """Yield, for each instance, the numbers (N,) of its hits, and the triangles' corners (N, 3, 3) and normals (N, 3).

    Corners and normals are in the eye's frame; normals are not unit vectors.
    """
    for number in np.unique(hits.instance[hits.instance >= 0]).tolist():
        hit = np.flatnonzero(hits.instance == number)
        triangles = models[int(scene.model[number])].triangles[hits.triangle[hit]]
        corners = vertices_in_view(scene, models, eye, number)[triangles]
        yield hit, corners, np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def depth_on_planes(
    scene: Scene, models: Sequence[Mesh], eye: Eye, x_px: Floats, y_px: Floats, hits: RayHits
) -> Floats:
    """Return the depths, (R,) float64 m, at which rays cross the planes of the triangles in ``hits``; inf without hit.

    ``hits`` may be those of other rays nearby: then the depths are those of the surfaces next to the pixels, extended.
    """
    depth = np.full(len(x_px), np.inf)
    rays = scene.camera.rays_of_eye(eye, np.asarray(x_px, np.float64), np.asarray(y_px, np.float64))
    for hit, corners, normal in _triangles_hit(scene, models, eye, hits):
        with np.errstate(divide="ignore", invalid="ignore"):
            depth[hit] = (normal * corners[:, 0]).sum(axis=1) / (normal * rays[hit]).sum(axis=1)
    return depth
