"""Readers of drawn pixels: into arrays in the computer's memory by default, or into buffers of the driver."""

from typing import Any, Protocol

import moderngl
import numpy as np
from numpy.typing import NDArray

Viewport = tuple[int, int, int, int]
"""Left column, first row, width and height, px."""


class Reader(Protocol):
    """Makes something of an attachment's pixels that stands for the array of shape (H, W) or (H, W, C)."""

    def __call__(
        self, framebuffer: moderngl.Framebuffer, viewport: Viewport, attachment: int, kind: str, components: int, /
    ) -> Any:  # noqa: ANN401 - whatever the caller works with
        """Take a rectangle of an attachment of a framebuffer whose context is current.

        ``kind`` is what moderngl calls the type of a component: "f1", "u1", "u2", "f4" ...; ``components`` is C, or 1
        for (H, W).
        """


_DTYPES = {"f1": np.uint8, "u1": np.uint8, "u2": np.uint16, "f4": np.float32}


def read_array(
    framebuffer: moderngl.Framebuffer, viewport: Viewport, attachment: int, kind: str, components: int
) -> NDArray[Any]:
    """Copy a rectangle of an attachment out as (H, W) or (H, W, C), top row first; see `Reader`."""
    shape = viewport[3], viewport[2]
    pixels = np.empty((*shape, components) if components > 1 else shape, _DTYPES[kind])
    # An alignment of 1 keeps rows tightly packed: 3 * 941 bytes is no multiple of 4.
    framebuffer.read_into(pixels, viewport, components, attachment=attachment, dtype=kind, alignment=1)
    return pixels


class PixelBuffers:
    """Buffers of the driver that pixels are copied into, without a way through the computer's memory.

    One for each size, reused: what is in it has to be taken before the next of that size.
    """

    def __init__(self) -> None:
        self._buffers: dict[int, moderngl.Buffer] = {}

    def fill(
        self, framebuffer: moderngl.Framebuffer, viewport: Viewport, attachment: int, kind: str, components: int
    ) -> moderngl.Buffer:
        """Copy a rectangle of an attachment; rows are tight, and the first one is the top."""
        size = viewport[2] * viewport[3] * components * int(kind[1:])
        if size not in self._buffers:
            self._buffers[size] = framebuffer.ctx.buffer(reserve=size)
        framebuffer.read_into(self._buffers[size], viewport, components, attachment=attachment, dtype=kind, alignment=1)
        return self._buffers[size]

    def release(self) -> None:
        """Free them; their context must be current."""
        for buffer in self._buffers.values():
            buffer.release()
        self._buffers = {}
