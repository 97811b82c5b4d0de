"""From OpenGL's buffers to CUDA's tensors, with a fake CUDA runtime, since CI has no GPU."""

# ruff: noqa: N802 - names of the CUDA runtime

import ctypes
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from backends import count_objects
from heavy import heavy
from tiny_datasets import cheap

from semisynth_gl.frame.camera import Crop
from semisynth_gl.frame.channels import RENDERED_OUTPUTS
from semisynth_gl.inputs.errors import BackendError, InputError
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.render.readers import GpuPixelBuffers

torch = heavy("torch")
pytestmark = [pytest.mark.heavy, pytest.mark.one_backend]

from semisynth_gl.torch import StereoStream, stream  # noqa: E402
from semisynth_gl.torch.cuda_reader import CudaPixelReader  # noqa: E402

SEED = 3
# The fake runtime's pointers point to main memory.
DEVICE = torch.device("cpu", 0)


class FakeRuntime(ModuleType):
    """The functions of cuda.bindings.runtime that we call, on OpenGL's buffers; records the calls.

    As in the bindings, a result is a tuple of the error and the values.
    """

    def __init__(self):
        super().__init__("runtime")
        self.calls, self.registered, self.mapped, self.buffers = [], set(), {}, {}
        self.refused, self.devices = None, [0]
        self.cudaError_t = SimpleNamespace(cudaSuccess=0)
        self.cudaGraphicsRegisterFlags = SimpleNamespace(cudaGraphicsRegisterFlagsReadOnly=1)
        self.cudaMemcpyKind = SimpleNamespace(cudaMemcpyDeviceToDevice=3)
        self.cudaGLDeviceList = SimpleNamespace(cudaGLDeviceListAll=1)
        self.cudaGetErrorString = lambda error: (0, f"refused for {error}".encode())

    def __getattr__(self, name):
        def call(*values):
            self.calls.append(name)
            return (719,) if name == self.refused else (0, *getattr(self, f"_{name}")(*values))

        return call

    def _cudaSetDevice(self, device):
        assert device == 0
        return ()

    def _cudaGLGetDevices(self, most, which):
        assert which == 1
        return len(self.devices), self.devices + [0] * (most - len(self.devices))

    def _cudaGraphicsGLRegisterBuffer(self, buffer, flags):
        assert flags == 1
        self.registered.add(buffer)
        return (buffer,)

    def _cudaGraphicsMapResources(self, count, resource, stream):
        assert (count, stream, resource in self.registered, resource in self.mapped) == (1, 77, True, False)
        buffer = self.buffers[resource]
        self.mapped[resource] = ctypes.create_string_buffer(buffer.read(), buffer.size)
        return ()

    def _cudaGraphicsResourceGetMappedPointer(self, resource):
        return ctypes.addressof(self.mapped[resource]), len(self.mapped[resource])

    def _cudaMemcpyAsync(self, target, source, size, kind, stream):
        assert (kind, stream) == (3, 77)
        assert (source, size) in [(ctypes.addressof(each), len(each)) for each in self.mapped.values()]
        ctypes.memmove(target, source, size)
        return ()

    def _cudaGraphicsUnmapResources(self, count, resource, stream):
        assert (count, stream) == (1, 77)
        del self.mapped[resource]
        return ()

    def _cudaGraphicsUnregisterResource(self, resource):
        assert resource not in self.mapped
        self.registered.remove(resource)
        return ()


@pytest.fixture
def runtime(monkeypatch):
    fake, fill = FakeRuntime(), GpuPixelBuffers.fill
    for name in ("cuda", "cuda.bindings"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, "cuda.bindings.runtime", fake)
    monkeypatch.setattr(torch.cuda, "current_stream", lambda _: SimpleNamespace(cuda_stream=77))

    def noted(*given):
        buffer = fill(*given)
        fake.buffers[buffer.glo] = buffer
        return buffer

    monkeypatch.setattr(GpuPixelBuffers, "fill", noted)
    return fake


@pytest.fixture
def reader(runtime):
    assert not runtime.calls
    return CudaPixelReader(DEVICE)


