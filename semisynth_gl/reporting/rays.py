"""Exact quantities of the surfaces that rays hit, in the rebuilt scenes of a dataset."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from semisynth_gl import oracle
from semisynth_gl.dataset.reader import Index
from semisynth_gl.dataset.rebuild import RebuiltScenes
from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.scene.raycast import Hits, cast_rays
from semisynth_gl.scene.scene import Scene
from semisynth_gl.seeds.splits import SplitName

# The renderer promises this error of disparity at a pixel's centre.
_ERROR_PX = 1e-3
# Pixels beside edges may show the surface on the other side. In a different scene, some rays agree by chance.
_LEAST_AGREEING = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """Rays that were cast through the rebuilt scenes of one pair or several, and what the agreeing rays meet there.

    An agreeing ray gives the stored disparity. Each has the measures of `surfaces_at`, and each object that one hits
    has a diameter, once for each pair; see `diameters_px`.
    """

    pairs: int
    cast: int
    agreeing: int
    slant_deg: NDArray[np.float64]
    texels_per_pixel: NDArray[np.float64]
    diameter_px: NDArray[np.float64]

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Join the rays of several pairs, or of none."""
        numbers = {name: sum(getattr(part, name) for part in parts) for name in ("pairs", "cast", "agreeing")}
        arrays: dict[str, Any] = {
            name: np.concatenate([np.empty(0), *(getattr(part, name) for part in parts)])
            for name in ("slant_deg", "texels_per_pixel", "diameter_px")
        }
        return cls(**numbers, **arrays)


class RayCaster:
    """Casts rays through the scenes of a dataset's pairs, which it rebuilds."""

    def __init__(self, index: Index) -> None:
        self._index = index
        # The scenes of each split, or why they cannot be rebuilt.
        self._scenes: dict[str, RebuiltScenes | str] = {}

    def cast(self, frame: StoredFrame, x: NDArray[np.int64], y: NDArray[np.int64]) -> Rays:
        """Cast rays through the pixels (x, y), (R,) each, of a pair's left view.

        Raises:
            InputError: where the scene cannot be rebuilt, or differs from the stored pair.
        """
        scenes = self._rebuilt(frame.split)
        rebuilt = scenes.sampled(frame)
        if rebuilt is None:
            raise InputError("config and seed of the index give a scene that differs from the pair's provenance")
        scene = rebuilt.scene
        x_px, y_px = x.astype(np.float64), y.astype(np.float64)
        hits = cast_rays(scene, scenes.models, "left", x_px, y_px)
        way = oracle.correspondence_px(scene.camera, "left", x_px, y_px, hits, signed=frame.encodings.signed)
        exact = oracle.disparity_of("left", way)
        stored = frame.left.disparity[y, x].astype(np.float64)
        with np.errstate(invalid="ignore"):
            agreeing = np.abs(exact - stored) <= _ERROR_PX + frame.rounding_px(stored)
        agreeing |= exact == stored
        if agreeing.mean() < _LEAST_AGREEING:
            raise InputError(
                "the rebuilt scene differs from the stored pair: another version made the dataset, or models changed"
            )
        slant_deg, texels = surfaces_at(scene, scenes.models, rebuilt.patch_px, x_px, y_px, hits)
        # The sky has neither slant nor size.
        hit = agreeing & (hits.instance >= 0) & np.isfinite(hits.depth_m)
        seen = np.unique(hits.instance[hit])
        objects = seen[~rebuilt.still[seen]]
        return Rays(
            pairs=1,
            cast=len(x),
            agreeing=int(agreeing.sum()),
            slant_deg=slant_deg[hit],
            texels_per_pixel=texels[hit],
            diameter_px=diameters_px(scene, scenes.models, objects),
        )

    def _rebuilt(self, split: str) -> RebuiltScenes:
        if split not in self._scenes:
            try:
                self._scenes[split] = RebuiltScenes(self._index, cast("SplitName", split))
            except InputError as error:
                self._scenes[split] = str(error)
        scenes = self._scenes[split]
        if isinstance(scenes, str):
            raise InputError(scenes)
        return scenes


