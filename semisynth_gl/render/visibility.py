"""The visibility pass: what of one eye's picture the other eye sees too."""

import moderngl

from semisynth_gl.camera import OTHER_EYE, Eye
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.model_buffers import ModelBuffers, Placed
from semisynth_gl.render.programs import link_program, set_uniform
from semisynth_gl.render.targets import EyeTargets

# Texture units.
_OWN_DISPARITY, _OTHER_DISPARITY, _OWN_SURFACE, _OTHER_SURFACE = range(4)


class VisibilityPass:
    """Three draws over the whole image, each for the pixels that the one before has left; see visibility.frag.

    Args:
        context: the open context.
    """

    def __init__(self, context: GraphicsContext) -> None:
        self._gl = context.gl
        self._draws: list[tuple[moderngl.Program, moderngl.VertexArray]] = []
        for defines in ({}, {"TRACE": 1}, {"TRACE": 2}):
            program = link_program(context, "whole_image.vert", "visibility.frag", defines)
            set_uniform(program, "own_disparity", _OWN_DISPARITY)
            set_uniform(program, "other_disparity", _OTHER_DISPARITY)
            if defines:
                set_uniform(program, "own_surface", _OWN_SURFACE)
                set_uniform(program, "other_surface", _OTHER_SURFACE)
            self._draws.append((program, context.gl.vertex_array(program, [])))

    def draw(self, placed: Placed, eye: Eye, targets: dict[Eye, EyeTargets], models: ModelBuffers) -> None:
        """Fill the visibility of one eye's targets from what both eyes' hold."""
        scene, camera = placed.scene, placed.scene.camera
        own, other = targets[eye], targets[OTHER_EYE[eye]]
        if own.visibility is None:
            raise RuntimeError("these targets were made without visibility")
        own.visibility.use()
        own.use("disparity", _OWN_DISPARITY)
        own.use("surface", _OWN_SURFACE)
        other.use("disparity", _OTHER_DISPARITY)
        other.use("surface", _OTHER_SURFACE)
        models.bind_for_tracing(placed, OTHER_EYE[eye])
        self._gl.enable_only(moderngl.DEPTH_TEST)
        # All draws stand at depth 0, where nothing drawn can be. What the first discards keeps the drawing's depth,
        # and the others are drawn where that is so.
        for number, (program, vao) in enumerate(self._draws):
            self._gl.depth_func = "1" if number == 0 else "!="
            set_uniform(program, "other_from_own", -1.0 if eye == "left" else 1.0)
            if number > 0:
                set_uniform(program, "focal_baseline", camera.focal_baseline)
                set_uniform(program, "doffs_px", camera.doffs_px)
                set_uniform(program, "focal_px", camera.focal_px)
                set_uniform(program, "near_m", scene.near_m)
                set_uniform(program, "traced_centre_px", (camera.cx_px(OTHER_EYE[eye]), camera.cy_px))
            vao.render(moderngl.TRIANGLES, 3)
