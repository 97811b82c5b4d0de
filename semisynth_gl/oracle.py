"""The oracle: disparity, visibility and flow of a scene by float64 rays, against which the renderer is measured.

The rays are those of `semisynth_gl.scene.raycast`. Scenes use the same caster while they are sampled, to measure what
background and structures leave to see: what is judged and what judges share the caster, and nothing else.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.camera import OTHER_EYE, Eye, StereoCamera
from semisynth_gl.frame import OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.scene.raycast import Hits, cast_rays
from semisynth_gl.scene.scene import Motion, Scene


def disparity_px(camera: StereoCamera, hits: Hits) -> NDArray[np.float64]:
    """Disparity of hits, (R,) float64; inf where nothing is hit or it is not positive."""
    disparity = camera.disparity_px(hits.depth_m)
    return np.where(np.isfinite(hits.depth_m) & (disparity > 0), disparity, np.inf)


def visibility(
    scene: Scene, models: Sequence[Mesh], eye: Eye, x_px: NDArray[np.float64], y_px: NDArray[np.float64], hits: Hits
) -> NDArray[np.uint8]:
    """Whether the other eye sees the points that rays hit, by casting a second ray to each from there.

    Args:
        scene: what stands where.
        models: the meshes that ``scene.model`` counts.
        eye: whose rays they were.
        x_px: (R,) float64 columns of the rays.
        y_px: (R,) float64 rows.
        hits: what they see.

    Returns:
        (R,) uint8, the values of `semisynth_gl.frame`.
    """
    camera = scene.camera
    disparity = disparity_px(camera, hits)
    x = np.asarray(x_px, np.float64) + np.where(np.isfinite(disparity), disparity, 0) * (-1 if eye == "left" else 1)
    in_frame = np.isfinite(disparity) & (x >= -0.5) & (x < camera.width_px - 0.5)
    result = np.full(len(x), OUTSIDE, np.uint8)
    where = np.flatnonzero(in_frame)
    seen = cast_rays(scene, models, OTHER_EYE[eye], x[where], np.asarray(y_px, np.float64)[where])
    # The second ray meets the same point up to float64's rounding; a surface in front is farther away than that.
    hidden = seen.depth_m < hits.depth_m[where] * (1 - 1e-9)
    result[where] = np.where(hidden, OCCLUDED, VISIBLE)
    return result


@dataclass(frozen=True, slots=True, eq=False)
class Flows:
    """Where the points that R rays hit are at another moment, in the same view.

    Attributes:
        flow_px: (R, 2) float64, x and y; inf where there is no hit, or the point is nearer than the near plane then.
        disparity_change_px: (R,) float64; inf there too, and where either disparity is not positive.
        visibility: (R,) uint8, the values of `semisynth_gl.frame`.
    """

    flow_px: NDArray[np.float64]
    disparity_change_px: NDArray[np.float64]
    visibility: NDArray[np.uint8]


def flow(
    scene: Scene,
    models: Sequence[Mesh],
    motion: Motion,
    eye: Eye,
    x_px: NDArray[np.float64],
    y_px: NDArray[np.float64],
    hits: Hits,
) -> Flows:
    """Follow the points that rays hit to another moment, each on its own instance.

    Args:
        scene: what stands where.
        models: the meshes that ``scene.model`` counts.
        motion: how the scene gets to the other moment.
        eye: whose rays they were.
        x_px: (R,) float64 columns of the rays.
        y_px: (R,) float64 rows.
        hits: what they see.
    """
    camera = scene.camera
    x, y = np.asarray(x_px, np.float64), np.asarray(y_px, np.float64)
    then = np.full((len(x), 3), np.inf)
    aside = np.array([camera.offset_m(eye), 0.0, 0.0])
    for number in np.unique(hits.instance[hits.instance >= 0]):
        of = np.flatnonzero(hits.instance == number)
        now_from_model = scene.camera_from_world @ scene.world_from_model[number]
        then_from_model = motion.scene.camera_from_world @ motion.world_from_model[number]
        point = camera.rays(eye, x[of], y[of]) * hits.depth_m[of, None] + aside
        # By the triangle's corners and the point's place among them: flat models have no inverse matrix.
        corners = models[int(scene.model[number])].positions.astype(np.float64)
        corners = corners[models[int(scene.model[number])].triangles[hits.triangle[of]]]
        place = _place_among(corners @ now_from_model[:3, :3].T + now_from_model[:3, 3], point)
        moved = corners @ then_from_model[:3, :3].T + then_from_model[:3, 3]
        then[of] = (place[:, :, None] * moved).sum(axis=1) - aside
    with np.errstate(invalid="ignore"):
        seen = np.isfinite(then[:, 2]) & (then[:, 2] >= scene.near_m)
        position = camera.focal_px * then[:, :2] / then[:, 2:] + (camera.cx_px(eye), camera.cy_px)
        before, after = camera.disparity_px(hits.depth_m), camera.disparity_px(then[:, 2])
    both = seen & (before > 0) & (after > 0)
    inside = seen & (position >= -0.5).all(axis=1)
    inside &= (position[:, 0] < camera.width_px - 0.5) & (position[:, 1] < camera.height_px - 0.5)
    visibility = np.full(len(x), OUTSIDE, np.uint8)
    where = np.flatnonzero(inside)
    found = cast_rays(motion.scene, models, eye, position[where, 0], position[where, 1])
    gone = motion.instance[hits.instance[where]] < 0
    hidden = gone | (found.depth_m < then[where, 2] * (1 - 1e-9))
    visibility[where] = np.where(hidden, OCCLUDED, VISIBLE)
    return Flows(
        np.where(seen[:, None], position - np.stack([x, y], axis=1), np.inf),
        np.where(both, after - before, np.inf),
        visibility,
    )


def normals(scene: Scene, models: Sequence[Mesh], eye: Eye, hits: Hits) -> NDArray[np.float64]:
    """Work out the normals of the triangles that rays hit.

    Args:
        scene: what stands where.
        models: the meshes that ``scene.model`` counts.
        eye: whose rays they were; normals point to this eye's side.
        hits: what they see.

    Returns:
        (R, 3) float64 unit vectors in the camera frame; 0 where a ray hits nothing.
    """
    result = np.zeros((len(hits.depth_m), 3))
    for number in np.unique(hits.instance[hits.instance >= 0]):
        rays = np.flatnonzero(hits.instance == number)
        mesh = models[int(scene.model[number])]
        view_from_model = scene.camera_from_world @ scene.world_from_model[number]
        corners = mesh.positions.astype(np.float64)[mesh.triangles[hits.triangle[rays]]]
        corners = corners @ view_from_model[:3, :3].T + view_from_model[:3, 3]
        corners[..., 0] -= scene.camera.offset_m(eye)
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        away = (normal * corners[:, 0]).sum(axis=1, keepdims=True) > 0
        result[rays] = np.where(away, -normal, normal)
    return result


def _place_among(corners: NDArray[np.float64], point: NDArray[np.float64]) -> NDArray[np.float64]:
    """Barycentric coordinates (R, 3) of points (R, 3) in the planes of triangles (R, 3, 3)."""
    edge_1, edge_2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(edge_1, edge_2)
    across = point - corners[:, 0]
    area = (normal**2).sum(axis=1)
    second = (np.cross(across, edge_2) * normal).sum(axis=1) / area
    third = (np.cross(edge_1, across) * normal).sum(axis=1) / area
    return np.stack([1 - second - third, second, third], axis=1)


def depth_on_planes(
    scene: Scene, models: Sequence[Mesh], eye: Eye, x_px: NDArray[np.float64], y_px: NDArray[np.float64], hits: Hits
) -> NDArray[np.float64]:
    """Depth at pixel positions of the planes of triangles that were hit elsewhere, (R,) float64.

    It tells on which surface a pixel lies that an edge passes close by. inf where ``hits`` has none.
    """
    depth = np.full(len(x_px), np.inf)
    rays = scene.camera.rays(eye, np.asarray(x_px, np.float64), np.asarray(y_px, np.float64))
    for number in np.unique(hits.instance[hits.instance >= 0]):
        of = np.flatnonzero(hits.instance == number)
        mesh = models[int(scene.model[number])]
        view_from_model = scene.camera_from_world @ scene.world_from_model[number]
        corners = mesh.positions.astype(np.float64)[mesh.triangles[hits.triangle[of]]]
        corners = corners @ view_from_model[:3, :3].T + view_from_model[:3, 3]
        corners[..., 0] -= scene.camera.offset_m(eye)
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        with np.errstate(divide="ignore", invalid="ignore"):
            depth[of] = (normal * corners[:, 0]).sum(axis=1) / (normal * rays[of]).sum(axis=1)
    return depth
