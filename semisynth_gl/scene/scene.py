"""The scene of one pair, as arrays for the renderer, and its motion to a different moment."""

from dataclasses import dataclass, field, replace
from types import EllipsisType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Eye, StereoCamera
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.inputs.arguments import LEAST, MOST, check_magnitudes, to_array, to_real
from semisynth_gl.inputs.errors import InputError

# A right camera is rotated by at most 10 degrees about x. So a point less than 70 degrees off the left optical axis has
# at least this share of its left depth in the right view.
_DEVIATING_NEAR = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Projector:
    """A projector of a pattern. Its pixels are square, and its axis goes through the pattern's middle.

    A surface's colour is multiplied by  ambient + power * pattern * cos(incidence) / (distance in metres)^2.  The
    second term is 0 where the projector's light does not reach the surface.

    Attributes:
        projector_from_camera: (4, 4) float64, rigid, from the left camera's frame; x right, y down, z forward in both.
        focal_px: focal length, pixels of the pattern.
        power: light of the brightest pixel on a surface that faces the projector at 1 m, 0 or more.
        ambient: all light that does not come from the projector, 0 or more.

    Raises:
        InputError: where shapes or values are wrong.
    """

    projector_from_camera: NDArray[np.float64]
    focal_px: float
    power: float
    ambient: float = 1.0

    def __post_init__(self) -> None:
        pose = to_array("projector: projector_from_camera", self.projector_from_camera, np.float64)
        object.__setattr__(self, "projector_from_camera", pose)
        turn = pose[:3, :3] if pose.shape == (4, 4) else np.zeros((3, 3))
        rigid = np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) and np.linalg.det(turn) > 0
        if not rigid or pose[3].tolist() != [0, 0, 0, 1]:
            raise InputError(f"projector_from_camera must be rigid, (4, 4), got {pose.tolist()}", argument="projector")
        check_magnitudes("projector: projector_from_camera", pose)
        for name in ("focal_px", "power", "ambient"):
            value = to_real(f"projector: {name}", getattr(self, name), LEAST if name == "focal_px" else 0, MOST)
            object.__setattr__(self, name, value)

    def record(self) -> dict[str, object]:
        """Return the values in JSON's types."""
        pose = self.projector_from_camera[:3].tolist()
        rest = {"focal_px": self.focal_px, "power": self.power, "ambient": self.ambient}
        return {"projector_from_camera": pose} | rest


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A camera and N instances of models, each textured with one layer of the patch atlas.

    Numbers may be up to 1e9 in magnitude.

    Attributes:
        camera: the stereo camera.
        near_m: depth of the near plane, 1e-9 to 1e9; nearer surfaces are not rendered.
        camera_from_world: (4, 4) float64, the left camera's pose, metres; with the identity, the world is the left
            camera's frame.
        model: (N,) int64, indices into the renderer's models.
        world_from_model: (N, 4, 4) float64, affine poses of the instances, metres.
        layer: (N,) int64, indices into the patch atlas; large patches follow the others.
        uv_scale: (N, 2) float64, patches per unit of the model's UV.
        uv_offset: (N, 2) float64, patches; patch coordinate = uv * uv_scale + uv_offset.
        sky: (N,) bool, whether each instance is infinitely far away; by default none is. Such an instance is behind all
            others. A camera anywhere sees the points of the sky in their directions from the world's origin.
        projector: the projector that lights the scene; with None, colours are those of the patches.

    Raises:
        InputError: where shapes or values are wrong.
    """

    camera: StereoCamera
    near_m: float
    camera_from_world: NDArray[np.float64]
    model: NDArray[np.int64]
    world_from_model: NDArray[np.float64]
    layer: NDArray[np.int64]
    uv_scale: NDArray[np.float64]
    uv_offset: NDArray[np.float64]
    sky: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    projector: Projector | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "near_m", to_real("near_m", self.near_m, LEAST, MOST))
        n = len(self.model)
        if not self.sky.any():
            object.__setattr__(self, "sky", np.zeros(n, bool))
        if self.sky.dtype != np.bool_:
            raise InputError(f"sky must be bool, got {self.sky.dtype}", argument="scene")
        shapes = {"camera_from_world": (4, 4), "model": (n,), "world_from_model": (n, 4, 4), "layer": (n,)}
        for name, shape in (shapes | {"uv_scale": (n, 2), "uv_offset": (n, 2), "sky": (n,)}).items():
            array = getattr(self, name)
            if array.shape != shape:
                text = f"{name} must have shape {shape} for {n} instances, got {array.shape}"
                raise InputError(text, argument="scene")
            check_magnitudes(f"scene: {name}", array)

    def __len__(self) -> int:
        return len(self.model)

    def near_of(self, eye: Eye) -> float:
        """Return the depth of one eye's near plane.

        A deviating right camera has a nearer plane, so that the plane cuts off nothing that the left camera shows.
        """
        return self.near_m if eye == "left" or self.camera.rectified else self.near_m * _DEVIATING_NEAR

    def view_from_model(self, which: int | EllipsisType = ...) -> NDArray[np.float64]:
        """Return the poses of all instances, (N, 4, 4), or of one, (4, 4), in the left camera's frame, float64."""
        pose: NDArray[np.float64] = self.camera_from_world @ self.world_from_model[which]
        sky = self.sky[which]
        if sky.any():
            # Only rotate the positions of infinitely distant instances.
            rotated = (self.camera_from_world[:3, :3] @ self.world_from_model[which][..., :3, 3:])[..., 0]
            pose[..., :3, 3] = np.where(sky[..., None], rotated, pose[..., :3, 3])
        return pose

    def offset_m(self, eye: Eye, which: int | EllipsisType = ...) -> NDArray[np.float64]:
        """Return x of an eye in the left camera's frame, 0 for the sky: (N,) metres for all instances, () for one."""
        return np.where(self.sky[which], 0.0, self.camera.offset_m(eye))


