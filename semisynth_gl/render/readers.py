"""Who takes drawn pixels: by default arrays in the computer's memory, or whatever a reader makes of them."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Protocol

import moderngl

Viewport = tuple[int, int, int, int]
"""Left column, first row, width and height, px."""


class Reader(Protocol):
    """Makes something of an attachment's pixels that stands for the array of shape (H, W) or (H, W, C)."""

    def __call__(
        self,
        framebuffer: moderngl.Framebuffer,
        viewport: Viewport,
        attachment: int,
        kind: str,
        components: int,
        /,
    ) -> Any:  # noqa: ANN401 - whatever the caller works with
        """Take a rectangle of an attachment.

        Args:
            framebuffer: its context is current.
            viewport: which rectangle.
            attachment: which attachment.
            kind: what moderngl calls the type of a component: "f1", "u1", "u2", "f4" ...
            components: C, or 1 for (H, W).
        """


_reader: ContextVar[Reader | None] = ContextVar("reader", default=None)


def chosen_reader() -> Reader | None:
    """Return the reader in use, or None."""
    return _reader.get()


@contextmanager
def reading_by(reader: Reader) -> Iterator[None]:
    """Let a reader take what is drawn in the block: the frames hold what it makes instead of arrays."""
    token = _reader.set(reader)
    try:
        yield
    finally:
        _reader.reset(token)


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
        size = viewport[2] * viewport[3] * components * (1 if kind == "f1" else int(kind[1:]))
        if size not in self._buffers:
            self._buffers[size] = framebuffer.ctx.buffer(reserve=size)
        framebuffer.read_into(
            self._buffers[size], viewport, components, attachment=attachment, dtype=kind, alignment=1
        )
        return self._buffers[size]

    def release(self) -> None:
        """Free them; their context must be current."""
        for buffer in self._buffers.values():
            buffer.release()
        self._buffers = {}
