"""The framebuffers of one image size, made once and reused for every pair."""

from dataclasses import dataclass

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.errors import BackendError
from semisynth_gl.render.context import GraphicsContext


@dataclass(frozen=True, slots=True, eq=False)
class EyeTargets:
    """What one eye draws into.

    Attributes:
        surface: framebuffer of the drawing pass: ``colour`` and ``depth_m``, with a 32-bit float depth buffer.
        truth: framebuffer of the truth pass: ``disparity`` and ``visibility``.
        colour: RGBA8.
        depth_m: R32F, planar depth in metres; 0 where nothing is drawn.
        disparity: R32F, px.
        visibility: R8UI.
    """

    surface: moderngl.Framebuffer
    truth: moderngl.Framebuffer
    colour: moderngl.Texture
    depth_m: moderngl.Texture
    disparity: moderngl.Texture
    visibility: moderngl.Texture
    _depth_buffer: moderngl.Renderbuffer

    @classmethod
    def create(cls, context: GraphicsContext, width_px: int, height_px: int) -> "EyeTargets":
        """Make the attachments.

        Raises:
            BackendError: where the driver has no textures or framebuffers of that size.
        """
        gl, size = context.gl, (width_px, height_px)
        limit = min(int(gl.info["GL_MAX_TEXTURE_SIZE"]), *(int(side) for side in gl.info["GL_MAX_VIEWPORT_DIMS"]))
        if max(size) > limit:
            raise BackendError(
                f"an image of {width_px} x {height_px} px was asked for, but {context.renderer} goes up to "
                f"{limit} px a side: lower camera.width_px or camera.height_px"
            )
        try:
            colour = gl.texture(size, 4)
            depth_m = gl.texture(size, 1, dtype="f4")
            disparity = gl.texture(size, 1, dtype="f4")
            visibility = gl.texture(size, 1, dtype="u1")
            depth_buffer = gl.depth_renderbuffer(size)
            context.unbound.make_depth_float32(depth_buffer.glo, width_px, height_px)
            surface = gl.framebuffer([colour, depth_m], depth_buffer)
            truth = gl.framebuffer([disparity, visibility])
        except moderngl.Error as error:
            raise BackendError(f"{context.renderer} cannot draw {width_px} x {height_px} px: {error}") from error
        for texture in (depth_m, disparity, visibility):
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        return cls(surface, truth, colour, depth_m, disparity, visibility, depth_buffer)

    def read_colour(self) -> NDArray[np.uint8]:
        """Copy the colour out as (H, W, 3) uint8 RGB, top row first."""
        width, height = self.surface.size
        pixels = np.empty((height, width, 3), np.uint8)
        # An alignment of 1 keeps rows tightly packed: 3 * 941 bytes is no multiple of 4.
        self.surface.read_into(pixels, components=3, attachment=0, alignment=1)
        return pixels

    def read_disparity(self) -> NDArray[np.float32]:
        """Copy the disparity out as (H, W) float32 px, top row first."""
        width, height = self.truth.size
        pixels = np.empty((height, width), np.float32)
        self.truth.read_into(pixels, components=1, attachment=0, dtype="f4", alignment=1)
        return pixels

    def read_visibility(self) -> NDArray[np.uint8]:
        """Copy the visibility out as (H, W) uint8, top row first."""
        width, height = self.truth.size
        pixels = np.empty((height, width), np.uint8)
        self.truth.read_into(pixels, components=1, attachment=1, dtype="u1", alignment=1)
        return pixels

    def release(self) -> None:
        """Free everything; framebuffers first, since they hold on to their attachments."""
        for resource in (
            *(self.surface, self.truth, self.colour, self.depth_m, self.disparity, self.visibility),
            self._depth_buffer,
        ):
            resource.release()
