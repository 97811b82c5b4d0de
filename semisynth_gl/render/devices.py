"""OpenGL on this machine: EGL's devices, the libraries, and the limits of a context."""

import ctypes
import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from itertools import takewhile
from pathlib import Path
from typing import Any

from semisynth_gl.inputs.arguments import check_one_of
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.render.backends import BACKENDS, Backend
from semisynth_gl.render.context import open_context
from semisynth_gl.render.load_order import load_before_driver
from semisynth_gl.render.osmesa import OSMESA_LIBRARIES

_EGL_EXTENSIONS = 0x3055
_EGL_CUDA_DEVICE_NV = 0x323A
_EGL_DEVICE_UUID_EXT = 0x335C
# EGL_RENDERER_EXT and EGL_DRM_DEVICE_FILE_EXT, by the extensions that define them.
_NAMES = {"EGL_EXT_device_query_name": 0x335F, "EGL_EXT_device_drm": 0x3233}
_MOST_DEVICES = 64
_UUID_BYTES = 16
_VISIBLE = "CUDA_VISIBLE_DEVICES"
NVIDIA_CONTROL = Path("/dev/nvidiactl")
"""A file that exists where the kernel has an NVIDIA GPU."""
_VENDOR_FILE = '{"file_format_version": "1.0.0", "ICD": {"library_path": "libEGL_nvidia.so.0"}}'

# Libraries, and the Debian packages that bring them. Only development packages install names such as libGL.so.
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
        index: EGL's number of the device, as ``device_index`` counts.
        name: the driver's name for the device, or its device file; "Mesa" or "unnamed" where EGL has neither.
        software: whether it is Mesa's software device.
        cuda: CUDA's number of the device among all GPUs of the machine; None where EGL does not say.
        uuid: the device's UUID as CUDA_VISIBLE_DEVICES takes it, "GPU-" and hexadecimal digits; None where EGL does not
            say.
    """

    index: int
    name: str
    software: bool
    cuda: int | None = None
    uuid: str | None = None


@dataclass(frozen=True, slots=True)
class ContextFacts:
    """An opened context's backend, driver (GL_RENDERER), version, and limits by their names for a reader."""

    backend: Backend
    renderer: str
    version: str
    limits: dict[str, int]


def missing_libraries() -> dict[str, str]:
    """Return the libraries that cannot be loaded, each with the Debian package that contains it."""
    load_before_driver()
    return {library: package for library, package in LIBRARIES.items() if not _loads(library)}


def check_libraries(backend: Backend) -> None:
    """Check that a backend's libraries are there.

    This takes next to no time, so a caller can check it before preparing patches and models.

    Raises:
        BackendError: where libraries are missing and no context opens; see `open_context`.
        InputError: where there is no such backend.
    """
    check_one_of("backend", backend, BACKENDS)
    load_before_driver()
    if backend in ("auto", "egl") and _loads("libEGL.so.1") and _loads("libGL.so.1"):
        return
    if backend in ("auto", "osmesa") and any(map(_loads, OSMESA_LIBRARIES)):
        return
    open_context(backend).release()


def nvidia_fault(devices: Sequence[Device]) -> str | None:
    """Say what to do where EGL does not list the NVIDIA GPU that the kernel has; None where nothing is to be done."""
    if not NVIDIA_CONTROL.exists() or any(device.cuda is not None for device in devices):
        return None
    return (
        "install all of NVIDIA's driver (a container's NVIDIA_DRIVER_CAPABILITIES must hold graphics), tell EGL of it "
        f"by a file /etc/glvnd/egl_vendor.d/10_nvidia.json with {_VENDOR_FILE}, and get the right to open "
        "/dev/nvidia*; a GPU in MIG mode has no OpenGL"
    )


def egl_devices() -> list[Device]:
    """List EGL's devices, in EGL's order (which is not CUDA's); empty where EGL is missing or cannot list devices.

    CUDA_VISIBLE_DEVICES hides no device from EGL, but it changes the CUDA numbers that EGL reports: they count only the
    visible GPUs, and those of hidden GPUs mean nothing. So where it is set, another process asks without it.
    """
    devices = query_devices()
    if _VISIBLE not in os.environ or all(device.cuda is None for device in devices):
        return devices
    return list(devices_without_mask())


def egl_index_of_worker(gpus: Sequence[int], worker: int) -> int:
    """Return the EGL number of the device on which a worker draws, where workers are dealt out to GPUs in turn.

    ``gpus`` are CUDA's numbers. Without any, all workers draw on the first GPU that CUDA_VISIBLE_DEVICES shows, or on
    EGL's first device where the variable is not set or EGL lists no CUDA device. ``worker`` counts from 0.

    Raises:
        InputError: where CUDA has no such GPU, or EGL does not say which of its devices it is.
    """
    visible = os.environ.get(_VISIBLE)
    if gpus:
        return egl_index_of_gpu(gpus[worker % len(gpus)], egl_devices(), visible)
    if not visible:
        return 0
    devices = egl_devices()
    return egl_index_of_gpu(0, devices, visible) if any(device.cuda is not None for device in devices) else 0


