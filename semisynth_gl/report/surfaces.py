"""Exact quantities of the surfaces that rays hit: how they are turned, and how many texels fall on a pixel."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.scene.raycast import Hits
from semisynth_gl.scene.scene import Scene


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """The surfaces at R hits; NaN where a ray hits nothing.

    Attributes:
        slant_deg: (R,) float64, angle between the surface's normal and the ray: 0 where it faces the camera, 90 where
            it is seen edge on.
        texels_per_pixel: (R,) float64, side in texels of a square that has the area of patch that a pixel sees.
    """

    slant_deg: NDArray[np.float64]
    texels_per_pixel: NDArray[np.float64]


def surfaces_at(
    scene: Scene,
    models: Sequence[Mesh],
    patch_px: int,
    x_px: NDArray[np.float64],
    y_px: NDArray[np.float64],
    hits: Hits,
) -> Surfaces:
    """Measure the surfaces that rays from the left eye hit.

    A ray r = ((x - cx) / f, (y - cy) / f, 1) meets the plane n . P = c of a triangle at P = Z r with Z = c / (n . r).
    From there, the plane's point moves with the pixel as dP/dx = Z (r' - r (n . r') / (n . r)) where r' = dr/dx, and
    likewise for y. Patch coordinates are affine on a triangle: G maps both of its edges to their differences in UV.
    So J = patch_px diag(uv_scale) G (dP/dx, dP/dy) is the Jacobian of texels by pixels, and sqrt(|det J|), the
    geometric mean of its two singular values, the number of texels along the side of a pixel. For UV without
    stretching, of s patches per metre, this is patch_px s Z / (f sqrt(|n . r|)) with n of length 1.

    Args:
        scene: what stands where.
        models: the meshes that ``scene.model`` counts.
        patch_px: side of a patch in texels.
        x_px: (R,) float64, columns of the rays in the left view.
        y_px: (R,) float64, rows.
        hits: what they hit.
    """
    slant, texels = np.full(len(x_px), np.nan), np.full(len(x_px), np.nan)
    rays = scene.camera.rays("left", x_px, y_px)
    for number in np.unique(hits.instance[hits.instance >= 0]):
        of = np.flatnonzero(hits.instance == number)
        mesh = models[int(scene.model[number])]
        view_from_model = (scene.camera_from_world @ scene.world_from_model[number])[:3]
        triangles = mesh.triangles[hits.triangle[of]]
        corners = mesh.positions.astype(np.float64)[triangles] @ view_from_model[:, :3].T + view_from_model[:, 3]
        uv = mesh.uv.astype(np.float64)[triangles] * scene.uv_scale[number]
        # (R, 3, 2) and (R, 2, 2): both edges as columns, in metres and in patches.
        edges = np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 2)
        patches = np.moveaxis(uv[:, 1:] - uv[:, :1], 1, 2)
        normal = np.cross(edges[..., 0], edges[..., 1])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        ray = rays[of]
        towards = (normal * ray).sum(axis=1)
        slant[of] = np.rad2deg(np.arccos(np.clip(np.abs(towards) / np.linalg.norm(ray, axis=1), 0, 1)))
        # The rays' derivatives are (1, 0, 0) / f and (0, 1, 0) / f: n . r' is a component of n.
        moved = np.eye(3)[:, :2] - ray[:, :, None] * (normal[:, :2] / towards[:, None])[:, None, :]
        moved *= (hits.depth_m[of] / scene.camera.focal_px)[:, None, None]
        jacobian = patch_px * patches @ np.linalg.pinv(edges) @ moved
        texels[of] = np.sqrt(np.abs(np.linalg.det(jacobian)))
    return Surfaces(slant, texels)


def diameters_px(scene: Scene, models: Sequence[Mesh], instances: NDArray[np.int64]) -> NDArray[np.float64]:
    """Diameters on the screen of instances' bounding spheres, before they are stretched, (N,) float64.

    This is what sizes in the config mean, ``particles.size_px`` or whatever overrides it: the sphere about a model at
    the largest of its three scales, as large as it would look at the depth of its centre.

    Args:
        scene: what stands where.
        models: the meshes that ``scene.model`` counts.
        instances: (N,) int64, which of the scene's.
    """
    view_from_model = scene.camera_from_world @ scene.world_from_model[instances]
    scale = np.linalg.norm(view_from_model[:, :3, :3], axis=1).max(axis=1)
    radius = scale * np.array([models[number].radius for number in scene.model[instances]])
    diameters: NDArray[np.float64] = 2 * scene.camera.focal_px * radius / view_from_model[:, 2, 3]
    return diameters
