"""Framebuffers of supersampled colour, apart from those of the truth, which have one sample a pixel."""

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Crop
from semisynth_gl.inputs.errors import BackendError
from semisynth_gl.render.programs import link_program
from semisynth_gl.render.state import RenderState
from semisynth_gl.render.targets import window


class ColourTargets:
    """The framebuffers in which images of one size are drawn with "ssaa", one eye after the other.

    Args:
        state: the renderer's context, and what it is to draw.
        image_size: width and height, px.

    Attributes:
        fine: the framebuffer to draw into, with several pixels for one.

    Raises:
        BackendError: where the driver has no images as large as needed.
    """

    def __init__(self, state: RenderState, image_size: tuple[int, int]) -> None:
        context, factor = state.context, state.options.antialias.factor
        gl = context.gl
        self._gl, self._read, self._factor = gl, state.read, factor
        size = image_size[0] * factor, image_size[1] * factor
        if max(size) > int(gl.info["GL_MAX_TEXTURE_SIZE"]):
            raise BackendError(
                f"antialias ssaa{factor} draws {size[0]} x {size[1]} px, but {context.renderer} goes up to "
                f"{gl.info['GL_MAX_TEXTURE_SIZE']}: lower the factor or the image size"
            )
        # Not every driver can draw into formats of three components.
        stored, self._components = (1, 1) if state.patches.grey else (4, 3)
        self._colour = gl.texture(size, stored)
        self._depth_buffer = gl.depth_renderbuffer(size)
        context.unbound.make_depth_float32(self._depth_buffer.glo, *size)
        self.fine = gl.framebuffer([self._colour], self._depth_buffer)
        self._resolved = gl.texture(image_size, stored)
        self._resolve = gl.framebuffer([self._resolved])
        self._program = link_program(context, "whole_image.vert", "resolve.frag", {"FACTOR": factor})
        self._vao = gl.vertex_array(self._program, [])

    def limit(self, region: Crop | None) -> None:
        """Restrict drawing and clearing to a rectangle of the image until the next call; None lifts the restriction."""
        scale = self._factor
        x, y, width, height = window(region, self._resolve.size)
        self.fine.scissor = scale * x, scale * y, scale * width, scale * height
        self._resolve.scissor = x, y, width, height

    def resolve(self) -> None:
        """Average the pixels that were drawn into `fine` to those that `read_colour` reads."""
        self._resolve.use()
        self._gl.enable_only(moderngl.NOTHING)
        self._colour.use(0)
        self._vao.render(moderngl.TRIANGLES, 3)

    def read_colour(self, crop: Crop | None = None) -> NDArray[np.uint8]:
        """Return the resolved image, or a crop of it: by default (H, W, 3) uint8 RGB or (H, W) grey, top row first."""
        rectangle = window(crop, self._resolve.size)
        colour: NDArray[np.uint8] = self._read(self._resolve, rectangle, 0, "f1", self._components)
        return colour

    def release(self) -> None:
        """Free all framebuffers and programs."""
        framebuffers = self.fine, self._resolve, self._colour, self._depth_buffer, self._resolved
        for resource in (*framebuffers, self._vao, self._program):
            resource.release()
