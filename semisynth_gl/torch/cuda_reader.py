"""Copies pixels from OpenGL to CUDA on one GPU, without passing through main memory.

OpenGL copies an attachment into a buffer (`GpuPixelBuffers`). CUDA maps that buffer and copies it into a tensor.
NVIDIA's bindings of the CUDA runtime share the device's primary context with torch.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

import torch

from semisynth_gl.inputs.errors import BackendError, InputError, how_to_install
from semisynth_gl.render.readers import GpuPixelBuffers, Viewport

_TYPES = {"f1": torch.uint8, "u1": torch.uint8, "u2": torch.uint16, "f4": torch.float32}
_MOST_DEVICES = 64


class CudaPixelReader:
    """A `PixelReader` (see `render`) that reads attachments into tensors on a CUDA device.

    ``device`` must have an index, and OpenGL must use the same GPU. Raises InputError if NVIDIA's bindings of CUDA are
    not installed.
    """

    def __init__(self, device: torch.device) -> None:
        try:
            self._cuda: Any = import_module("cuda.bindings.runtime")
        except ImportError:
            raise InputError(
                f"device='cuda' needs NVIDIA's bindings of CUDA, which are not installed: {how_to_install('cuda')}"
            ) from None
        self._device = device
        self._buffers = GpuPixelBuffers()
        self._resources: dict[int, Any] = {}
        self._context: Any = None
        self._call("cudaSetDevice", device.index)

    def __call__(
        self, framebuffer: Any, viewport: Viewport, attachment: int, kind: str, components: int  # noqa: ANN401 - only render/ knows OpenGL's types
    ) -> torch.Tensor:  # fmt: skip
        """Return a rectangle of an attachment as a tensor on the device, (H, W) or (H, W, C).

        Raises BackendError if OpenGL uses a different GPU, or CUDA reports an error.
        """
        if self._context is None:
            self._check_device()
            self._context = framebuffer.ctx
        buffer = self._buffers.fill(framebuffer, viewport, attachment, kind, components)
        if buffer.glo not in self._resources:
            read_only = self._cuda.cudaGraphicsRegisterFlags.cudaGraphicsRegisterFlagsReadOnly
            (self._resources[buffer.glo],) = self._call("cudaGraphicsGLRegisterBuffer", buffer.glo, read_only)
        shape = (viewport[3], viewport[2]) if components == 1 else (viewport[3], viewport[2], components)
        tensor = torch.empty(shape, dtype=_TYPES[kind], device=self._device)
        stream = torch.cuda.current_stream(self._device).cuda_stream
        with self._mapped(self._resources[buffer.glo], stream) as pointer:
            kind_of_copy = self._cuda.cudaMemcpyKind.cudaMemcpyDeviceToDevice
            self._call("cudaMemcpyAsync", tensor.data_ptr(), pointer, buffer.size, kind_of_copy, stream)
        return tensor

    def close(self) -> None:
        """Free the buffers; the renderer must still be open."""
        if self._context is None:
            return
        with self._context:
            try:
                while self._resources:
                    self._call("cudaGraphicsUnregisterResource", self._resources.popitem()[1])
            finally:
                self._buffers.release()
        self._context = None

    @contextmanager
    def _mapped(self, resource: Any, stream: int) -> Iterator[int]:  # noqa: ANN401 - the bindings have no types
        """Map a buffer for CUDA and yield its address.

        Mapping makes CUDA wait for OpenGL. Unmapping makes OpenGL wait for CUDA.
        """
        self._call("cudaGraphicsMapResources", 1, resource, stream)
        try:
            yield self._call("cudaGraphicsResourceGetMappedPointer", resource)[0]
        finally:
            self._call("cudaGraphicsUnmapResources", 1, resource, stream)

    def _check_device(self) -> None:
        # The bindings return a list of _MOST_DEVICES numbers; only the first `count` of them are devices.
        count, numbers = self._call("cudaGLGetDevices", _MOST_DEVICES, self._cuda.cudaGLDeviceList.cudaGLDeviceListAll)
        devices = list(numbers)[:count]
        if self._device.index not in devices:
            raise BackendError(
                f"OpenGL uses CUDA's device {', '.join(map(str, devices)) or 'none'}, but the tensors must be on "
                f"{self._device}: give gpus=({self._device.index},)"
            )

    def _call(self, name: str, *values: Any) -> tuple[Any, ...]:  # noqa: ANN401 - the bindings have no types
        """Call a function of the CUDA runtime; return its results, or raise BackendError if it reports an error."""
        error, *results = getattr(self._cuda, name)(*values)
        if error != self._cuda.cudaError_t.cudaSuccess:
            text = self._cuda.cudaGetErrorString(error)[1].decode()
            raise BackendError(f"CUDA refused {name}: {text} (error {int(error)})")
        return tuple(results)