def test_what_is_drawn_reaches_cuda_as_it_is_read_back(backend, runtime, reader):
    config = cheap(antialias="ssaa2", outputs=list(RENDERED_OUTPUTS))
    with PairRenderer(config, SEED, backend) as usual, PairRenderer(config, SEED, backend, read=reader) as renderer:
        for index, crop in enumerate((None, Crop(5, 3, 31, 17), None)):
            tensors = renderer.render(index, crop=crop, checked=False).frame.arrays()
            expected = usual.render(index, crop=crop, checked=False).frame.arrays()
            assert set(tensors) == set(expected) > {"left", "normals_right", "flow_left"}
            for role, array in expected.items():
                assert isinstance(tensors[role], torch.Tensor), role
                np.testing.assert_array_equal(tensors[role].numpy(), array, err_msg=role)
        # The reader registers one buffer per size: 1, 2, 3, 4, 8 and 12 bytes per pixel, for two image sizes.
        assert len(runtime.registered) == 12
        objects = count_objects(renderer.renderer)["Buffer"]
        reader.close()
        assert count_objects(renderer.renderer)["Buffer"] == objects - 12
        assert not runtime.registered
        reader.close()
    assert not runtime.mapped
    assert runtime.calls.count("cudaGraphicsGLRegisterBuffer") == 12
    assert runtime.calls[-12:] == ["cudaGraphicsUnregisterResource"] * 12


def test_several_baselines_share_a_left_view_of_tensors(backend, runtime, reader):
    config = cheap(camera={"baseline_m": None, "baselines": [0.1, 0.2]})
    with PairRenderer(config, SEED, backend, read=reader) as renderer:
        sampled = renderer.sampler.sample(0)
        first, second = renderer.renderer.render_rig(sampled.scene, sampled.views)
        assert isinstance(second.left.image, torch.Tensor)
        assert torch.equal(first.left.image, second.left.image)
        reader.close()
    assert not runtime.registered


@pytest.mark.parametrize("refused", ["cudaGraphicsGLRegisterBuffer", "cudaGraphicsMapResources", "cudaMemcpyAsync"])
def test_what_cuda_refuses_is_told_and_unmapped(backend, runtime, reader, refused):
    with PairRenderer(cheap(), SEED, backend, read=reader) as renderer:
        runtime.refused = refused
        with pytest.raises(BackendError, match=f"CUDA refused {refused}: refused for 719"):
            renderer.render(0, checked=False)
        assert not runtime.mapped
        # The next pair renders normally.
        runtime.refused = None
        assert isinstance(renderer.render(0, checked=False).frame.left.image, torch.Tensor)
        reader.close()
        assert not runtime.registered


def test_a_renderer_on_another_gpu_is_refused(backend, runtime, reader):
    runtime.devices = [1, 2]
    words = r"uses CUDA's device 1, 2, but the tensors must be on cpu:0: give gpus=\(0,\)"
    with PairRenderer(cheap(), SEED, backend, read=reader) as renderer, pytest.raises(BackendError, match=words):
        renderer.render(0, checked=False)


@pytest.fixture
def gpu(monkeypatch, runtime):
    """Make streams with device="cuda" use the fake runtime."""

    def made(device):
        assert device == torch.device("cuda", 0)
        return CudaPixelReader(DEVICE)

    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "current_device", lambda: 0)
    monkeypatch.setattr(stream, "egl_index_of_worker", lambda gpus, worker: max(len(gpus) - 1, 0) + worker)
    monkeypatch.setattr(stream, "CudaPixelReader", made)
    return runtime


def test_a_stream_on_a_gpu_yields_the_same(gpu):
    options = {"crop": (20, 30), "checked": False}
    # Read both streams alternately, since each has its own reader.
    there, here = (StereoStream(cheap(), SEED, 3, device=device, **options) for device in ("cuda", "cpu"))
    for on_gpu, sample in zip(there, here, strict=True):
        assert on_gpu["instances_left"].dtype == torch.int32
        for name, tensor in sample.items():
            assert name in ("index", "camera") or torch.equal(on_gpu[name], tensor), name
    assert gpu.calls.count("cudaMemcpyAsync") == 3 * 10
    there.close()
    assert not gpu.registered


@pytest.mark.usefixtures("gpu")
def test_tensors_on_a_gpu_do_not_come_from_workers():
    one = StereoStream(cheap(), SEED, 1, device="cuda", checked=False)
    loaded = torch.utils.data.DataLoader(one, num_workers=1, multiprocessing_context="fork")
    with pytest.raises(InputError, match="needs num_workers=0"):
        next(iter(loaded))
