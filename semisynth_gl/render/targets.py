"""The framebuffers of one eye and one image size, made once and reused for every pair."""

from collections.abc import Sequence
from typing import Any, Literal

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.camera import Crop
from semisynth_gl.errors import BackendError
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.readers import Reader, read_array

Attachment = Literal["colour", "disparity", "depth", "instances", "surface"]

# Components and moderngl's type of each attachment, and what it holds where nothing is drawn. Nothing is read of a
# surface there.
_FORMATS: dict[Attachment, tuple[int, str]] = {
    "colour": (4, "f1"),
    "disparity": (1, "f4"),
    "depth": (1, "f4"),
    "instances": (1, "u2"),
    "surface": (2, "u4"),
}
_NOTHING: dict[Attachment, float] = {"colour": 0.0, "disparity": np.inf, "depth": np.inf, "instances": 0, "surface": 0}


def window(crop: Crop | None, size: tuple[int, int]) -> tuple[int, int, int, int]:
    """A crop of an image, or all of it, as OpenGL's rectangle; window y runs downwards with the image's."""
    return (0, 0, *size) if crop is None else (crop.x_px, crop.y_px, crop.width_px, crop.height_px)


def take(
    read: Reader, framebuffer: moderngl.Framebuffer, crop: Crop | None, attachment: int, kind: str, components: int = 1
) -> NDArray[Any]:
    """Let a reader take a crop of an attachment, or all of it; see `Reader`."""
    taken: NDArray[Any] = read(framebuffer, window(crop, framebuffer.size), attachment, kind, components)
    return taken


class EyeTargets:
    """What one eye draws into.

    Attributes:
        drawing: framebuffer of the drawing pass, with a 32-bit float depth buffer.
        visibility: framebuffer of the visibility pass, or None.

    Args:
        context: the open context.
        width_px: image width.
        height_px: image height.
        attachments: of the drawing pass, in the order of the shader's outputs.
        visibility: whether there is a visibility pass.
        read: what takes pixels.

    Raises:
        BackendError: where the driver has no textures or framebuffers of that size.
    """

    def __init__(
        self,
        context: GraphicsContext,
        width_px: int,
        height_px: int,
        attachments: Sequence[Attachment],
        *,
        visibility: bool,
        read: Reader = read_array,
    ) -> None:
        gl, size = context.gl, (width_px, height_px)
        limit = min(int(gl.info["GL_MAX_TEXTURE_SIZE"]), *(int(side) for side in gl.info["GL_MAX_VIEWPORT_DIMS"]))
        if max(size) > limit:
            raise BackendError(
                f"an image of {width_px} x {height_px} px was asked for, but {context.renderer} goes up to "
                f"{limit} px a side: lower camera.width_px or camera.height_px"
            )
        self._unbound = context.unbound
        self._read = read
        self._attachments = tuple(attachments)
        try:
            self._textures = {
                name: gl.texture(size, _FORMATS[name][0], dtype=_FORMATS[name][1]) for name in attachments
            }
            self._visibility = gl.texture(size, 1, dtype="u1") if visibility else None
            self._depth_buffer = gl.depth_renderbuffer(size)
            context.unbound.make_depth_float32(self._depth_buffer.glo, width_px, height_px)
            self.drawing = gl.framebuffer(list(self._textures.values()), self._depth_buffer)
            # The visibility pass marks decided pixels in the depth buffer that the drawing pass has done with.
            self.visibility = gl.framebuffer([self._visibility], self._depth_buffer) if self._visibility else None
        except moderngl.Error as error:
            raise BackendError(f"{context.renderer} cannot draw {width_px} x {height_px} px: {error}") from error
        for texture in self._textures.values():
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
            texture.repeat_x = texture.repeat_y = False

    def limit(self, drawing: Crop | None, visibility: Crop | None) -> None:
        """Let each pass draw, and clear, inside a rectangle alone, until the next call; None is the whole image."""
        for framebuffer, rectangle in ((self.drawing, drawing), (self.visibility, visibility)):
            if framebuffer is not None:
                framebuffer.scissor = window(rectangle, framebuffer.size)

    def clear(self) -> None:
        """Bind the drawing pass's framebuffer and clear it to what stands where nothing is drawn."""
        self.drawing.use()
        for number, name in enumerate(self._attachments):
            if _FORMATS[name][1].startswith("u"):
                self._unbound.clear_unsigned(number, int(_NOTHING[name]))
            else:
                self._unbound.clear_float(number, _NOTHING[name])
        self._unbound.clear_depth(0.0)

    def use(self, name: Attachment, unit: int) -> None:
        """Bind an attachment's texture to a texture unit."""
        self._textures[name].use(unit)

    def read_colour(self, crop: Crop | None = None) -> NDArray[np.uint8]:
        """Copy the colour out as (H, W, 3) uint8 RGB, top row first."""
        return take(self._read, self.drawing, crop, self._attachments.index("colour"), "f1", 3)

    def read_disparity(self, crop: Crop | None = None) -> NDArray[np.float32]:
        """Copy the disparity out as (H, W) float32 px, top row first; inf where nothing is drawn."""
        return take(self._read, self.drawing, crop, self._attachments.index("disparity"), "f4")

    def read_depth(self, crop: Crop | None = None) -> NDArray[np.float32]:
        """Copy the planar depth out as (H, W) float32 m; inf where nothing is drawn."""
        return take(self._read, self.drawing, crop, self._attachments.index("depth"), "f4")

    def read_instances(self, crop: Crop | None = None) -> NDArray[np.uint16]:
        """Copy the instance ids out as (H, W) uint16; 0 where nothing is drawn."""
        return take(self._read, self.drawing, crop, self._attachments.index("instances"), "u2")

    def read_surface(self, crop: Crop | None = None) -> NDArray[np.uint32]:
        """Copy instance and triangle out as (H, W, 2) uint32; without meaning where nothing is drawn."""
        return take(self._read, self.drawing, crop, self._attachments.index("surface"), "u4", 2)

    def read_visibility(self, crop: Crop | None = None) -> NDArray[np.uint8]:
        """Copy the visibility out as (H, W) uint8."""
        if self.visibility is None:
            raise RuntimeError("these targets were made without visibility")
        return take(self._read, self.visibility, crop, 0, "u1")

    def release(self) -> None:
        """Free everything; framebuffers first, since they hold on to their attachments."""
        for resource in (self.drawing, self.visibility, *self._textures.values(), self._visibility, self._depth_buffer):
            if resource is not None:
                resource.release()


