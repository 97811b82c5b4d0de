"""`StereoStream` gives the dataset's arrays in any order and process."""

import pickle
from importlib import import_module

import numpy as np
import pytest
from heavy import heavy
from tiny_datasets import cheap

from semisynth_gl.augmentation.augmentation import Augmentation
from semisynth_gl.frame.camera import Crop, StereoCamera
from semisynth_gl.frame.channels import ViewArrays
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.errors import BackendError, InputError
from semisynth_gl.pairs.pipeline import PairRenderer

torch = heavy("torch")
pytestmark = pytest.mark.heavy

from torch.utils.data import DataLoader  # noqa: E402 - optional

from semisynth_gl.torch import StereoStream  # noqa: E402
from semisynth_gl.torch.dataset import to_sample  # noqa: E402

TIMEOUT_S = 120
SEED = 3


def test_tensors_have_torchs_order_of_axes_and_types_that_it_works_with():
    camera = StereoCamera.centred(5, 4, 6.0, 0.25, 1.0)
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (4, 5, 3), dtype=np.uint8)
    flow = rng.normal(size=(4, 5, 4)).astype(np.float32)[..., :2]
    ids = np.full((4, 5), 65535, np.uint16)
    left = ViewArrays({"image": image, "disparity": flow[..., 0], "instances": ids, "flow": flow})
    frame = Frame(camera, left, ViewArrays({"image": image}))
    sample = to_sample(7, frame)
    assert sample["index"] == 7
    assert sample["camera"] == {
        "focal_px": 6.0, "baseline_m": 0.25, "doffs_px": 1.0, "cx_left_px": 1.5, "cx_right_px": 2.5, "cy_px": 1.5,
        "right_roll_rad": 0.0, "right_pitch_rad": 0.0, "right_y_px": 0.0, "focal_ratio": 1.0, "focal_y_px": 6.0,
    }  # fmt: skip
    assert set(sample) == {"index", "camera", "left", "right", "disparity_left", "instances_left", "flow_left"}
    assert sample["left"].is_contiguous()
    np.testing.assert_array_equal(sample["flow_left"].numpy(), flow.transpose(2, 0, 1))
    assert sample["instances_left"].dtype == torch.int32
    assert int(sample["instances_left"].max()) == 65535


def assert_same(sample, frame):
    expected = to_sample(sample["index"], frame)
    assert list(sample) == list(expected)
    assert all(torch.equal(sample[role], expected[role]) for role in frame.arrays())


def place_of(sample, cx_left_px, cy_px):
    """Return the crop of a sample of (20, 30) pixels, from its principal point and the whole image's."""
    camera = sample["camera"]
    return Crop(round(cx_left_px - camera["cx_left_px"]), round(cy_px - camera["cy_px"]), 30, 20)


@pytest.mark.one_backend
@pytest.mark.parametrize("checked", [True, False])
def test_samples_come_in_any_order_and_frames_of_a_sequence_share_their_crop(backend, checked):
    config, order = cheap(sequence={"length": 3}), [9, 0, 10, 4, 1, 3, -2]
    stream, crops = StereoStream(config, SEED, 12, crop=(20, 30), checked=checked, backend=backend), {}
    with PairRenderer(config, SEED, backend) as renderer:
        for index in order:
            sample = stream[index]
            assert sample["index"] == index % 12
            whole = renderer.render(index % 12).frame
            place = place_of(sample, whole.camera.cx_left_px, whole.camera.cy_px)
            assert crops.setdefault(index % 12 // 3, place) == place
            assert_same(sample, whole.cropped(place).with_own_masks())
    assert len(set(crops.values())) == 3
    stream.set_epoch(1)
    other = place_of(stream[9], whole.camera.cx_left_px, whole.camera.cy_px)
    assert other not in crops.values()


@pytest.mark.one_backend
def test_a_renderer_opens_for_the_first_sample_and_closes_when_told(backend, monkeypatch):
    held = []

    class Watched(PairRenderer):
        def __init__(self, *args, **options):
            super().__init__(*args, **options)
            held.append(self)

        def release(self):
            held.remove(self)
            super().release()

    monkeypatch.setattr(import_module("semisynth_gl.torch.stream"), "PairRenderer", Watched)
    stream = StereoStream(cheap(), SEED, 5, backend=backend)
    stream.close()
    assert not held
    first = [stream[index]["left"] for index in (0, 3)][1]
    assert len(held) == 1
    stream.close()
    stream.close()
    assert not held
    assert torch.equal(stream[3]["left"], first)
    # Neither the renderer nor its atlas is pickled for workers.
    assert len(pickle.dumps(stream)) < 10_000
    with pytest.raises(IndexError, match="5 pairs, got number 5"):
        stream[5]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"config": "kitti"}, "load_config"),
        ({"seed": -1}, "seed: must be 0 or more, got -1"),
        ({"pairs": 0}, "pairs: must be from 1 .* got 0"),
        ({"split": "test"}, "split: must be one of train, got 'test'"),
        ({"splits": ("train", "dev")}, "splits: must be one of train, validation, test, got 'dev'"),
        ({"crop": (49, 10)}, "crop: must be from 1 to 48, got 49"),
        ({"backend": "glx"}, "auto, egl, osmesa, got 'glx'"),
        ({"gpus": (-1,)}, "gpus: must be 0 or more"),
        ({"device": "cuda"}, "checked=False.*pin_memory=True"),
        ({"device": "cuda", "backend": "osmesa", "checked": False}, "EGL and a GPU that torch finds"),
        *(
            ({"device": "cuda", "checked": False, **more}, "no augmentation, and a config without a lens or")
            for more in ({"config": cheap(imperfections={"noise": [1, 2]})}, {"augmentation": Augmentation()})
        ),
    ],
)
def test_arguments_that_cannot_be_used_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        StereoStream(**({"config": cheap(), "seed": SEED, "pairs": 2} | options))


@pytest.mark.one_backend
def test_workers_forked_from_a_process_with_opengl_are_told_apart(backend):
    stream = StereoStream(cheap(), SEED, 2, backend=backend)
    stream[0]
    with pytest.raises(BackendError, match=r"this process was forked.*'spawn'"):
        next(iter(DataLoader(stream, num_workers=1, multiprocessing_context="fork", timeout=TIMEOUT_S)))


@pytest.mark.one_backend
def test_workers_that_stay_render_what_one_process_renders(backend):
    stream = StereoStream(cheap(), SEED, 7, crop=(20, 30), backend=backend)
    ways = {"num_workers": 2, "multiprocessing_context": "spawn", "persistent_workers": True, "timeout": TIMEOUT_S}
    loader = DataLoader(stream, 2, **ways)
    for epoch in range(2):
        stream.set_epoch(epoch)
        batches = list(zip(loader, DataLoader(stream, 2), strict=True))
        assert [found["index"].tolist() for found, _ in batches] == [[0, 1], [2, 3], [4, 5], [6]]
        assert all(
            torch.equal(found[name], batch[name]) for found, batch in batches for name in ("left", "disparity_left")
        )
