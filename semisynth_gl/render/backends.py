"""The names of the backends; to read them loads no OpenGL."""

from typing import Literal, get_args

Backend = Literal["auto", "egl", "osmesa"]
BACKENDS: tuple[Backend, ...] = get_args(Backend)


def is_software(renderer: str) -> bool:
    """Tell by a driver's name whether it draws on the processor."""
    return any(name in renderer.lower() for name in ("llvmpipe", "softpipe", "swrast", "software"))
