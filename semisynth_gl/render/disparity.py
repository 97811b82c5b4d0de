"""The disparity of a left view that several cameras share: from its 1 / Z, once for each camera."""

import moderngl

from semisynth_gl.frame.camera import Crop
from semisynth_gl.render.constants import ConstantsBuffer
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.placing import Placed
from semisynth_gl.render.programs import link_program
from semisynth_gl.render.targets import EyeTargets

# Texture unit of disparity.frag.
_INVERSE_DEPTH = 0


class DisparityPass:
    """Makes disparities of 1 / Z by the drawing pass's own formula, so that they are the same bit for bit.

    Args:
        context: the open context.
        constants: its buffer of constants.
    """

    def __init__(self, context: GraphicsContext, constants: ConstantsBuffer) -> None:
        self._context = context
        self._constants = constants
        program = link_program(context, "whole_image.vert", "disparity.frag", {})
        self._vao = context.gl.vertex_array(program, [])

    def draw(self, placed: Placed, targets: EyeTargets, part: Crop | None) -> None:
        """Fill the disparity of the left eye's targets, or a part of it, for the camera of the scene that is placed."""
        if targets.disparity is None:
            raise RuntimeError("these targets were made without 1 / Z")
        self._constants.write(placed.scene.camera, "left", placed.scene.near_m)
        targets.bind("inverse_depth", _INVERSE_DEPTH)
        targets.disparity.limit(part)
        with self._context.clock.timed("draw", "left"):
            targets.disparity.framebuffer.use()
            self._context.gl.enable_only(moderngl.NOTHING)
            self._vao.render(moderngl.TRIANGLES, 3)
