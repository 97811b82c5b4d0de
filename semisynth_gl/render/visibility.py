"""The visibility pass: marks the pixels of one eye's image that the other eye sees too."""

import moderngl

from semisynth_gl.camera import OTHER_EYE, Crop, Eye
from semisynth_gl.render.constants import ConstantsBuffer
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.model_buffers import ModelBuffers, Placed
from semisynth_gl.render.programs import link_program
from semisynth_gl.render.targets import EyeTargets

# Texture units of visibility.frag.
_OWN_DISPARITY, _OTHER_DISPARITY, _OWN_SURFACE, _OTHER_SURFACE = range(4)


class VisibilityPass:
    """Three draws over the whole image, each for the pixels that the one before leaves undecided; see visibility.frag.

    Args:
        context: the open context.
        constants: its buffer of constants.
    """

    def __init__(self, context: GraphicsContext, constants: ConstantsBuffer) -> None:
        self._gl = context.gl
        self._constants = constants
        self._draws: list[moderngl.VertexArray] = []
        for defines in ({}, {"TRACE": 1}, {"TRACE": 2}):
            program = link_program(context, "whole_image.vert", "visibility.frag", defines)
            self._draws.append(context.gl.vertex_array(program, []))

    def draw(
        self, placed: Placed, eye: Eye, targets: dict[Eye, EyeTargets], models: ModelBuffers, crop: Crop | None
    ) -> None:
        """Fill the visibility of one eye's targets, or a crop of it, from both eyes' disparities and surfaces."""
        own, other = targets[eye], targets[OTHER_EYE[eye]]
        if own.visibility is None:
            raise RuntimeError("these targets were made without visibility")
        own.visibility.limit(crop)
        own.visibility.framebuffer.use()
        own.bind("disparity", _OWN_DISPARITY)
        own.bind("surface", _OWN_SURFACE)
        other.bind("disparity", _OTHER_DISPARITY)
        other.bind("surface", _OTHER_SURFACE)
        models.bind_triangles(placed, OTHER_EYE[eye])
        self._constants.write(placed.scene.camera, OTHER_EYE[eye], placed.scene.near_m)
        self._gl.enable_only(moderngl.DEPTH_TEST)
        # All draws stand at depth 0, where nothing drawn can be. Pixels that the first discards keep the drawing's
        # depth, and the others are drawn where that is so.
        for number, draw in enumerate(self._draws):
            self._gl.depth_func = "1" if number == 0 else "!="
            draw.render(moderngl.TRIANGLES, 3)
