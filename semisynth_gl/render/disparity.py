"""The disparity of a left view that several cameras share: from its 1 / Z, once for each camera."""

import moderngl

from semisynth_gl.frame.camera import Crop
from semisynth_gl.render.loaded import Loaded
from semisynth_gl.render.programs import link_program
from semisynth_gl.render.targets import EyeTargets
from semisynth_gl.scene.scene import Scene


class DisparityPass:
    """Makes disparities of 1 / Z by the drawing pass's own formula, so that they are the same bit for bit."""

    def __init__(self, loaded: Loaded) -> None:
        self._loaded = loaded
        program = link_program(loaded.context, "whole_image.vert", "disparity.frag", {})
        self._vao = loaded.context.gl.vertex_array(program, [])

    def draw(self, scene: Scene, targets: EyeTargets, part: Crop | None) -> None:
        """Fill the disparity of the left eye's targets, or a part of it, for the scene's camera."""
        if targets.disparity is None:
            raise RuntimeError("these targets were made without 1 / Z")
        context = self._loaded.context
        self._loaded.constants.write(scene, "left")
        targets.bind(inverse_depth=0)
        targets.disparity.limit(part)
        with context.clock.timed("draw", "left"):
            targets.disparity.framebuffer.use()
            context.gl.enable_only(moderngl.NOTHING)
            self._vao.render(moderngl.TRIANGLES, 3)
