"""Functions that read pixels from framebuffers, into arrays in main memory or into buffers of the driver."""

from typing import Any, Protocol

import moderngl
import numpy as np
from numpy.typing import NDArray

Viewport = tuple[int, int, int, int]
"""Left column, first row, width and height, px."""


class PixelReader(Protocol):
    """Reads pixels of an attachment, and returns them as an array (H, W) or (H, W, C), or as a tensor."""

    def __call__(
        self, framebuffer: moderngl.Framebuffer, viewport: Viewport, attachment: int, kind: str, components: int, /
    ) -> Any:  # noqa: ANN401 - whatever the caller works with
        """Read a rectangle of an attachment of a framebuffer whose context is current.

        ``attachment`` is the number of the colour attachment. ``kind`` is moderngl's name for the type of a component:
        "f1" (bytes that mean 0 to 1), "u1", "u2" or "f4". ``components`` is C, or 1 for (H, W).
        """


_DTYPES = {"f1": np.uint8, "u1": np.uint8, "u2": np.uint16, "f4": np.float32}


def read_array(
    framebuffer: moderngl.Framebuffer, viewport: Viewport, attachment: int, kind: str, components: int
) -> NDArray[Any]:
    """Return a rectangle of an attachment as a new array (H, W) or (H, W, C), top row first; see `PixelReader`."""
    shape = viewport[3], viewport[2]
    pixels = np.empty((*shape, components) if components > 1 else shape, _DTYPES[kind])
    # An alignment of 1 keeps rows tightly packed, even if their length is not a multiple of 4.
    framebuffer.read_into(pixels, viewport, components, attachment=attachment, dtype=kind, alignment=1)
    return pixels


class GpuPixelBuffers:
    """Buffers of the driver, into which pixels are copied without passing through main memory.

    There is one buffer for each size. The next `fill` of the same size overwrites it.
    """

    def __init__(self) -> None:
        self._buffers: dict[int, moderngl.Buffer] = {}

    def fill(
        self, framebuffer: moderngl.Framebuffer, viewport: Viewport, attachment: int, kind: str, components: int
    ) -> moderngl.Buffer:
        """Copy a rectangle of an attachment into a buffer, tightly packed, top row first; see `PixelReader`."""
        size = viewport[2] * viewport[3] * components * int(kind[1:])
        if size not in self._buffers:
            self._buffers[size] = framebuffer.ctx.buffer(reserve=size)
        framebuffer.read_into(self._buffers[size], viewport, components, attachment=attachment, dtype=kind, alignment=1)
        return self._buffers[size]

    def release(self) -> None:
        """Free the buffers; their context must be current."""
        for buffer in self._buffers.values():
            buffer.release()
        self._buffers = {}
