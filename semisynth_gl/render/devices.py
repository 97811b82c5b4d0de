"""What OpenGL this machine offers: EGL devices, libraries, limits of a context."""

import ctypes
from dataclasses import dataclass

from semisynth_gl.render.context import Backend, open_context

_EGL_EXTENSIONS = 0x3055
_EGL_DRM_DEVICE_FILE_EXT = 0x3233
_EGL_RENDERER_EXT = 0x335F
_MOST_DEVICES = 64

# Sonames rather than libGL.so: only development packages install the latter.
LIBRARIES = {
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libEGL_mesa.so.0": "libegl-mesa0",
    "libOSMesa.so.8": "libosmesa6",
}


@dataclass(frozen=True, slots=True)
class Device:
    """An EGL device.

    Attributes:
        index: its number, as ``device_index`` counts.
        name: the driver's name for it, or the device file, as far as EGL tells.
        software: whether it is Mesa's software device.
    """

    index: int
    name: str
    software: bool


@dataclass(frozen=True, slots=True)
class ContextFacts:
    """What an opened context says of itself.

    Attributes:
        backend: "egl" or "osmesa".
        renderer: GL_RENDERER.
        version: GL_VERSION.
        limits: names and values worth knowing.
    """

    backend: Backend
    renderer: str
    version: str
    limits: dict[str, int]


def missing_libraries() -> dict[str, str]:
    """Libraries that cannot be loaded, each with the Debian package that brings it."""
    return {library: package for library, package in LIBRARIES.items() if not _loads(library)}


def egl_devices() -> list[Device]:
    """List EGL's devices, in EGL's order (which is not CUDA's); empty where EGL is missing or cannot tell."""
    try:
        egl = ctypes.CDLL("libEGL.so.1")
    except OSError:
        return []
    egl.eglGetProcAddress.restype = ctypes.c_void_p
    egl.eglGetProcAddress.argtypes = [ctypes.c_char_p]
    query_devices = egl.eglGetProcAddress(b"eglQueryDevicesEXT")
    query_string = egl.eglGetProcAddress(b"eglQueryDeviceStringEXT")
    if not query_devices or not query_string:
        return []
    handles = (ctypes.c_void_p * _MOST_DEVICES)()
    count = ctypes.c_int(0)
    list_devices = ctypes.CFUNCTYPE(
        ctypes.c_uint, ctypes.c_int, ctypes.POINTER(ctypes.c_void_p), ctypes.POINTER(ctypes.c_int)
    )(query_devices)
    if not list_devices(_MOST_DEVICES, handles, ctypes.byref(count)):
        return []
    ask = ctypes.CFUNCTYPE(ctypes.c_char_p, ctypes.c_void_p, ctypes.c_int)(query_string)

    def describe(index: int) -> Device:
        handle = handles[index]
        extensions = (ask(handle, _EGL_EXTENSIONS) or b"").decode()
        software = "EGL_MESA_device_software" in extensions
        name = b""
        # Asking for a string whose extension is absent is an error in EGL.
        if "EGL_EXT_device_query_name" in extensions:
            name = ask(handle, _EGL_RENDERER_EXT) or b""
        if not name and "EGL_EXT_device_drm" in extensions:
            name = ask(handle, _EGL_DRM_DEVICE_FILE_EXT) or b""
        return Device(index, name.decode() or ("Mesa" if software else "unnamed"), software)

    return [describe(index) for index in range(count.value)]


def context_facts(backend: Backend, device_index: int = 0) -> ContextFacts:
    """Open a context, ask it, close it.

    Raises:
        BackendError: where it cannot be opened.
    """
    context = open_context(backend, device_index)
    try:
        info = context.gl.info
        limits = {
            "largest image side, px": int(info["GL_MAX_TEXTURE_SIZE"]),
            "patches in an atlas": int(info["GL_MAX_ARRAY_TEXTURE_LAYERS"]),
            "samples per pixel": int(context.gl.max_samples),
        }
        return ContextFacts(context.backend, context.renderer, str(info["GL_VERSION"]), limits)
    finally:
        context.release()


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True
