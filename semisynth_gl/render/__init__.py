"""All code that uses OpenGL: contexts, the renderer, the list of devices. This module itself loads no OpenGL."""

from typing import Literal, get_args

Backend = Literal["auto", "egl", "osmesa"]
BACKENDS: tuple[Backend, ...] = get_args(Backend)


def is_software(renderer: str) -> bool:
    """Return whether the driver with this name (GL_RENDERER) renders on the CPU."""
    return any(name in renderer.lower() for name in ("llvmpipe", "softpipe", "swrast", "software"))
