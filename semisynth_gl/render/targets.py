"""Framebuffers with named attachments, created once for an image size and reused for every pair."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Crop, Eye
from semisynth_gl.frame.channels import CHANNELS
from semisynth_gl.inputs.errors import BackendError
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.instance_transforms import InstanceTransforms
from semisynth_gl.render.options import attachment_of, pass_of
from semisynth_gl.render.readers import PixelReader, Viewport, read_array


@dataclass(frozen=True, slots=True)
class Attachment:
    """A texture that a pass writes."""

    components: int  # components that are read back
    kind: str  # moderngl's name for the components' type, such as "f4"
    fill: float  # value in pixels that show nothing


def _attachments(pass_name: str) -> dict[str, Attachment]:
    """Return the attachments for all channels that a pass can write."""
    attachments = {}
    for channel in CHANNELS.values():
        if pass_of(channel) == pass_name:
            name = attachment_of(channel)
            # "f1" is a byte that means 0 to 1: shaders sample and average colours as floats.
            kind = "f1" if name == "colour" else f"{channel.dtype.kind}{channel.dtype.itemsize}"
            attachments[name] = Attachment(channel.components, kind, channel.fill)
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
"""Attachments of the correspondence pass, which also computes disparity and visibility where right cameras deviate."""
FLOW = _attachments("flow")


def viewport_of(crop: Crop | None, size: tuple[int, int]) -> Viewport:
    """Return a crop of an image, or all of it, as OpenGL's viewport; window y runs downwards like the image's y."""
    return (0, 0, *size) if crop is None else (crop.x_px, crop.y_px, crop.width_px, crop.height_px)


class Targets:
    """A framebuffer with named attachments and, if the caller passes one, a depth buffer.

    ``size`` is width and height, px; ``attachments`` are in the order of the shader's outputs. Shaders' look-ups in
    attachments are not filtered. Beyond the image, they return its nearest pixel.

    Raises BackendError where the driver has no textures or framebuffers of that size.
    """

    def __init__(
        self,
        context: GraphicsContext,
        size: tuple[int, int],
        attachments: dict[str, Attachment],
        read: PixelReader,
        depth_buffer: moderngl.Renderbuffer | None = None,
    ) -> None:
        self._functions, self._read, self.attachments = context.functions, read, attachments
        gl = context.gl
        try:
            # Some drivers cannot draw into formats of three components.
            self._textures = {
                name: gl.texture(size, 4 if each.components == 3 else each.components, dtype=each.kind)
                for name, each in attachments.items()
            }
            self.framebuffer = gl.framebuffer(list(self._textures.values()), depth_buffer)
        except moderngl.Error as error:
            raise BackendError(f"{context.renderer} cannot draw {size[0]} x {size[1]} px: {error}") from error
        for texture in self._textures.values():
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
            texture.repeat_x = texture.repeat_y = False

    @property
    def names(self) -> tuple[str, ...]:
        """The attachments' names, in their order."""
        return tuple(self.attachments)

    def limit(self, part: Crop | None) -> None:
        """Restrict drawing and clearing to a part of the image until the next call; None is the whole image."""
        self.framebuffer.scissor = viewport_of(part, self.framebuffer.size)

    def bind(self, **units: int) -> None:
        """Bind attachments' textures to texture units, for example ``bind(depth=0)``."""
        for name, unit in units.items():
            self._textures[name].use(unit)

    def bind_to_images(self, **units: int) -> None:
        """Bind attachments' textures to image units, for compute shaders to read and write."""
        for name, unit in units.items():
            self._textures[name].bind_to_image(unit, read=True, write=True)

    def read(self, name: str, crop: Crop | None = None) -> Any:  # noqa: ANN401 - whatever the reader returns
        """Return an attachment, or a crop of it, as the reader does: by default an array (H, W[, C]), top row first."""
        number, attachment = self.names.index(name), self.attachments[name]
        viewport = viewport_of(crop, self.framebuffer.size)
        return self._read(self.framebuffer, viewport, number, attachment.kind, attachment.components)

    def release(self) -> None:
        """Free all resources except the depth buffer; the framebuffer first, since it refers to its attachments."""
        self.framebuffer.release()
        for texture in self._textures.values():
            texture.release()


