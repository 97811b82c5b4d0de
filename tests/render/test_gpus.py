"""From CUDA's number of a GPU to its EGL device."""

import pytest

from semisynth_gl.inputs.errors import InputError
from semisynth_gl.render import devices
from semisynth_gl.render.devices import EglDevice, egl_devices, egl_index_of_gpu, egl_index_of_worker, query_devices

# EGL orders devices differently than CUDA, and the last device is no GPU.
DEVICES = (
    EglDevice(0, software=False, cuda=2, uuid="GPU-2c111111-0000-0000-0000-000000000000"),
    EglDevice(1, software=False, cuda=0, uuid="GPU-0a111111-0000-0000-0000-000000000000"),
    EglDevice(2, software=False, cuda=3),
    EglDevice(3, software=False, cuda=1, uuid="GPU-0a222222-0000-0000-0000-000000000000"),
    EglDevice(4, software=True),
)


@pytest.mark.parametrize(
    ("visible", "indices"),
    [(None, [1, 3, 0, 2]), (" 3 , 0 ", [2, 1]), ("1,-1", [3]), ("GPU-0a2,gpu", [3]), ("1,GPU-0A1", [3, 1])],
)
def test_the_device_is_found_within_those_that_cuda_sees(visible, indices):
    assert [egl_index_of_gpu(gpu, DEVICES, visible) for gpu in range(len(indices))] == indices
    with pytest.raises(InputError, match=f"gpus: {len(indices)}: "):
        egl_index_of_gpu(len(indices), DEVICES, visible)


@pytest.mark.parametrize(
    ("gpu", "visible", "message"),
    [
        (4, None, r"gpus: 4: .*GPUs that EGL lists, 2 \(GPU-2c1.*, 3 \(of unknown UUID\)"),
        (2, "1,-1,2", "names no such GPU"),
        (2, "2,3", "CUDA_VISIBLE_DEVICES=2,3 names no such GPU"),
        (0, "7", r"CUDA_VISIBLE_DEVICES=7 names 7"),
        (0, "GPU-0a", r"names GPU-0a, which is not exactly one"),
    ],
)
def test_what_there_is_is_said_where_a_gpu_is_not_found(gpu, visible, message):
    with pytest.raises(InputError, match=message):
        egl_index_of_gpu(gpu, DEVICES, visible)
    with pytest.raises(InputError, match=f"gpus: {gpu}: none of EGL's devices says"):
        egl_index_of_gpu(gpu, DEVICES[-1:], visible)


@pytest.mark.parametrize(
    ("visible", "listed", "index"),
    [("2", DEVICES, 0), ("0,2", DEVICES, 1), ("", DEVICES, 0), (None, DEVICES, 0), ("2", DEVICES[-1:], 0)],
)
def test_workers_draw_on_the_first_gpu_that_cuda_shows(monkeypatch, visible, listed, index):
    monkeypatch.setattr(devices, "egl_devices", lambda: listed)
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    if visible is not None:
        monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    assert [egl_index_of_worker((), worker) for worker in (0, 1)] == [index, index]
    if len(listed) > 1 and visible != "":
        assert egl_index_of_worker((0,), 5) == (1 if visible is None else index)


def test_a_process_without_the_mask_is_asked_where_there_is_one(monkeypatch):
    here = tuple(query_devices())
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "1")
    monkeypatch.setattr(devices, "query_devices", lambda: pytest.fail("this process has the mask"))
    egl_devices.cache_clear()
    assert egl_devices() == here
    egl_devices.cache_clear()
