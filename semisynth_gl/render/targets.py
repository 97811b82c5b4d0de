"""The framebuffers of one eye and one image size, created once and reused for every pair."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Crop
from semisynth_gl.frame.frame import CHANNELS, Pass
from semisynth_gl.inputs.errors import BackendError
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.readers import Reader, Viewport, read_array


@dataclass(frozen=True, slots=True)
class Attachment:
    """A texture that a pass draws into, with the components that are read back.

    ``kind`` is moderngl's name of the components' type, ``nothing`` their value where nothing is drawn.
    """

    components: int
    kind: str
    nothing: float

    @property
    def texture_components(self) -> int:
        """Components of the texture; formats of three cannot be drawn into everywhere."""
        return 4 if self.components == 3 else self.components


def _attachments(drawn_by: Pass) -> dict[str, Attachment]:
    attachments = {}
    for channel in CHANNELS.values():
        if channel.drawn_by == drawn_by:
            # Colours are stored as fractions of one, since the driver filters and averages them.
            kind = "f1" if channel.attachment == "colour" else f"{channel.dtype.kind}{channel.dtype.itemsize}"
            attachments[channel.attachment] = Attachment(channel.components, kind, channel.nothing)
    return attachments


DRAWING = {
    **_attachments("drawing"),
    "inverse_depth": Attachment(1, "f4", -1),
    "surface": Attachment(2, "u4", 0xFFFFFFFF),
}
"""Attachments of the drawing pass: its channels, 1 / Z, and the instance and triangle of each pixel."""
_GREY = Attachment(1, "f1", 0)
VISIBILITY = _attachments("visibility")
CORRESPONDENCE = {**_attachments("correspondence"), "disparity": DRAWING["disparity"], **VISIBILITY}
"""Attachments of the correspondence pass, which finds the disparity and the visibility of a pair that deviates too."""
FLOW = _attachments("flow")


def window(crop: Crop | None, size: tuple[int, int]) -> Viewport:
    """Return a crop of an image, or all of it, as OpenGL's rectangle; window y runs downwards with the image's."""
    return (0, 0, *size) if crop is None else (crop.x_px, crop.y_px, crop.width_px, crop.height_px)


class Targets:
    """A framebuffer of named attachments, whose size is width and height in px, and a depth buffer.

    Without one to share, ``depth_buffer`` is a new one of 24 bits. Texture look-ups return a pixel itself, and beyond
    the image the border's.

    Raises:
        BackendError: where the driver has no textures or framebuffers of that size.
    """

    def __init__(
        self,
        context: GraphicsContext,
        size: tuple[int, int],
        attachments: dict[str, Attachment],
        read: Reader,
        depth_buffer: moderngl.Renderbuffer | None = None,
    ) -> None:
        self._unbound, self._read, self._attachments = context.unbound, read, attachments
        self._owns_depth = depth_buffer is None
        gl = context.gl
        try:
            self._textures = {
                name: gl.texture(size, attachment.texture_components, dtype=attachment.kind)
                for name, attachment in attachments.items()
            }
            self.depth_buffer = gl.depth_renderbuffer(size) if depth_buffer is None else depth_buffer
            self.framebuffer = gl.framebuffer(list(self._textures.values()), self.depth_buffer)
        except moderngl.Error as error:
            raise BackendError(f"{context.renderer} cannot draw {size[0]} x {size[1]} px: {error}") from error
        for texture in self._textures.values():
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
            texture.repeat_x = texture.repeat_y = False

    @property
    def names(self) -> tuple[str, ...]:
        """The attachments' names, in their order."""
        return tuple(self._attachments)

    def limit(self, part: Crop | None) -> None:
        """Let the pass draw and clear inside a rectangle alone, until the next call; None is the whole image."""
        self.framebuffer.scissor = window(part, self.framebuffer.size)

    def bind(self, **units: int) -> None:
        """Bind attachments' textures to texture units, as in ``bind(depth=0)``."""
        for name, unit in units.items():
            self._textures[name].use(unit)

    def bind_to_images(self, **units: int) -> None:
        """Bind attachments' textures to image units, for a compute shader to write and to read."""
        for name, unit in units.items():
            self._textures[name].bind_to_image(unit, read=True, write=True)

    def read(self, name: str, crop: Crop | None = None) -> Any:  # noqa: ANN401 - whatever the reader returns
        """Let the reader take an attachment, or a crop of it: by default an array (H, W[, C]), top row first."""
        number, attachment = self.names.index(name), self._attachments[name]
        rectangle = window(crop, self.framebuffer.size)
        return self._read(self.framebuffer, rectangle, number, attachment.kind, attachment.components)

    def release(self) -> None:
        """Free everything; the framebuffer first, since it holds on to its attachments."""
        self.framebuffer.release()
        for texture in self._textures.values():
            texture.release()
        if self._owns_depth:
            self.depth_buffer.release()


