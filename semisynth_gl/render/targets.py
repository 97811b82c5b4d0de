"""The framebuffers of one eye and one image size, made once and reused for every pair."""

from collections.abc import Collection
from typing import TypeVar

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.errors import BackendError
from semisynth_gl.frame import Output
from semisynth_gl.render.context import GraphicsContext

_Scalar = TypeVar("_Scalar", bound=np.generic)


class EyeTargets:
    """What one eye draws into.

    Attributes:
        drawing: framebuffer of the drawing pass, with a 32-bit float depth buffer: colour (unless it is antialiased
            elsewhere), planar depth, and the surface where an output needs it.
        truth: framebuffer of the truth pass: disparity, and visibility and instances where they are asked for.
        depth_m: R32F, planar depth in metres; 0 where nothing is drawn.
        surface: RG32UI, instance and triangle; without meaning where nothing is drawn.

    Args:
        context: the open context.
        width_px: image width.
        height_px: image height.
        outputs: what is asked for beside images and disparity.
        colour: whether the drawing pass has colour.

    Raises:
        BackendError: where the driver has no textures or framebuffers of that size.
    """

    def __init__(
        self, context: GraphicsContext, width_px: int, height_px: int, outputs: Collection[Output], *, colour: bool
    ) -> None:
        gl, size = context.gl, (width_px, height_px)
        limit = min(int(gl.info["GL_MAX_TEXTURE_SIZE"]), *(int(side) for side in gl.info["GL_MAX_VIEWPORT_DIMS"]))
        if max(size) > limit:
            raise BackendError(
                f"an image of {width_px} x {height_px} px was asked for, but {context.renderer} goes up to "
                f"{limit} px a side: lower camera.width_px or camera.height_px"
            )
        try:
            self.depth_m = gl.texture(size, 1, dtype="f4")
            self.surface = gl.texture(size, 2, dtype="u4") if needs_surface(outputs) else None
            self._colour = gl.texture(size, 4) if colour else None
            self._disparity = gl.texture(size, 1, dtype="f4")
            self._visibility = gl.texture(size, 1, dtype="u1") if "visibility" in outputs else None
            self._instances = gl.texture(size, 1, dtype="u2") if "instances" in outputs else None
            self._depth_buffer = gl.depth_renderbuffer(size)
            context.unbound.make_depth_float32(self._depth_buffer.glo, width_px, height_px)
            self._drawn = _present(self._colour, self.depth_m, self.surface)
            self._derived = _present(self._disparity, self._visibility, self._instances)
            self.drawing = gl.framebuffer(self._drawn, self._depth_buffer)
            # The truth pass marks decided pixels in the depth buffer that the drawing pass has done with.
            self.truth = gl.framebuffer(self._derived, self._depth_buffer)
        except moderngl.Error as error:
            raise BackendError(f"{context.renderer} cannot draw {width_px} x {height_px} px: {error}") from error
        for texture in (*self._drawn, *self._derived):
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)

    def read_colour(self) -> NDArray[np.uint8]:
        """Copy the colour out as (H, W, 3) uint8 RGB, top row first."""
        width, height = self.drawing.size
        pixels = np.empty((height, width, 3), np.uint8)
        # An alignment of 1 keeps rows tightly packed: 3 * 941 bytes is no multiple of 4.
        self.drawing.read_into(pixels, components=3, attachment=0, alignment=1)
        return pixels

    def read_disparity(self) -> NDArray[np.float32]:
        """Copy the disparity out as (H, W) float32 px, top row first."""
        return self._read(self.truth, self._derived.index(self._disparity), np.float32, "f4")

    def read_visibility(self) -> NDArray[np.uint8] | None:
        """Copy the visibility out as (H, W) uint8, or None where it was not asked for."""
        if self._visibility is None:
            return None
        return self._read(self.truth, self._derived.index(self._visibility), np.uint8, "u1")

    def read_instances(self) -> NDArray[np.uint16] | None:
        """Copy the instance ids out as (H, W) uint16, or None where they were not asked for."""
        if self._instances is None:
            return None
        return self._read(self.truth, self._derived.index(self._instances), np.uint16, "u2")

    def read_depth(self) -> NDArray[np.float32]:
        """Copy the planar depth out as (H, W) float32 m, inf where nothing is drawn."""
        depth_m = self._read(self.drawing, self._drawn.index(self.depth_m), np.float32, "f4")
        depth_m[depth_m == 0] = np.inf
        return depth_m

    def _read(
        self, framebuffer: moderngl.Framebuffer, attachment: int, dtype: type[_Scalar], name: str
    ) -> NDArray[_Scalar]:
        width, height = framebuffer.size
        pixels = np.empty((height, width), dtype)
        framebuffer.read_into(pixels, components=1, attachment=attachment, dtype=name, alignment=1)
        return pixels

    def release(self) -> None:
        """Free everything; framebuffers first, since they hold on to their attachments."""
        for framebuffer in (self.drawing, self.truth):
            framebuffer.release()
        for texture in (*self._drawn, *self._derived):
            texture.release()
        self._depth_buffer.release()


def needs_surface(outputs: Collection[Output]) -> bool:
    """Whether an output is made from the triangle and instance that each pixel shows."""
    return "visibility" in outputs or "instances" in outputs


def _present(*textures: moderngl.Texture | None) -> list[moderngl.Texture]:
    return [texture for texture in textures if texture is not None]
