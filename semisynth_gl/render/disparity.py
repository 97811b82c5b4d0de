"""The disparity of a left view that several cameras share: from its 1 / Z, once for each camera."""

from math import ceil

from semisynth_gl.camera import Crop
from semisynth_gl.render.constants import ConstantsBuffer
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.model_buffers import Placed
from semisynth_gl.render.programs import link_compute
from semisynth_gl.render.targets import EyeTargets

# Texture unit and image unit of disparity.comp, and its pixels that work together.
_INVERSE_DEPTH, _DISPARITY = 0, 0
_GROUP_PX = 16, 4


class DisparityPass:
    """Makes disparities of 1 / Z by the drawing pass's own formula, so that they are the same bit for bit.

    Args:
        context: the open context.
        constants: its buffer of constants.
    """

    def __init__(self, context: GraphicsContext, constants: ConstantsBuffer) -> None:
        self._context = context
        self._constants = constants
        self._program = link_compute(context, "disparity.comp", {})

    def draw(self, placed: Placed, targets: EyeTargets, part: Crop | None) -> None:
        """Fill the disparity of the left eye's targets, or a part of it, for the camera of the scene that is placed."""
        if targets.disparity is None:
            raise RuntimeError("these targets were made without 1 / Z")
        scene, part = placed.scene, part or Crop(0, 0, *targets.framebuffer.size)
        self._constants.write(scene.camera, "left", scene.near_m)
        targets.bind("inverse_depth", _INVERSE_DEPTH)
        targets.disparity.bind_to_image("disparity", _DISPARITY)
        self._program["part"] = part.x_px, part.y_px, part.width_px, part.height_px
        with self._context.clock.timed("draw", "left"):
            self._program.run(ceil(part.width_px / _GROUP_PX[0]), ceil(part.height_px / _GROUP_PX[1]))
            self._context.gl.memory_barrier()