class BlendTargets:
    """The colour of a drawing pass, which is blended into, and a copy of it to read from meanwhile.

    The drawing pass's depth is read and not written.
    """

    def __init__(self, context: GraphicsContext, colour: moderngl.Texture, depth_buffer: moderngl.Renderbuffer) -> None:
        self._gl, size = context.gl, colour.size
        try:
            self._copy = context.gl.texture(size, colour.components)
            self._copied = context.gl.framebuffer([self._copy])
            self._framebuffer = context.gl.framebuffer([colour], depth_buffer)
        except moderngl.Error as error:
            raise BackendError(f"{context.renderer} cannot draw {size[0]} x {size[1]} px: {error}") from error
        self._framebuffer.depth_mask = False
        self._copy.filter = (moderngl.NEAREST, moderngl.NEAREST)

    def use(self, part: Crop | None, unit: int) -> None:
        """Copy the drawing, bind the copy to a texture unit, and let a part of the image, or all, be blended into."""
        self._gl.copy_framebuffer(self._copied, self._framebuffer)
        self._copy.use(unit)
        self._framebuffer.scissor = window(part, self._framebuffer.size)
        self._framebuffer.use()

    def release(self) -> None:
        """Free everything."""
        for resource in (self._framebuffer, self._copied, self._copy):
            resource.release()


class EyeTargets(Targets):
    """The targets of one eye's drawing pass, with a 32-bit float depth buffer, and of its visibility pass.

    ``names`` are the attachments of the drawing pass, in the order of the shader's outputs. Besides `Targets`, it may
    have some for the ``visibility`` pass, for the pass that makes ``disparity`` of 1 / Z, and for ``blending`` into the
    colour.
    """

    def __init__(
        self,
        context: GraphicsContext,
        size: tuple[int, int],
        names: Iterable[str],
        *,
        visibility: bool,
        grey: bool = False,
        blended: bool = False,
        read: Reader = read_array,
    ) -> None:
        info = context.gl.info
        limit = min(int(info["GL_MAX_TEXTURE_SIZE"]), *(int(side) for side in info["GL_MAX_VIEWPORT_DIMS"]))
        if max(size) > limit:
            raise BackendError(
                f"an image of {size[0]} x {size[1]} px was asked for, but {context.renderer} goes up to "
                f"{limit} px a side: lower camera.width_px or camera.height_px"
            )
        attachments = {name: _GREY if grey and name == "colour" else DRAWING[name] for name in names}
        super().__init__(context, size, attachments, read)
        context.unbound.make_depth_float32(self.depth_buffer.glo, *size)
        self._depth_alone = context.gl.framebuffer(depth_attachment=self.depth_buffer)
        # No pass reads or writes depth there, so it shares the drawing pass's depth buffer.
        self.visibility = Targets(context, size, VISIBILITY, read, self.depth_buffer) if visibility else None
        self.disparity: Targets | None = None
        if "inverse_depth" in self._attachments:
            self.disparity = Targets(context, size, {"disparity": DRAWING["disparity"]}, read, self.depth_buffer)
        self.blending = BlendTargets(context, self._textures["colour"], self.depth_buffer) if blended else None

    def bind(self, **units: int) -> None:
        """Bind as `Targets.bind` does, also the disparity that is made of 1 / Z."""
        if self.disparity is not None and "disparity" in units:
            self.disparity.bind(disparity=units.pop("disparity"))
        super().bind(**units)

    def read(self, name: str, crop: Crop | None = None) -> Any:  # noqa: ANN401 - whatever the reader returns
        """Read as `Targets.read` does, also the disparity that is made of 1 / Z."""
        if self.disparity is not None and name == "disparity":
            return self.disparity.read(name, crop)
        return super().read(name, crop)

    def clear(self, *, depth: bool = True) -> None:
        """Bind the drawing pass's framebuffer and clear each attachment to its value for nothing, and the depth too."""
        self.framebuffer.use()
        for number, attachment in enumerate(self._attachments.values()):
            if attachment.kind.startswith("u"):
                self._unbound.clear_unsigned(number, int(attachment.nothing))
            else:
                self._unbound.clear_float(number, attachment.nothing)
        if depth:
            self._unbound.clear_depth(0.0)

    def use_depth(self, part: Crop | None) -> None:
        """Bind a framebuffer of the drawing pass's depth alone, for a part of the image or all of it."""
        self._depth_alone.scissor = window(part, self.framebuffer.size)
        self._depth_alone.use()

    def read_depth(self, part: Crop | None) -> NDArray[np.float32]:
        """Copy the depth buffer, or a part of it, out as (H, W) float32: near / Z, 0 where nothing is drawn."""
        rectangle = window(part, self.framebuffer.size)
        depth = np.empty((rectangle[3], rectangle[2]), np.float32)
        self._depth_alone.read_into(depth, rectangle, 1, attachment=-1, dtype="f4", alignment=1)
        return depth

    def release(self) -> None:
        """Free everything."""
        for shares_depth in (self.visibility, self.disparity, self.blending):
            if shares_depth is not None:
                shares_depth.release()
        self._depth_alone.release()
        super().release()
