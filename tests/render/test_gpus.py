"""Which EGL device a GPU is that the user names by CUDA's number, and what keeps EGL from a GPU."""

import json

import pytest

from semisynth_gl.inputs.errors import InputError
from semisynth_gl.render import devices
from semisynth_gl.render.devices import Device, egl_devices, egl_index_of_gpu, egl_index_of_worker

# EGL's order differs from CUDA's, and the last device is no GPU.
DEVICES = [
    Device(0, "first", software=False, cuda=2, uuid="GPU-2c111111-0000-0000-0000-000000000000"),
    Device(1, "second", software=False, cuda=0, uuid="GPU-0a111111-0000-0000-0000-000000000000"),
    Device(2, "third", software=False, cuda=3),
    Device(3, "fourth", software=False, cuda=1, uuid="GPU-0a222222-0000-0000-0000-000000000000"),
    Device(4, "Mesa", software=True),
]


@pytest.mark.parametrize(
    ("visible", "indices"),
    [(None, [1, 3, 0, 2]), (" 3 , 0 ", [2, 1]), ("1,-1,2", [3]), ("GPU-0a2,gpu", [3]), ("1,GPU-0A1", [3, 1])],
)
def test_the_device_is_found_within_those_that_cuda_sees(visible, indices):
    assert [egl_index_of_gpu(gpu, DEVICES, visible) for gpu in range(len(indices))] == indices
    with pytest.raises(InputError, match=f"gpus: {len(indices)}: "):
        egl_index_of_gpu(len(indices), DEVICES, visible)


@pytest.mark.parametrize(
    ("gpu", "visible", "message"),
    [
        (4, None, r"gpus: 4: .*GPUs that EGL lists, 2 \(GPU-2c1.*, 3 \(of unknown UUID\)"),
        (0, "-1", "gpus: 0: .*CUDA_VISIBLE_DEVICES=-1"),
        (-1, "0", "gpus: -1"),
        (2, "2,3", "CUDA_VISIBLE_DEVICES=2,3 names no such GPU"),
        (0, "7", r"CUDA_VISIBLE_DEVICES=7 names 7"),
        (0, "GPU-0a", r"names GPU-0a, which is not exactly one"),
        (1, "0,MIG-0a111111", "names MIG-0a111111, which is not exactly one"),
    ],
)
def test_what_there_is_is_said_where_a_gpu_is_not_found(gpu, visible, message):
    with pytest.raises(InputError, match=message):
        egl_index_of_gpu(gpu, DEVICES, visible)
    with pytest.raises(InputError, match=f"gpus: {gpu}: none of EGL's devices says"):
        egl_index_of_gpu(gpu, DEVICES[-1:], visible)


def test_a_mask_is_lifted_where_devices_are_asked_for_their_numbers(monkeypatch):
    masked = [Device(0, "first", software=False, cuda=0), Device(1, "second", software=False, cuda=0)]
    monkeypatch.setattr(devices, "query_devices", lambda: masked)
    monkeypatch.setattr(devices, "devices_without_mask", lambda: tuple(DEVICES))
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    assert egl_devices() == masked
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "1")
    assert egl_devices() == DEVICES


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


def test_what_keeps_egl_from_a_gpu_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(devices, "NVIDIA_CONTROL", tmp_path / "nvidiactl")
    assert devices.nvidia_fault(DEVICES[-1:]) is None
    (tmp_path / "nvidiactl").touch()
    assert devices.nvidia_fault(DEVICES) is None
    for said in ("NVIDIA_DRIVER_CAPABILITIES", "10_nvidia.json", "MIG"):
        assert said in devices.nvidia_fault(DEVICES[-1:])


def test_another_process_lists_the_same_devices(capsys):
    here = devices.query_devices()
    devices.devices_without_mask.cache_clear()
    assert list(devices.devices_without_mask()) == here
    devices.print_devices()
    assert [Device(**device) for device in json.loads(capsys.readouterr().out)] == here


def test_a_uuid_is_written_as_cuda_writes_it():
    assert devices.uuid_text(bytes(range(16))) == "GPU-00010203-0405-0607-0809-0a0b0c0d0e0f"
