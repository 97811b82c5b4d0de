"""The only room that uses OpenGL: contexts, the renderer, the list of devices. This module loads no OpenGL."""

from typing import Literal, get_args

Backend = Literal["auto", "egl", "osmesa"]
BACKENDS: tuple[Backend, ...] = get_args(Backend)


def is_software(renderer: str) -> bool:
    """Return whether a driver, by its name (GL_RENDERER), draws on the processor."""
    return any(name in renderer.lower() for name in ("llvmpipe", "softpipe", "swrast", "software"))
