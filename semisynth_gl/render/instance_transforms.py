"""Composes the poses of a scene's instances relative to the eyes, in float64."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Crop, Eye
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.inputs.arguments import LEAST, MOST, OTHER_UNITS
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.render.projection import in_view
from semisynth_gl.scene.scene import Scene

# Patches repeat after one patch, or after two if they are mirrored. UV offsets above 16 patches are reduced modulo 2.
# Up to 16, float32 rounds an offset by less than 1/2000 texel of a patch of 512 texels.
_PERIOD, _MAX_OFFSET = 2.0, 16.0
# Minimum radius of an instance, (1e-9)^2 m. A smaller instance would be invisible anyway.
_LEAST_M = LEAST**2


@dataclass(frozen=True, slots=True, eq=False)
class InstanceTransforms:
    """A scene's N instances, posed relative to the eyes."""

    scene: Scene
    view_from_model: NDArray[np.float64]  # (N, 4, 4) poses of the models relative to the left eye
    radius_m: NDArray[np.float64]  # (N,) upper bound of an instance's radius around its origin
    solid: NDArray[np.bool_]  # (N,) whether an eye outside the instance sees only front faces
    patch_from_uv: NDArray[np.float64]  # (N, 4) scale (u, v) and offset (u, v) of the models' UV

    def rows(self, eye: Eye) -> NDArray[np.float64]:
        """Return the first three rows of view_from_model relative to one eye, (N, 3, 4) float64."""
        rows = self.view_from_model[:, :3].copy()
        rows[:, 0, 3] -= self.scene.offset_m(eye)
        turn = self.scene.camera.turn(eye)
        return rows if turn is None else turn @ rows

    def in_view(self, eye: Eye, part: Crop | None = None) -> NDArray[np.bool_]:
        """Return which instances may reach into one eye's image, or into a part of it, (N,) bool."""
        camera = self.scene.camera if part is None else self.scene.camera.cropped(part)
        return in_view(camera, eye, self.scene.near_of(eye), self.rows(eye)[:, :, 3], self.radius_m)

    def fronts_only(self, eye: Eye) -> NDArray[np.bool_]:
        """Return which instances show one eye only front faces, (N,) bool: solid, and not cut by the near plane."""
        return self.solid & (self.rows(eye)[:, 2, 3] - self.radius_m > self.scene.near_of(eye))


class TransformComposer:
    """Composes the transforms of scenes of these models; raises InputError for models beyond the range of float32."""

    def __init__(self, models: Sequence[Mesh]) -> None:
        self._radius = np.array([model.radius for model in models])
        self._solid = np.array([model.solid for model in models])
        for model, radius in zip(models, self._radius, strict=True):
            if not (radius == 0 or LEAST <= radius <= MOST):
                raise InputError(
                    f"mesh {model.name}: must reach {LEAST:g} to {MOST:g} from its origin, got {radius:g}: "
                    f"{OTHER_UNITS}"
                )

    def compose(self, scene: Scene) -> InstanceTransforms:
        """Compose the poses of a scene's instances, for both eyes.

        Raises InputError where an instance is too small, too large or too far away for float32.
        """
        view_from_model = scene.view_from_model()
        linear = view_from_model[:, :3, :3]
        # The largest row sum of |A^T A| is an upper bound of the squared largest singular value of A. The two are
        # equal if A scales along the model's axes and then rotates.
        stretch = np.sqrt(np.abs(linear.transpose(0, 2, 1) @ linear).sum(axis=2).max(axis=1, initial=0.0))
        # In a mirrored instance, the back faces of triangles face outwards.
        solid = self._solid[scene.model]
        solid[solid] = np.linalg.det(linear[solid]) > 0
        radius_m = self._radius[scene.model] * stretch
        reach_m = np.abs(view_from_model[:, :3, 3]).max(axis=1, initial=0.0) + radius_m
        _refuse(reach_m, reach_m > MOST, "reaches farther from the camera")
        # The radius of a tiny instance may underflow to 0, so a radius of 0 does not mean a single point.
        has_extent = (np.abs(linear).max(axis=(1, 2), initial=0.0) > 0) & (self._radius[scene.model] > 0)
        _refuse(radius_m, has_extent & (radius_m < _LEAST_M), "is smaller")
        return InstanceTransforms(scene, view_from_model, radius_m, solid, _patch_from_uv(scene))


def _patch_from_uv(scene: Scene) -> NDArray[np.float64]:
    offset = np.where(np.abs(scene.uv_offset) > _MAX_OFFSET, scene.uv_offset % _PERIOD, scene.uv_offset)
    return np.concatenate([scene.uv_scale, offset], axis=1)


def _refuse(metres: NDArray[np.float64], wrong: NDArray[np.bool_], fault: str) -> None:
    """Raise InputError for the first instance that is wrong."""
    if wrong.any():
        number = wrong.argmax()
        raise InputError(
            f"scene: expected instances of {_LEAST_M:g} to {MOST:g} m, but instance {number} {fault}, "
            f"{metres[number]:g} m: {OTHER_UNITS}"
        )
