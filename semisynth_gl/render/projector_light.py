"""The light of a scene's projector, for mesh.frag: its pattern, and a depth map of the surfaces that it lights."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Eye, StereoCamera
from semisynth_gl.inputs.arguments import LEAST
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.render.instance_transforms import InstanceTransforms
from semisynth_gl.render.resources import RenderResources
from semisynth_gl.render.targets import EyeTargets, EyeView
from semisynth_gl.scene.scene import Projector

PROJECTOR = np.dtype(
    [
        ("projector_from_window", "<f4", (4, 4)),  # column by column
        ("middle_px", "<f4", 2),
        ("projector_focal_px", "<f4"),
        ("power", "<f4"),
        ("ambient", "<f4"),
        ("", "<f4", 3),
    ]
)
"""The uniform block of common_projector.glsl, std140."""

# Uniform block and texture units of common_projector.glsl.
_BINDING, _PATTERN, _DEPTH = 1, 2, 3
# The projector's near plane divided by the camera's. Surfaces may be nearer to the projector than to the camera.
_NEAR_RATIO = 0.1


class ProjectorLight:
    """The light of projectors with one pattern, (H, W) uint8.

    Raises InputError if the pattern has a wrong shape or type, and BackendError if the driver has no images of its
    size.
    """

    def __init__(self, resources: RenderResources, pattern: NDArray[np.uint8]) -> None:
        if not (isinstance(pattern, np.ndarray) and pattern.ndim == 2 and pattern.dtype == np.uint8 and pattern.size):
            raise InputError(f"pattern must be (H, W) uint8, got {np.shape(pattern)} {getattr(pattern, 'dtype', '')}")
        gl = resources.context.gl
        self._size = pattern.shape[1], pattern.shape[0]
        self._targets = EyeTargets(resources.context, self._size, ("depth",))
        self._pattern = gl.texture(self._size, 1, np.ascontiguousarray(pattern), alignment=1)
        self._pattern.repeat_x = self._pattern.repeat_y = False
        self._buffer = gl.buffer(reserve=PROJECTOR.itemsize, dynamic=True)
        self._buffer.bind_to_uniform_block(_BINDING)
        self._depth_of: InstanceTransforms | None = None

    def draw_depth(self, transforms: InstanceTransforms, draw_view: Callable[[EyeView], None]) -> None:
        """Draw the depth map of a scene's projector, if it has one, unless the last call had the same transforms."""
        projector = transforms.scene.projector
        if projector is not None and transforms is not self._depth_of:
            draw_view(EyeView(_seen_by(projector, transforms, self._size), "left", None, self._targets))
            self._depth_of = transforms

    def bind(self, projector: Projector, camera: StereoCamera, eye: Eye, width_px: int) -> None:
        """Bind all that common_projector.glsl needs to draw one eye's image at a width of ``width_px``."""
        values = np.zeros((), PROJECTOR)
        values["projector_from_window"] = _projector_from_window(projector, camera, eye, width_px).T
        values["middle_px"] = (self._size[0] - 1) / 2, (self._size[1] - 1) / 2
        values["projector_focal_px"] = projector.focal_px
        values["power"], values["ambient"] = projector.power, projector.ambient
        self._buffer.orphan()
        self._buffer.write(values.tobytes())
        self._pattern.use(_PATTERN)
        self._targets.bind(depth=_DEPTH)


def _seen_by(projector: Projector, transforms: InstanceTransforms, size: tuple[int, int]) -> InstanceTransforms:
    """Return the same instances for a left eye in the projector's place, with its image of ``size``."""
    scene, projector_from_camera = transforms.scene, projector.projector_from_camera
    view_from_model = projector_from_camera @ transforms.view_from_model
    view_from_model[scene.sky, :3, 3] -= projector_from_camera[:3, 3]  # directions of the sky are only rotated
    # Any baseline will do; only the left eye is drawn.
    camera = StereoCamera.centred(*size, projector.focal_px, 1.0)
    near_m = max(scene.near_m * _NEAR_RATIO, LEAST)
    pose = projector_from_camera @ scene.camera_from_world
    seen = replace(scene, camera=camera, near_m=near_m, camera_from_world=pose, projector=None)
    return replace(transforms, scene=seen, view_from_model=view_from_model)


def _projector_from_window(projector: Projector, camera: StereoCamera, eye: Eye, width_px: int) -> NDArray[np.float64]:
    """Return the matrix M (4, 4) of a fragment's point P in the projector's frame: P / Z = M (x, y, 1, 1 / Z).

    (x, y) is the fragment's position in a window of ``width_px``, and Z its depth in the eye's frame.
    """
    cx, cy, fx, fy = camera.intrinsics_px(eye)
    scale = width_px / camera.width_px
    # The window's x is at x / scale - 1 / 2 in the image.
    view_from_window = np.array(
        [[1 / scale / fx, 0, (-0.5 - cx) / fx], [0, 1 / scale / fy, (-0.5 - cy) / fy], [0, 0, 1.0]]
    )
    turn = camera.turn(eye)
    left_from_eye = np.eye(3) if turn is None else turn.T
    rotation, shift = projector.projector_from_camera[:3, :3], projector.projector_from_camera[:3, 3]
    matrix = np.eye(4)
    matrix[:3, :3] = rotation @ left_from_eye @ view_from_window
    matrix[:3, 3] = rotation @ [camera.offset_m(eye), 0, 0] + shift
    return matrix