class BlendTargets:
    """A framebuffer to blend into the colour of a drawing pass, and a copy of that colour for shaders to read.

    Blending tests the drawing pass's depth, but does not write it.
    """

    def __init__(self, context: GraphicsContext, colour: moderngl.Texture, depth_buffer: moderngl.Renderbuffer) -> None:
        self._gl = context.gl
        self._copy = context.gl.texture(colour.size, colour.components)
        self._copied = context.gl.framebuffer([self._copy])
        self._framebuffer = context.gl.framebuffer([colour], depth_buffer)
        self._framebuffer.depth_mask = False
        self._copy.filter = (moderngl.NEAREST, moderngl.NEAREST)

    def use(self, part: Crop | None, unit: int) -> None:
        """Copy the colour, bind the copy to a texture unit, and bind the framebuffer for the image or a part of it."""
        self._gl.copy_framebuffer(self._copied, self._framebuffer)
        self._copy.use(unit)
        self._framebuffer.scissor = viewport_of(part, self._framebuffer.size)
        self._framebuffer.use()

    def release(self) -> None:
        """Free all resources except the colour and the depth buffer."""
        for resource in (self._framebuffer, self._copied, self._copy):
            resource.release()


class EyeTargets(Targets):
    """The targets of one eye's drawing pass, with a 32-bit float depth buffer.

    ``names`` are attachments of `DRAWING`, in the order of the shader's outputs. Raises BackendError as `Targets` does.

    Attributes:
        disparity: targets of the disparity that is computed from 1 / Z; None without the attachment "inverse_depth".
        blending: targets for blending outlines into the colour; None without ``blended``.
    """

    def __init__(
        self,
        context: GraphicsContext,
        size: tuple[int, int],
        names: Iterable[str],
        *,
        grey: bool = False,
        blended: bool = False,
        read: PixelReader = read_array,
    ) -> None:
        info = context.gl.info
        limit = min(int(info["GL_MAX_TEXTURE_SIZE"]), *(int(side) for side in info["GL_MAX_VIEWPORT_DIMS"]))
        if max(size) > limit:
            raise BackendError(
                f"an image of {size[0]} x {size[1]} px was asked for, but {context.renderer} goes up to "
                f"{limit} px a side: lower camera.width_px or camera.height_px, or the factor of antialias"
            )
        self._depth_buffer = context.gl.depth_renderbuffer(size)
        context.functions.make_depth_float32(self._depth_buffer.glo, *size)
        attachments = {name: _GREY if grey and name == "colour" else DRAWING[name] for name in names}
        super().__init__(context, size, attachments, read, self._depth_buffer)
        self._depth_only = context.gl.framebuffer(depth_attachment=self._depth_buffer)
        self.disparity: Targets | None = None
        if "inverse_depth" in self.attachments:
            self.disparity = Targets(context, size, {"disparity": DRAWING["disparity"]}, read)
        self.blending = BlendTargets(context, self._textures["colour"], self._depth_buffer) if blended else None

    def bind(self, **units: int) -> None:
        """Bind attachments as `Targets.bind` does, or the disparity that is computed from 1 / Z."""
        if self.disparity is not None and "disparity" in units:
            self.disparity.bind(disparity=units.pop("disparity"))
        super().bind(**units)

    def read(self, name: str, crop: Crop | None = None) -> Any:  # noqa: ANN401 - whatever the reader returns
        """Read an attachment as `Targets.read` does, or the disparity that is computed from 1 / Z."""
        if self.disparity is not None and name == "disparity":
            return self.disparity.read(name, crop)
        return super().read(name, crop)

    def clear(self, *, depth: bool = True) -> None:
        """Bind the drawing pass's framebuffer; clear each attachment to its ``fill`` and, by default, the depth."""
        self.framebuffer.use()
        for number, attachment in enumerate(self.attachments.values()):
            if attachment.kind.startswith("u"):
                self._functions.clear_unsigned(number, int(attachment.fill))
            else:
                self._functions.clear_float(number, attachment.fill)
        if depth:
            self._functions.clear_depth(0.0)

    def use_depth(self, part: Crop | None) -> None:
        """Bind a framebuffer with only the drawing pass's depth, restricted to a part of the image; None is all."""
        self._depth_only.scissor = viewport_of(part, self.framebuffer.size)
        self._depth_only.use()

    def read_depth(self, part: Crop | None) -> NDArray[np.float32]:
        """Return the depth buffer, or a part of it, as (H, W) float32: near / Z, and 0 where nothing is drawn."""
        viewport = viewport_of(part, self.framebuffer.size)
        depth = np.empty((viewport[3], viewport[2]), np.float32)
        self.framebuffer.read_into(depth, viewport, 1, attachment=-1, dtype="f4", alignment=1)
        return depth

    def release(self) -> None:
        """Free all resources."""
        if self.disparity is not None:
            self.disparity.release()
        if self.blending is not None:
            self.blending.release()
        self._depth_only.release()
        super().release()
        self._depth_buffer.release()


@dataclass(frozen=True, slots=True)
class EyeView:
    """One eye's view of a scene, to be drawn to targets."""

    transforms: InstanceTransforms  # the scene's instances
    eye: Eye
    part: Crop | None  # the part of the image that is drawn, or None for all of it
    targets: EyeTargets

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the part, px."""
        return viewport_of(self.part, self.targets.framebuffer.size)[2:]
