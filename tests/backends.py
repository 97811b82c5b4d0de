"""Backends of OpenGL that this machine has."""

from functools import cache

from semisynth_gl.inputs.errors import BackendError
from semisynth_gl.render.backends import Backend
from semisynth_gl.render.context import open_context


@cache
def backend_fault(backend: Backend) -> str | None:
    """Why a backend cannot be used here, or None."""
    try:
        open_context(backend).release()
    except BackendError as error:
        return str(error)
    return None