def egl_index_of_gpu(gpu: int, devices: Sequence[Device], visible: str | None) -> int:
    """Return the EGL number of a GPU.

    Args:
        gpu: CUDA's number of the GPU, counted within ``visible``.
        devices: EGL's devices.
        visible: the value of CUDA_VISIBLE_DEVICES: numbers, UUIDs, or beginnings of UUIDs; None where it is not set.

    Raises:
        InputError: where CUDA has no such GPU, or EGL does not say which of its devices it is.
    """
    by_cuda = {str(device.cuda): device for device in devices if device.cuda is not None}
    if not by_cuda:
        raise InputError(
            f"{gpu}: none of EGL's devices says which GPU of CUDA's it is. `semisynth-gl doctor` lists them; "
            "NVIDIA's driver tells where its libEGL is installed",
            argument="gpus",
        )
    entries = dict(enumerate(_visible_entries(visible))) if visible else {}
    entry = str(gpu) if visible is None else entries.get(gpu, "")
    if entry in by_cuda:
        return by_cuda[entry].index
    uuids = [device for device in by_cuda.values() if entry and (device.uuid or "").lower().startswith(entry.lower())]
    if len(uuids) != 1:
        known = ", ".join(f"{number} ({device.uuid or 'of unknown UUID'})" for number, device in by_cuda.items())
        masked = "" if visible is None else f" {_VISIBLE}={visible} names {entry or 'no such GPU'}, which"
        raise InputError(f"{gpu}:{masked} is not exactly one of the GPUs that EGL lists, {known}", argument="gpus")
    return uuids[0].index


def _visible_entries(visible: str) -> list[str]:
    """Return the valid entries: CUDA ignores the first invalid one, such as -1, and all entries behind it."""
    entries = (entry.strip() for entry in visible.split(","))
    return list(takewhile(lambda entry: entry.isdigit() or entry.startswith(("GPU-", "MIG-")), entries))


@cache
def devices_without_mask() -> tuple[Device, ...]:
    """List EGL's devices as another process sees them in which CUDA_VISIBLE_DEVICES is not set."""
    program = f"from {__name__} import print_devices; print_devices()"
    environment = {name: value for name, value in os.environ.items() if name != _VISIBLE}
    answer = subprocess.run(  # noqa: S603 - this interpreter and this module
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
    )
    return tuple(Device(**device) for device in json.loads(answer.stdout))


def print_devices() -> None:
    """Print EGL's devices as JSON, for `devices_without_mask` of the parent process."""
    sys.stdout.write(json.dumps([asdict(device) for device in query_devices()]))


def query_devices() -> list[Device]:
    """List EGL's devices, with CUDA's numbers as this process's CUDA_VISIBLE_DEVICES makes them."""
    load_before_driver()
    try:
        egl = ctypes.CDLL("libEGL.so.1")
    except OSError:
        return []
    egl.eglGetProcAddress.restype = ctypes.c_void_p
    egl.eglGetProcAddress.argtypes = [ctypes.c_char_p]

    def function(name: bytes, result: Any, *types: Any) -> Callable[..., Any] | None:  # noqa: ANN401 - ctypes has no common type
        address = egl.eglGetProcAddress(name)
        return ctypes.CFUNCTYPE(result, *types)(address) if address else None

    handle, attribute, flag, number = ctypes.c_void_p, ctypes.c_int, ctypes.c_uint, ctypes.POINTER(ctypes.c_int)
    list_devices = function(b"eglQueryDevicesEXT", flag, ctypes.c_int, ctypes.POINTER(handle), number)
    ask = function(b"eglQueryDeviceStringEXT", ctypes.c_char_p, handle, attribute)
    # EGLAttrib is an integer as wide as a pointer.
    ask_number = function(b"eglQueryDeviceAttribEXT", flag, handle, attribute, ctypes.POINTER(ctypes.c_ssize_t))
    ask_bytes = function(b"eglQueryDeviceBinaryEXT", flag, handle, attribute, ctypes.c_int, ctypes.c_char_p, number)
    handles, count = (handle * _MOST_DEVICES)(), ctypes.c_int(0)
    if not list_devices or not ask or not list_devices(_MOST_DEVICES, handles, ctypes.byref(count)):
        return []

    def describe(index: int) -> Device:
        device = handles[index]
        extensions = (ask(device, _EGL_EXTENSIONS) or b"").decode().split()
        software = "EGL_MESA_device_software" in extensions
        name = b""
        for extension, asked in _NAMES.items():
            # Asking for a string whose extension is absent is an error in EGL.
            if not name and extension in extensions:
                name = ask(device, asked) or b""
        cuda, uuid = ctypes.c_ssize_t(-1), ctypes.create_string_buffer(_UUID_BYTES)
        has_cuda = (
            "EGL_NV_device_cuda" in extensions
            and ask_number is not None
            and ask_number(device, _EGL_CUDA_DEVICE_NV, ctypes.byref(cuda))
        )
        has_uuid = (
            "EGL_EXT_device_persistent_id" in extensions
            and ask_bytes is not None
            and ask_bytes(device, _EGL_DEVICE_UUID_EXT, _UUID_BYTES, uuid, ctypes.byref(ctypes.c_int(0)))
        )
        return Device(
            index,
            name.decode() or ("Mesa" if software else "unnamed"),
            software,
            cuda.value if has_cuda and cuda.value >= 0 else None,
            uuid_text(uuid.raw) if has_uuid else None,
        )

    return [describe(index) for index in range(count.value)]


def uuid_text(uuid: bytes) -> str:
    """Return the 16 bytes of a UUID as CUDA writes them, "GPU-" and hexadecimal digits."""
    digits = uuid.hex()
    return f"GPU-{digits[:8]}-{digits[8:12]}-{digits[12:16]}-{digits[16:20]}-{digits[20:]}"


def context_facts(backend: Backend, device_index: int = 0) -> ContextFacts:
    """Open a context, and return its facts after closing it.

    Raises:
        BackendError: see `open_context`.
    """
    context = open_context(backend, device_index)
    try:
        info = context.gl.info
        limits = {
            "largest image side, px": int(info["GL_MAX_TEXTURE_SIZE"]),
            "patches in an atlas": int(info["GL_MAX_ARRAY_TEXTURE_LAYERS"]),
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
