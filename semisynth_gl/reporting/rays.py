"""Exact quantities of the surfaces that rays hit in the rebuilt scenes of a dataset."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from semisynth_gl import oracle
from semisynth_gl.dataset.reader import StoredIndex
from semisynth_gl.dataset.rebuild import RebuiltScenes
from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.scene.raycast import Hits, cast_rays
from semisynth_gl.scene.scene import Scene
from semisynth_gl.seeds.splits import SplitName

# Largest error of disparity at a pixel's centre that the renderer promises.
_ERROR_PX = 1e-3
# Least share of agreeing rays. Some rays do not agree, since pixels beside an edge may show the surface on its other
# side; in a different scene, some rays agree by chance.
_LEAST_AGREEING = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """Rays that were cast through the rebuilt scenes of one or more pairs, and the surfaces that they hit.

    A ray agrees if it gives the stored disparity.

    Attributes:
        pairs: number of pairs.
        cast: number of rays.
        agreeing: number of agreeing rays.
        slant_deg: (R,), slants at the agreeing rays that hit a surface other than the sky; see `surfaces_at`.
        texels_per_pixel: (R,), texels along the side of a pixel at the same rays; see `surfaces_at`.
        diameter_px: (N,), diameters of the objects that these rays hit, without backgrounds, once for each pair; see
            `diameters_px`.
    """

    pairs: int
    cast: int
    agreeing: int
    slant_deg: NDArray[np.float64]
    texels_per_pixel: NDArray[np.float64]
    diameter_px: NDArray[np.float64]

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Return the rays of any number of pairs as one; without any, all numbers are 0 and all arrays empty."""
        numbers = {name: sum(getattr(part, name) for part in parts) for name in ("pairs", "cast", "agreeing")}
        arrays: dict[str, Any] = {
            name: np.concatenate([np.empty(0), *(getattr(part, name) for part in parts)])
            for name in ("slant_deg", "texels_per_pixel", "diameter_px")
        }
        return cls(**numbers, **arrays)


class RayCaster:
    """Rebuilds the scenes of a dataset's pairs, and casts rays through them."""

    def __init__(self, index: StoredIndex) -> None:
        self._index = index
        # The scenes of each split, or why they cannot be rebuilt.
        self._scenes: dict[str, RebuiltScenes | str] = {}

    def cast(self, frame: StoredFrame, x: NDArray[np.int64], y: NDArray[np.int64]) -> Rays:
        """Cast rays through pixels x (R,) and y (R,) of a pair's left view.

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
    As the pixel moves, this point moves by dP/dx = Z (r' - r (n . r') / (n . r)) with r' = dr/dx, and in the same way
    for y. Patch coordinates are affine on a triangle: G maps each of two edges to its difference in UV. So
    J = patch_px diag(uv_scale) G (dP/dx, dP/dy) is the Jacobian of texels by pixels. sqrt(|det J|), the geometric mean
    of its two singular values, is the number of texels along the side of a pixel. For UV without stretching, with s
    patches per metre, this is patch_px s Z / (f sqrt(|n . r|)) with n of length 1.

    Args:
        scene: the scene.
        models: the meshes to which the scene's instances refer.
        patch_px: (N,), the side, in texels, of the patch that each instance wears.
        x_px: (R,), x of the rays' pixels.
        y_px: (R,), y of the rays' pixels.
        hits: the R rays' hits.

    Returns:
        The angle between normal and ray in degrees, 0 where a surface faces the camera and 90 where it is seen edge-on;
        and the side, in texels, of a square with the area of the patch that a pixel sees. Both are (R,), and NaN for a
        ray that hits nothing or the sky.
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
        # The rays' derivatives are (1, 0, 0) / fx and (0, 1, 0) / fy: n . r' is a component of n.
        moved = np.eye(3)[:, :2] - ray[:, :, None] * (normal[:, :2] / towards[:, None])[:, None, :]
        moved *= hits.depth_m[on_instance][:, None, None] / (scene.camera.focal_px, scene.camera.focal_y_px)
        jacobian = patch_px[number] * patches @ np.linalg.pinv(edges) @ moved
        texels[on_instance] = np.sqrt(np.abs(np.linalg.det(jacobian)))
    return slant, texels


def diameters_px(scene: Scene, models: Sequence[Mesh], instances: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the diameters of instances in the left image, (N,) float64 px, as the config's sizes mean them.

    Sizes such as ``particles.size_px`` are diameters of the sphere about the model, scaled by the largest of the
    instance's three scales, at the depth of its centre. ``instances`` (N,) are indices of the scene's instances, and
    ``models`` are the meshes to which the scene refers.
    """
    view_from_model = scene.camera_from_world @ scene.world_from_model[instances]
    scale = np.linalg.norm(view_from_model[:, :3, :3], axis=1).max(axis=1)
    radius = scale * np.array([models[number].radius for number in scene.model[instances]])
    diameters: NDArray[np.float64] = 2 * scene.camera.focal_px * radius / view_from_model[:, 2, 3]
    return diameters
