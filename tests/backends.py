"""Backends of OpenGL that this machine has, and the objects that a driver holds."""

import ctypes
from functools import cache

from semisynth_gl.inputs.errors import BackendError
from semisynth_gl.render import Backend
from semisynth_gl.render.context import open_context
from semisynth_gl.render.renderer import Renderer


@cache
def backend_fault(backend: Backend) -> str | None:
    """Why a backend cannot be used here, or None."""
    try:
        open_context(backend).release()
    except BackendError as error:
        return str(error)
    return None


def count_objects(renderer: Renderer) -> dict[str, int]:
    """How many objects the driver holds for a renderer, by kind; drivers hand out small names."""
    library = ctypes.CDLL("libOSMesa.so.8" if renderer.backend == "osmesa" else "libGL.so.1")
    with renderer._gl:  # noqa: SLF001 - nobody else has the context
        return {
            kind: sum(bool(getattr(library, f"glIs{kind}")(name) & 0xFF) for name in range(1, 2048))
            for kind in ("Texture", "Buffer", "Framebuffer", "Renderbuffer", "Program", "VertexArray")
        }