class FlowTargets:
    """What the flow pass draws into, for one eye and moment after the other.

    Attributes:
        drawing: its framebuffer, with a depth buffer that tells which pixels are decided.

    Args:
        context: the open context.
        width_px: image width.
        height_px: image height.
        read: what takes pixels.

    Raises:
        BackendError: where the driver has no textures or framebuffers of that size.
    """

    def __init__(self, context: GraphicsContext, width_px: int, height_px: int, read: Reader) -> None:
        gl, size = context.gl, (width_px, height_px)
        self._unbound = context.unbound
        self._read = read
        try:
            self._textures = [gl.texture(size, 2, dtype="f4"), gl.texture(size, 1, dtype="f4")]
            self._textures.append(gl.texture(size, 1, dtype="u1"))
            self._depth_buffer = gl.depth_renderbuffer(size)
            self.drawing = gl.framebuffer(self._textures, self._depth_buffer)
        except moderngl.Error as error:
            raise BackendError(f"{context.renderer} cannot draw {width_px} x {height_px} px: {error}") from error

    def clear(self, region: Crop | None) -> None:
        """Bind the framebuffer, let it be drawn inside a rectangle alone, and leave all its pixels undecided."""
        self.drawing.scissor = window(region, self.drawing.size)
        self.drawing.use()
        self._unbound.clear_depth(1.0)

    def read_flow(self, crop: Crop | None = None) -> NDArray[np.float32]:
        """Copy the flow out as (H, W, 2) float32 px, top row first; inf where there is none."""
        return take(self._read, self.drawing, crop, 0, "f4", 2)

    def read_disparity_change(self, crop: Crop | None = None) -> NDArray[np.float32]:
        """Copy the change of disparity out as (H, W) float32 px, top row first; inf where there is none."""
        return take(self._read, self.drawing, crop, 1, "f4")

    def read_visibility(self, crop: Crop | None = None) -> NDArray[np.uint8]:
        """Copy the visibility out as (H, W) uint8."""
        return take(self._read, self.drawing, crop, 2, "u1")

    def release(self) -> None:
        """Free everything; the framebuffer first, since it holds on to its attachments."""
        self.drawing.release()
        for texture in self._textures:
            texture.release()
        self._depth_buffer.release()
