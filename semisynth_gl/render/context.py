"""Headless OpenGL contexts, opened with EGL (a GPU, or llvmpipe) or OSMesa."""

import ctypes
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from threading import get_ident
from typing import Any

import moderngl
from glcontext import egl

from semisynth_gl.inputs.arguments import check_one_of
from semisynth_gl.inputs.errors import BackendError
from semisynth_gl.render import BACKENDS, Backend, is_software
from semisynth_gl.render.gl_functions import GLFunctions
from semisynth_gl.render.load_order import load_before_driver
from semisynth_gl.render.osmesa import OSMESA_LIBRARIES, OSMesaContext

# OpenGL 4.5 is the first version with glClipControl, which reversed Z needs; llvmpipe has offered it since Mesa 20.2.
REQUIRED_VERSION = 450

# Ids of processes that have opened a context. A forked process inherits the ids of its parent.
_opened_in: set[int] = set()
_AFTER_FORK = (
    "drivers do not survive a fork. Start the process by 'spawn', and a DataLoader's workers with "
    "multiprocessing_context='spawn'"
)

# Each backend needs one library of each of its groups.
_LIBRARIES = {"egl": (("libEGL.so.1",), ("libGL.so.1",)), "osmesa": (OSMESA_LIBRARIES,)}
# Debian's packages for each backend; "auto" tries EGL first.
_PACKAGES = {"egl": "libegl1 libgl1 libegl-mesa0 libgl1-mesa-dri", "osmesa": "libosmesa6 libgl1"}


@dataclass(frozen=True, slots=True)
class GraphicsContext:
    """An open context, which is current and set up for reversed Z in [0, 1]."""

    gl: moderngl.Context
    functions: GLFunctions  # calls that moderngl lacks
    backend: Backend  # the backend that opened the context, "egl" or "osmesa"
    renderer: str  # the driver's name for itself (GL_RENDERER), for the provenance of every pair
    process: int  # id of the process that opened the context
    thread: int  # id of the thread that opened the context

    @property
    def facts(self) -> dict[str, str]:
        """The "backend", the "renderer" (the driver's name for itself), and the driver's version of "opengl"."""
        return {"backend": self.backend, "renderer": self.renderer, "opengl": str(self.gl.info["GL_VERSION"])}

    @property
    def software(self) -> bool:
        """Whether the driver renders on the CPU."""
        return is_software(self.renderer)

    @property
    def corner_steps(self) -> int | None:
        """N if the driver rounds a triangle's corners to multiples of 1 / N px before it interpolates.

        None for llvmpipe, which rounds corners only to find the pixels that the triangle covers.
        """
        return None if self.software else 1 << int(self.gl.info["GL_SUBPIXEL_BITS"])

    def check_owner(self) -> None:
        """Raise BackendError unless this process and this thread opened the context."""
        if self.process != os.getpid():
            raise BackendError(f"this process was forked from the one that opened {self.renderer}: {_AFTER_FORK}")
        if self.thread != get_ident():
            raise BackendError(
                f"{self.renderer} was opened in another thread, but works in one only: open a renderer in each thread"
            )

    def release(self) -> None:
        """Free the context and everything in it; do nothing in a process that was forked after it was opened."""
        if self.process == os.getpid():
            self.gl.release()


def open_context(backend: Backend = "auto", device_index: int = 0) -> GraphicsContext:
    """Open a headless context; "auto" tries EGL, then OSMesa.

    ``device_index`` is EGL's number of the device, as ``semisynth-gl doctor`` lists it; OSMesa ignores it.

    Raises:
        BackendError: where no context can be opened, with the reason for each backend and what to install.
    """
    check_one_of("backend", backend, BACKENDS)
    openers: dict[Backend, Callable[[], Any]] = {"egl": lambda: _open_egl(device_index), "osmesa": OSMesaContext}
    if _opened_in - {os.getpid()}:
        # A fork does not copy the driver's threads, for which the driver would wait for ever.
        raise BackendError(f"this process was forked from one that had opened OpenGL: {_AFTER_FORK}")
    load_before_driver()
    reasons = []
    for name, opener in openers.items():
        if backend not in ("auto", name):
            continue
        try:
            context = _set_up(opener(), name)
        except BackendError as error:
            reasons.append(f"{name}: {error}")
        else:
            _opened_in.add(os.getpid())
            return context
    raise BackendError(
        "no OpenGL context could be opened; version 4.5 is needed.\n  "
        + "\n  ".join(reasons)
        + f"\nOn Debian or Ubuntu: apt-get install -y {_PACKAGES.get(backend, _PACKAGES['egl'])}"
        "\n`semisynth-gl doctor` shows what is there."
    )


def check_libraries(backend: Backend) -> None:
    """Check quickly that a backend's libraries are installed, before patches and models are prepared.

    Only if a library is missing does this open a context, for the error message of `open_context`.

    Raises:
        BackendError: where `open_context` raises it.
        InputError: where there is no such backend.
    """
    load_before_driver()
    for name, groups in _LIBRARIES.items():
        if backend in ("auto", name) and all(any(map(_can_load, libraries)) for libraries in groups):
            return
    open_context(backend).release()


def _can_load(library: str) -> bool:
    with suppress(OSError):
        return bool(ctypes.CDLL(library))
    return False


def context_facts(backend: Backend) -> dict[str, str]:
    """Open a context, close it, and return its `GraphicsContext.facts`; raises as `open_context` does."""
    context = open_context(backend)
    facts = context.facts
    context.release()
    return facts


def _open_egl(device_index: int) -> Any:  # noqa: ANN401 - glcontext has no types
    # glcontext's own backend() lets GLCONTEXT_* variables override these arguments silently, and asks for libGL.so,
    # which only development packages install.
    try:
        return egl.create_context(
            mode="standalone", libgl="libGL.so.1", libegl="libEGL.so.1", glversion=REQUIRED_VERSION,
            device_index=device_index,
        )  # fmt: skip
    except Exception as error:
        # glcontext raises plain Exception, with messages such as "libGL.so.1 not loaded" or "eglGetError 0x3001".
        raise BackendError(f"device {device_index}: {error}") from error


def _set_up(raw: Any, backend: Backend) -> GraphicsContext:  # noqa: ANN401 - either of two context types
    gl = moderngl.create_context(context=raw)
    renderer = str(gl.info["GL_RENDERER"])
    if gl.version_code < REQUIRED_VERSION:
        version = gl.info["GL_VERSION"]
        gl.release()
        raise BackendError(f"OpenGL 4.5 is needed, but {renderer} offers {version}: update the driver or Mesa")
    functions = GLFunctions(raw.load)
    functions.set_up()
    # moderngl queries limits that some drivers do not know; this leaves errors behind.
    gl.clear_errors()
    return GraphicsContext(gl, functions, backend, renderer, os.getpid(), get_ident())
