"""Which OpenGL backends work on this machine, and how many objects a driver holds."""

import ctypes
from functools import cache

from semisynth_gl.inputs.errors import BackendError
from semisynth_gl.render import Backend
from semisynth_gl.render.context import open_context
from semisynth_gl.render.renderer import Renderer


@cache
def backend_fault(backend: Backend) -> str | None:
    """Return the error of a backend that does not open here; None if it opens."""
    try:
        open_context(backend).release()
    except BackendError as error:
        return str(error)
    return None


def count_objects(renderer: Renderer) -> dict[str, int]:
    """Count a renderer's OpenGL objects by kind. Drivers number objects from 1, so 2048 names are enough."""
    library = ctypes.CDLL("libOSMesa.so.8" if renderer.backend == "osmesa" else "libGL.so.1")
    with renderer._gl:  # noqa: SLF001 - only the renderer has the context
        return {
            kind: sum(bool(getattr(library, f"glIs{kind}")(name) & 0xFF) for name in range(1, 2048))
            for kind in ("Texture", "Buffer", "Framebuffer", "Renderbuffer", "Program", "VertexArray")
        }
