"""The names of the backends; to read them loads no OpenGL."""

from typing import Literal, get_args

Backend = Literal["auto", "egl", "osmesa"]
BACKENDS: tuple[Backend, ...] = get_args(Backend)
