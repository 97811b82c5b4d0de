"""The oracle: a float64 ray cast in plain numpy, against which the renderer is measured.

It shares nothing with `semisynth_gl.render` but the scene's arrays: rays come from the camera's intrinsics, triangles
from the models' vertices (float32 as the renderer has them) placed in float64. Slow, and meant to be.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.camera import OTHER_EYE, Eye, StereoCamera
from semisynth_gl.frame import OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.scene.scene import Motion, Scene

# Rays are compared with triangles' bounding boxes this many comparisons at a time, to bound memory.
_COMPARISONS = 4_000_000
# Bounding boxes are widened by this much, so that rounding of the projection never loses a ray on an edge.
_BOX_MARGIN_PX = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """What R rays see first.

    Attributes:
        depth_m: (R,) float64 planar depth; inf where a ray hits nothing.
        instance: (R,) int64, -1 where a ray hits nothing.
        triangle: (R,) int64, index into the instance's model.
    """

    depth_m: NDArray[np.float64]
    instance: NDArray[np.int64]
    triangle: NDArray[np.int64]


def cast(scene: Scene, models: Sequence[Mesh], eye: Eye, x_px: NDArray[np.float64], y_px: NDArray[np.float64]) -> Hits:
    """Cast rays from one eye through pixel positions, whole or fractional.

    Of surfaces at one depth, the first instance and triangle wins. Surfaces nearer than ``scene.near_m`` are passed
    through, as by the renderer.

    Args:
        scene: what stands where.
        models: the meshes that ``scene.model`` counts.
        eye: "left" or "right".
        x_px: (R,) float64, columns.
        y_px: (R,) float64, rows.
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
        boxes = _boxes(camera, eye, corners, scene.near_m)
        inside = (
            (x >= boxes[:, 0].min()) & (x <= boxes[:, 1].max()) & (y >= boxes[:, 2].min()) & (y <= boxes[:, 3].max())
        )
        candidates = np.flatnonzero(inside)
        for part in np.array_split(candidates, max(1, len(candidates) * len(boxes) // _COMPARISONS)):
            ray, triangle = np.nonzero(
                (x[part, None] >= boxes[:, 0])
                & (x[part, None] <= boxes[:, 1])
                & (y[part, None] >= boxes[:, 2])
                & (y[part, None] <= boxes[:, 3])
            )
            _keep_nearest(hits, part[ray], rays[part[ray]], corners[triangle], number, triangle, scene.near_m)
    return hits


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
    seen = cast(scene, models, OTHER_EYE[eye], x[where], np.asarray(y_px, np.float64)[where])
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
    found = cast(motion.scene, models, eye, position[where, 0], position[where, 1])
    gone = motion.instance[hits.instance[where]] < 0
    hidden = gone | (found.depth_m < then[where, 2] * (1 - 1e-9))
    visibility[where] = np.where(hidden, OCCLUDED, VISIBLE)
    return Flows(
        np.where(seen[:, None], position - np.stack([x, y], axis=1), np.inf),
        np.where(both, after - before, np.inf),
        visibility,
    )


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


def _boxes(camera: StereoCamera, eye: Eye, corners: NDArray[np.float64], near_m: float) -> NDArray[np.float64]:
    """Bounding boxes of triangles on the image, (T, 4) as x0 x1 y0 y1; the whole plane where one crosses z = near."""
    depth = corners[:, :, 2]
    safe = np.where(depth > 0, depth, 1.0)
    x = camera.focal_px * corners[:, :, 0] / safe + camera.cx_px(eye)
    y = camera.focal_px * corners[:, :, 1] / safe + camera.cy_px
    margin = _BOX_MARGIN_PX
    boxes = np.stack(
        [x.min(axis=1) - margin, x.max(axis=1) + margin, y.min(axis=1) - margin, y.max(axis=1) + margin], axis=1
    )
    boxes[(depth < near_m).any(axis=1)] = -np.inf, np.inf, -np.inf, np.inf
    behind = (depth < near_m).all(axis=1)
    boxes[behind] = np.inf, -np.inf, np.inf, -np.inf
    return boxes


def _keep_nearest(
    hits: Hits,
    ray: NDArray[np.intp],
    direction: NDArray[np.float64],
    corners: NDArray[np.float64],
    instance: int,
    triangle: NDArray[np.intp],
    near_m: float,
) -> None:
    """Intersect pairs of rays and triangles (Moller and Trumbore 1997) and keep what is nearer than before.

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
    order = np.flatnonzero(hit)
    # Ascending depth with the lowest triangle first, then the first of each ray.
    order = order[np.lexsort((triangle[order], depth[order], ray[order]))]
    order = order[np.unique(ray[order], return_index=True)[1]]
    nearer = order[depth[order] < hits.depth_m[ray[order]]]
    hits.depth_m[ray[nearer]] = depth[nearer]
    hits.instance[ray[nearer]] = instance
    hits.triangle[ray[nearer]] = triangle[nearer]
