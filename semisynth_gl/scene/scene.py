"""What stands where in one pair: the arrays that the renderer draws."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.camera import StereoCamera
from semisynth_gl.errors import InputError


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A camera and N instances of models, each wearing one layer of the patch atlas.

    Attributes:
        camera: the stereo camera.
        near_m: nothing nearer than this depth is drawn; positive.
        camera_from_world: (4, 4) float64, the left camera's pose; the identity places instances in the camera frame.
        model: (N,) int64, index into the renderer's models.
        world_from_model: (N, 4, 4) float64, affine.
        layer: (N,) int64, index into the patch atlas.
        uv_scale: (N, 2) float64, patches per unit of the model's UV.
        uv_offset: (N, 2) float64, patches; patch coordinate = uv * uv_scale + uv_offset.
    """

    camera: StereoCamera
    near_m: float
    camera_from_world: NDArray[np.float64]
    model: NDArray[np.int64]
    world_from_model: NDArray[np.float64]
    layer: NDArray[np.int64]
    uv_scale: NDArray[np.float64]
    uv_offset: NDArray[np.float64]

    def __post_init__(self) -> None:
        if not (np.isfinite(self.near_m) and self.near_m > 0):
            raise InputError(f"near_m must be positive and finite, got {self.near_m}")
        n = len(self.model)
        expected = {
            "camera_from_world": (4, 4),
            "model": (n,),
            "world_from_model": (n, 4, 4),
            "layer": (n,),
            "uv_scale": (n, 2),
            "uv_offset": (n, 2),
        }
        for name, shape in expected.items():
            array = getattr(self, name)
            if array.shape != shape:
                raise InputError(f"scene: {name} must have shape {shape} for {n} instances, got {array.shape}")
            if not np.isfinite(array).all():
                raise InputError(f"scene: {name} has values that are not finite")

    def __len__(self) -> int:
        return len(self.model)


def make_scene(
    camera: StereoCamera,
    *,
    model: object,
    world_from_model: object,
    layer: object,
    uv_scale: object = (1.0, 1.0),
    uv_offset: object = (0.0, 0.0),
    camera_from_world: object | None = None,
    near_m: float = 0.01,
) -> Scene:
    """Build a `Scene` from anything array-like; UV arguments broadcast over the instances.

    Raises:
        InputError: where shapes or values are wrong.
    """
    index = np.asarray(model, np.int64).reshape(-1)
    n = len(index)
    matrices = np.asarray(world_from_model, np.float64)
    if matrices.size != n * 16:
        raise InputError(f"scene: world_from_model must have shape ({n}, 4, 4) for {n} instances, got {matrices.shape}")
    return Scene(
        camera=camera,
        near_m=float(near_m),
        camera_from_world=np.eye(4) if camera_from_world is None else np.asarray(camera_from_world, np.float64),
        model=index,
        world_from_model=matrices.reshape(-1, 4, 4),
        layer=np.asarray(layer, np.int64).reshape(-1),
        uv_scale=np.broadcast_to(np.asarray(uv_scale, np.float64), (n, 2)),
        uv_offset=np.broadcast_to(np.asarray(uv_offset, np.float64), (n, 2)),
    )