@dataclass(frozen=True, slots=True, eq=False)
class SceneMotion:
    """The motion of a scene's N instances to a target moment.

    Attributes:
        scene: the scene at the target moment; it has the same camera.
        world_from_model: (N, 4, 4) float64, poses of the N instances at the target moment.
        instance: (N,) int64, index of each instance in ``scene``; -1 for an instance that is not rendered at the target
            moment.

    Raises:
        InputError: where shapes or values are wrong.
    """

    scene: Scene
    world_from_model: NDArray[np.float64]
    instance: NDArray[np.int64]

    def __post_init__(self) -> None:
        n, target = len(self.instance), len(self.scene)
        if self.instance.shape != (n,) or self.world_from_model.shape != (n, 4, 4):
            shapes = f"{self.instance.shape} and {self.world_from_model.shape}"
            raise InputError(f"expected instance (N,) and world_from_model (N, 4, 4), got {shapes}", argument="motion")
        low, high = (int(self.instance.min()), int(self.instance.max())) if n else (-1, -1)
        if low < -1 or high >= target:
            raise InputError(f"instance must be -1 to {target - 1}, got {low} to {high}", argument="motion")
        check_magnitudes("motion: world_from_model", self.world_from_model)

    def seen_by(self, camera: StereoCamera) -> "SceneMotion":
        """Return the same motion with a different camera."""
        return replace(self, scene=replace(self.scene, camera=camera))


def transform_vertices(mesh: Mesh, target_from_model: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a model's vertices, (V, 3) float64, in the target frame of a pose (4, 4)."""
    return np.asarray(mesh.positions.astype(np.float64) @ target_from_model[:3, :3].T + target_from_model[:3, 3])


def move(scene: Scene, *, world_from_model: object = None, camera_from_world: object = None) -> SceneMotion:
    """Return the motion of a hand-made scene to a target moment, at which the same instances are rendered.

    Args:
        scene: the scene.
        world_from_model: (N, 4, 4) array-like, the instances' poses at the target moment; by default they stay.
        camera_from_world: (4, 4) array-like, the left camera's pose at the target moment; by default it stays.

    Raises:
        InputError: where shapes or values are wrong.
    """
    poses, camera = scene.world_from_model, scene.camera_from_world
    if world_from_model is not None:
        poses = to_array("world_from_model", world_from_model, np.float64)
    if camera_from_world is not None:
        camera = to_array("camera_from_world", camera_from_world, np.float64)
    target = replace(scene, world_from_model=poses, camera_from_world=camera)
    return SceneMotion(target, target.world_from_model, np.arange(len(scene)))


def make_scene(
    camera: StereoCamera,
    *,
    model: object,
    world_from_model: object,
    layer: object,
    uv_scale: object = (1.0, 1.0),
    uv_offset: object = (0.0, 0.0),
    camera_from_world: object = None,
    near_m: float = 0.01,
    sky: object = False,
    projector: Projector | None = None,
) -> Scene:
    """Make a `Scene` of N instances from array-likes; the arguments are its attributes.

    One value for all instances is enough for ``uv_scale`` and ``uv_offset``, (2,), and for ``sky``, a single bool. By
    default the left camera's pose is the identity.

    Raises:
        InputError: where shapes or values are wrong.
    """
    index = to_array("model", model, np.int64).reshape(-1)
    n = len(index)
    poses = to_array("world_from_model", world_from_model, np.float64)
    pose = np.eye(4) if camera_from_world is None else camera_from_world
    return Scene(
        camera=camera,
        near_m=near_m,
        camera_from_world=to_array("camera_from_world", pose, np.float64),
        model=index,
        world_from_model=poses.reshape(n, 4, 4) if poses.size == n * 16 else poses,
        layer=to_array("layer", layer, np.int64).reshape(-1),
        uv_scale=_for_each(to_array("uv_scale", uv_scale, np.float64), (n, 2)),
        uv_offset=_for_each(to_array("uv_offset", uv_offset, np.float64), (n, 2)),
        sky=_for_each(to_array("sky", sky, np.bool_), (n,)),
        projector=projector,
    )


def _for_each(array: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Repeat a value that all instances share; return an array of a wrong shape unchanged, for `Scene` to refuse."""
    try:
        return np.broadcast_to(array, shape)
    except ValueError:
        return array
