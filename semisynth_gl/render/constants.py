"""The uniform block that all shaders share, with constants of the camera and the pass. It is written once per pass."""

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Eye
from semisynth_gl.render.projection import clip_from_view
from semisynth_gl.scene.scene import Scene

_BINDING = 0
CONSTANTS = np.dtype(
    [
        ("clip_from_view", "<f4", (4, 4)),  # column by column
        ("centre_px", "<f4", 2),
        ("focal_px", "<f4", 2),
        ("focal_baseline", "<f4"),
        ("doffs_px", "<f4"),
        ("near_m", "<f4"),
        ("disparity_sign", "<f4"),
        ("disparity_floor_px", "<f4"),
        ("", "<f4", 3),
    ]
)
"""The uniform block of common_constants.glsl, std140."""

# LARGEST of common_constants.glsl. All signed disparities are above -LARGEST.
_LARGEST = 3e38


class ConstantsBuffer:
    """The uniform block's buffer, bound for the life of the context.

    With ``signed``, disparities of 0 and below are valid.
    """

    def __init__(self, gl: moderngl.Context, *, signed: bool = False) -> None:
        self._disparity_floor_px = -_LARGEST if signed else 0.0
        self._buffer = gl.buffer(reserve=CONSTANTS.itemsize, dynamic=True)
        self._buffer.bind_to_uniform_block(_BINDING)
        self._packed: bytes = b""

    def write(self, scene: Scene, eye: Eye, *, projection: NDArray[np.float64] | None = None) -> None:
        """Set the constants of the passes that follow.

        Args:
            scene: the scene.
            eye: in drawing and flow passes, the eye whose view is made. In the visibility and correspondence passes,
                the other eye: they look points up in its view.
            projection: (4, 4) float64 clip_from_view; by default the result of `clip_from_view`.
        """
        camera, near_m = scene.camera, scene.near_of(eye)
        values = np.zeros((), CONSTANTS)
        matrix = clip_from_view(camera, eye, near_m) if projection is None else projection
        values["clip_from_view"] = matrix.T
        cx, cy, fx, fy = camera.intrinsics_px(eye)
        values["centre_px"] = cx, cy
        values["focal_px"] = fx, fy
        values["focal_baseline"] = camera.focal_baseline
        values["doffs_px"] = camera.doffs_px
        values["near_m"] = near_m
        values["disparity_floor_px"] = self._disparity_floor_px
        # Only the visibility and correspondence passes use the sign of x_eye = x_other + sign * disparity.
        values["disparity_sign"] = -1 if eye == "right" else 1
        packed = values.tobytes()
        if packed != self._packed:
            self._buffer.orphan()
            self._buffer.write(packed)
            self._packed = packed