def surfaces_at(
    scene: Scene,
    models: Sequence[Mesh],
    patch_px: NDArray[np.int64],
    x_px: NDArray[np.float64],
    y_px: NDArray[np.float64],
    hits: Hits,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Measure the surfaces that rays from the left eye hit.

    A ray r = ((x - cx) / f, (y - cy) / f, 1) meets the plane n . P = c of a triangle at P = Z r with Z = c / (n . r).
    From there, the plane's point moves with the pixel as dP/dx = Z (r' - r (n . r') / (n . r)) where r' = dr/dx, and
    likewise for y. Patch coordinates are affine on a triangle: G maps both of its edges to their differences in UV.
    So J = patch_px diag(uv_scale) G (dP/dx, dP/dy) is the Jacobian of texels by pixels, and sqrt(|det J|), the
    geometric mean of its two singular values, the number of texels along the side of a pixel. For UV without
    stretching, of s patches per metre, this is patch_px s Z / (f sqrt(|n . r|)) with n of length 1.

    ``patch_px`` (N,) has the side in texels of the patch that each instance wears. The first result has the angle in
    degrees between normal and ray: 0 where a surface faces the camera, 90 where it is seen edge on. The second has the
    side in texels of a square with the area of patch that a pixel sees. Both are (R,), and NaN for a ray that hits
    nothing or the sky.
    """
    slant, texels = np.full(len(x_px), np.nan), np.full(len(x_px), np.nan)
    rays = scene.camera.rays("left", x_px, y_px)
    solid = (hits.instance >= 0) & np.isfinite(hits.depth_m)
    for number in np.unique(hits.instance[solid]):
        on_instance = np.flatnonzero(solid & (hits.instance == number))
        mesh = models[int(scene.model[number])]
        view_from_model = (scene.camera_from_world @ scene.world_from_model[number])[:3]
        triangles = mesh.triangles[hits.triangle[on_instance]]
        corners = mesh.positions.astype(np.float64)[triangles] @ view_from_model[:, :3].T + view_from_model[:, 3]
        uv = mesh.uv.astype(np.float64)[triangles] * scene.uv_scale[number]
        # (R, 3, 2) and (R, 2, 2): both edges as columns, in metres and in patches.
        edges = np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 2)
        patches = np.moveaxis(uv[:, 1:] - uv[:, :1], 1, 2)
        normal = np.cross(edges[..., 0], edges[..., 1])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        ray = rays[on_instance]
        towards = (normal * ray).sum(axis=1)
        slant[on_instance] = np.rad2deg(np.arccos(np.clip(np.abs(towards) / np.linalg.norm(ray, axis=1), 0, 1)))
        # The rays' derivatives are (1, 0, 0) / f and (0, 1, 0) / f: n . r' is a component of n.
        moved = np.eye(3)[:, :2] - ray[:, :, None] * (normal[:, :2] / towards[:, None])[:, None, :]
        moved *= (hits.depth_m[on_instance] / scene.camera.focal_px)[:, None, None]
        jacobian = patch_px[number] * patches @ np.linalg.pinv(edges) @ moved
        texels[on_instance] = np.sqrt(np.abs(np.linalg.det(jacobian)))
    return slant, texels


def diameters_px(scene: Scene, models: Sequence[Mesh], instances: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the diameters on the screen of instances' bounding spheres before stretching, (N,) float64.

    Sizes in the config, such as ``particles.size_px``, mean this diameter: of the sphere about a model at the largest
    of its three scales, seen at the depth of its centre. The scene's models are indices of the meshes.
    """
    view_from_model = scene.camera_from_world @ scene.world_from_model[instances]
    scale = np.linalg.norm(view_from_model[:, :3, :3], axis=1).max(axis=1)
    radius = scale * np.array([models[number].radius for number in scene.model[instances]])
    diameters: NDArray[np.float64] = 2 * scene.camera.focal_px * radius / view_from_model[:, 2, 3]
    return diameters
