"""Lists EGL's devices, and finds the device of a GPU, given CUDA's number of the GPU."""

import ctypes
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from itertools import takewhile
from typing import Any
from uuid import UUID

from semisynth_gl.inputs.errors import InputError
from semisynth_gl.render.load_order import load_before_driver

_EGL_EXTENSIONS = 0x3055
_EGL_CUDA_DEVICE_NV = 0x323A
_EGL_DEVICE_UUID_EXT = 0x335C
_MOST_DEVICES = 64
_UUID_BYTES = 16
_VISIBLE = "CUDA_VISIBLE_DEVICES"


@dataclass(frozen=True, slots=True)
class EglDevice:
    """An EGL device."""

    index: int  # EGL's number of the device: ``device_index``
    software: bool  # whether it is Mesa's software device
    cuda: int | None = None  # CUDA's number among all GPUs of the machine; None where EGL does not say
    uuid: str | None = None  # "GPU-" and hexadecimal digits, as in CUDA_VISIBLE_DEVICES; None where EGL does not say


@cache
def egl_devices() -> tuple[EglDevice, ...]:
    """List EGL's devices, in EGL's order (which is not CUDA's); empty where EGL is missing or cannot list devices.

    CUDA_VISIBLE_DEVICES hides no device from EGL, but it changes the CUDA numbers that EGL reports: only visible GPUs
    are numbered, and the numbers of hidden GPUs mean nothing. So if the variable is set, a subprocess without it asks.
    """
    if _VISIBLE not in os.environ:
        return tuple(query_devices())
    environment = {name: value for name, value in os.environ.items() if name != _VISIBLE}
    answer = subprocess.run(  # noqa: S603 - this interpreter and this module
        [sys.executable, "-m", __name__], env=environment, capture_output=True, text=True, check=True
    )
    return tuple(EglDevice(**device) for device in json.loads(answer.stdout))


def egl_index_of_worker(gpus: Sequence[int], worker: int) -> int:
    """Return the EGL number of the device on which a worker renders; workers are assigned to GPUs in turn.

    ``gpus`` are CUDA's numbers. If there are none, all workers render on the first GPU of CUDA_VISIBLE_DEVICES, or on
    EGL's first device if the variable is not set or EGL lists no CUDA device. ``worker`` is numbered from 0.

    Raises:
        InputError: where CUDA has no such GPU, or EGL does not say which of its devices it is.
    """
    visible = os.environ.get(_VISIBLE)
    if gpus:
        return egl_index_of_gpu(gpus[worker % len(gpus)], egl_devices(), visible)
    if not visible or all(device.cuda is None for device in egl_devices()):
        return 0
    return egl_index_of_gpu(0, egl_devices(), visible)


def egl_index_of_gpu(gpu: int, devices: Sequence[EglDevice], visible: str | None) -> int:
    """Return the EGL number of a GPU.

    Args:
        gpu: CUDA's number of the GPU among the ``visible`` ones.
        devices: EGL's devices.
        visible: the value of CUDA_VISIBLE_DEVICES: numbers, UUIDs, or beginnings of UUIDs; None where it is not set.

    Raises:
        InputError: where CUDA has no such GPU, or EGL does not say which of its devices it is.
    """
    gpus = [device for device in devices if device.cuda is not None]
    if not gpus:
        raise InputError(
            f"{gpu}: none of EGL's devices says which CUDA GPU it is. `semisynth-gl doctor` lists the devices; "
            "NVIDIA's driver says so where its libEGL is installed",
            argument="gpus",
        )
    # CUDA ignores -1 and all entries after it.
    entries = takewhile("-1".__ne__, map(str.strip, (visible or "").split(",")))
    entry = str(gpu) if visible is None else dict(enumerate(entries)).get(gpu, "")
    found = [
        device
        for device in gpus
        if entry and (entry == str(device.cuda) or (device.uuid or "").lower().startswith(entry.lower()))
    ]
    if len(found) != 1:
        known = ", ".join(f"{device.cuda} ({device.uuid or 'of unknown UUID'})" for device in gpus)
        masked = "" if visible is None else f" {_VISIBLE}={visible} names {entry or 'no such GPU'}, which"
        raise InputError(f"{gpu}:{masked} is not exactly one of the GPUs that EGL lists, {known}", argument="gpus")
    return found[0].index


def query_devices() -> list[EglDevice]:
    """List EGL's devices, with CUDA's numbers under this process's CUDA_VISIBLE_DEVICES."""
    load_before_driver()
    try:
        egl = ctypes.CDLL("libEGL.so.1")
    except OSError:
        return []
    egl.eglGetProcAddress.restype = ctypes.c_void_p
    egl.eglGetProcAddress.argtypes = [ctypes.c_char_p]

    def function(name: bytes, result: Any, *types: Any) -> Any:  # noqa: ANN401 - ctypes has no common type
        # The result is false if EGL lacks the function.
        return ctypes.CFUNCTYPE(result, *types)(egl.eglGetProcAddress(name) or 0)

    handle, attribute, flag, number = ctypes.c_void_p, ctypes.c_int, ctypes.c_uint, ctypes.POINTER(ctypes.c_int)
    list_devices = function(b"eglQueryDevicesEXT", flag, ctypes.c_int, ctypes.POINTER(handle), number)
    ask = function(b"eglQueryDeviceStringEXT", ctypes.c_char_p, handle, attribute)
    # EGLAttrib is an integer as wide as a pointer.
    ask_number = function(b"eglQueryDeviceAttribEXT", flag, handle, attribute, ctypes.POINTER(ctypes.c_ssize_t))
    ask_bytes = function(b"eglQueryDeviceBinaryEXT", flag, handle, attribute, ctypes.c_int, ctypes.c_char_p, number)
    handles, count, devices = (handle * _MOST_DEVICES)(), ctypes.c_int(0), list[EglDevice]()
    if not list_devices or not ask or not list_devices(_MOST_DEVICES, handles, ctypes.byref(count)):
        return []
    for index, device in enumerate(handles[: count.value]):
        extensions = (ask(device, _EGL_EXTENSIONS) or b"").decode().split()
        cuda, uuid = ctypes.c_ssize_t(-1), ctypes.create_string_buffer(_UUID_BYTES)
        if "EGL_NV_device_cuda" in extensions and ask_number:
            ask_number(device, _EGL_CUDA_DEVICE_NV, ctypes.byref(cuda))
        has_uuid = (
            "EGL_EXT_device_persistent_id" in extensions
            and ask_bytes
            and ask_bytes(device, _EGL_DEVICE_UUID_EXT, _UUID_BYTES, uuid, ctypes.byref(ctypes.c_int(0)))
        )
        cuda_number = cuda.value if cuda.value >= 0 else None
        software = "EGL_MESA_device_software" in extensions
        devices.append(EglDevice(index, software, cuda_number, f"GPU-{UUID(bytes=uuid.raw)}" if has_uuid else None))
    return devices


if __name__ == "__main__":
    sys.stdout.write(json.dumps([asdict(device) for device in query_devices()]))
