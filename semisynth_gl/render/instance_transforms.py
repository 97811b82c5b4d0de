"""A scene's instances as the eyes see them: poses, composed in float64 relative to the eye."""

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

# Patches repeat after two of them, mirrored or not, so larger offsets are reduced by multiples of two. Offsets of up to
# 16 are kept: float32 holds them in steps of 1/2000 of a texel where patches have 512.
_PERIOD, _NEAR_PATCHES = 2.0, 16.0
# Smallest radius of an instance; instances as small as this cannot be seen.
_LEAST_M = LEAST**2


@dataclass(frozen=True, slots=True, eq=False)
class InstanceTransforms:
    """A scene's N instances as both eyes see them."""

    scene: Scene
    view_from_model: NDArray[np.float64]  # (N, 4, 4) poses of the models relative to the left eye
    radius_m: NDArray[np.float64]  # (N,) upper bound of an instance's reach from its centre
    solid: NDArray[np.bool_]  # (N,) whether only fronts can be seen from outside
    patch_from_uv: NDArray[np.float64]  # (N, 4) scale and offset, (u, v) each, for the models' UV

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
        """Return which instances show one eye only fronts, (N,) bool: solid ones that the near plane does not cut."""
        return self.solid & (self.rows(eye)[:, 2, 3] - self.radius_m > self.scene.near_of(eye))


class TransformComposer:
    """Composes the transforms of scenes of these models; a model too small or large for float32 is an InputError."""

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
        # The largest row sum of |A^T A| is an upper bound of the squared largest singular value, and equal to it if the
        # instance is scaled along its own axes and then rotated.
        stretch = np.sqrt(np.abs(linear.transpose(0, 2, 1) @ linear).sum(axis=2).max(axis=1, initial=0.0))
        # A mirrored instance turns its backs outwards.
        solid = self._solid[scene.model]
        solid[solid] = np.linalg.det(linear[solid]) > 0
        radius_m = self._radius[scene.model] * stretch
        reach_m = np.abs(view_from_model[:, :3, 3]).max(axis=1, initial=0.0) + radius_m
        _refuse(reach_m, reach_m > MOST, "reaches farther from the camera")
        # The radius of a tiny instance may be 0, because squares of small numbers are.
        extended = (np.abs(linear).max(axis=(1, 2), initial=0.0) > 0) & (self._radius[scene.model] > 0)
        _refuse(radius_m, extended & (radius_m < _LEAST_M), "is smaller")
        return InstanceTransforms(scene, view_from_model, radius_m, solid, _patch_from_uv(scene))


def _patch_from_uv(scene: Scene) -> NDArray[np.float64]:
    offset = np.where(np.abs(scene.uv_offset) > _NEAR_PATCHES, scene.uv_offset % _PERIOD, scene.uv_offset)
    return np.concatenate([scene.uv_scale, offset], axis=1)


def _refuse(metres: NDArray[np.float64], wrong: NDArray[np.bool_], what: str) -> None:
    for number in np.flatnonzero(wrong)[:1]:
        raise InputError(
            f"scene: expected instances of {_LEAST_M:g} to {MOST:g} m, but instance {number} {what}, "
            f"{metres[number]:g} m: {OTHER_UNITS}"
        )
