"""OSMesa, Mesa's off-screen software renderer, as a context that moderngl accepts.

glcontext has no OSMesa backend, so this loads the library with ctypes. moderngl needs three things of a context:
`load` (the address of an OpenGL function), the context-manager protocol (make current), and `release`.
"""

import ctypes
from contextlib import suppress
from typing import Self

from semisynth_gl.inputs.errors import BackendError

# Names and values from Mesa's GL/osmesa.h.
_OSMESA_FORMAT, _OSMESA_RGBA = 0x22, 0x1908
_OSMESA_DEPTH_BITS, _OSMESA_STENCIL_BITS = 0x30, 0x31
_OSMESA_PROFILE, _OSMESA_CORE_PROFILE = 0x33, 0x34
_OSMESA_CONTEXT_MAJOR_VERSION, _OSMESA_CONTEXT_MINOR_VERSION = 0x36, 0x37
_GL_UNSIGNED_BYTE = 0x1401

# Names of the library; the first one that can be loaded is used.
OSMESA_LIBRARIES = ("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")


def _load_library() -> ctypes.CDLL:
    for name in OSMESA_LIBRARIES:
        with suppress(OSError):
            return ctypes.CDLL(name)
    raise BackendError(f"OSMesa is not installed: none of {', '.join(OSMESA_LIBRARIES)} could be loaded")


class OSMesaContext:
    """A current OSMesa context of OpenGL 4.5 core, with a 1 x 1 default framebuffer: everything is drawn off screen.

    Raises:
        BackendError: where the library is missing, too old, or does not offer OpenGL 4.5.
    """

    def __init__(self) -> None:
        library = _load_library()
        create = getattr(library, "OSMesaCreateContextAttribs", None)
        if create is None:
            raise BackendError("OSMesa is older than Mesa 12, and cannot offer OpenGL 4.5: update Mesa")
        create.restype = ctypes.c_void_p
        create.argtypes = [ctypes.POINTER(ctypes.c_int), ctypes.c_void_p]
        library.OSMesaGetProcAddress.restype = ctypes.c_void_p
        library.OSMesaGetProcAddress.argtypes = [ctypes.c_char_p]
        library.OSMesaMakeCurrent.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint, *[ctypes.c_int] * 2]
        library.OSMesaMakeCurrent.restype = ctypes.c_ubyte
        library.OSMesaDestroyContext.argtypes = [ctypes.c_void_p]
        attributes = [
            *(_OSMESA_FORMAT, _OSMESA_RGBA, _OSMESA_DEPTH_BITS, 0, _OSMESA_STENCIL_BITS, 0),
            *(_OSMESA_PROFILE, _OSMESA_CORE_PROFILE),
            *(_OSMESA_CONTEXT_MAJOR_VERSION, 4, _OSMESA_CONTEXT_MINOR_VERSION, 5, 0, 0),
        ]
        self._library = library
        self._pixel = (ctypes.c_ubyte * 4)()
        self._handle: int | None = create((ctypes.c_int * len(attributes))(*attributes), None)
        if not self._handle:
            raise BackendError("OSMesa offers no OpenGL 4.5 core profile")
        try:
            self._make_current()
        except BackendError:
            self.release()
            raise

    def _make_current(self) -> None:
        if not self._library.OSMesaMakeCurrent(self._handle, self._pixel, _GL_UNSIGNED_BYTE, 1, 1):
            raise BackendError("OSMesa could not make its context current")

    def load(self, name: str) -> int:
        """Return the address of an OpenGL function; 0 if OSMesa lacks the function."""
        return self._library.OSMesaGetProcAddress(name.encode()) or 0

    def __enter__(self) -> Self:
        self._make_current()
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the context current, since code that uses another context first makes that one current."""

    def release(self) -> None:
        """Destroy the context; a second call does nothing."""
        if self._handle:
            self._library.OSMesaDestroyContext(self._handle)
            self._handle = None
