"""`StereoDataset` gives the stream's samples: in any layout, in workers, in batches."""

from dataclasses import replace

import numpy as np
import pytest
from hand_made_datasets import write_dataset
from heavy import heavy
from tiny_datasets import cheap

from semisynth_gl.augmentation.augmentation import PRESETS, Augmentation
from semisynth_gl.dataset.generate import generate
from semisynth_gl.frame.channels import CHANNELS, OUTPUTS, ROLES
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.layouts import find_layout

torch = heavy("torch")
pytestmark = pytest.mark.heavy

from torch.utils.data import DataLoader, get_worker_info  # noqa: E402 - torch is optional

from semisynth_gl.torch import StereoDataset, StereoStream  # noqa: E402

TIMEOUT_S = 120
SEED = 3
CROP = (20, 30)
CUT = (16, 24)
SMALL = Augmentation(scale=(0.8, 1.3), mirrored=0.5, noise=(1, 3), brightness=(0.7, 1.3))
CHANGES = replace(PRESETS["raft-stereo"], mirrored=0.5, noise=(1, 4), rectangle_px=(5, 20))
SPLITS = {"train": 4, "test": 2}
MASKS = {channel.mask for channel in CHANNELS.values()}
# Half a step of the files; for JPEG, one level more than the largest error measured here.
ROUNDING = {
    "kitti": {"disparity": 1 / 512, "flow": 1 / 128, "flow_backward": 1 / 128},
    "crestereo": {"disparity": 1 / 64, "image": 5},
}


def same(sample, other):
    return (
        list(sample) == list(other)
        and all(sample[name] == other[name] for name in ("index", "camera"))
        and all(torch.equal(sample[name], other[name]) for name in sample if name in ROLES)
    )


@pytest.fixture(scope="module")
def moving():
    """Make a config of sequences with every output."""
    eye = {"fx_px": 140, "distortion": [-0.3, 0.05, 0.001, 0], "rotation_deg": [0.2, 1, 0.3]}
    lens = {"raw_width_px": 64, "raw_height_px": 48, "left": eye, "right": eye}
    return cheap(sequence={"length": 2}, outputs=list(OUTPUTS), lens=lens)


@pytest.fixture(scope="module")
def streamed(moving):
    """Return the stream's samples by split and crop."""
    return {
        (split, crop): list(StereoStream(moving, SEED, pairs, split=split, splits=tuple(SPLITS), crop=crop))
        for split, pairs in SPLITS.items()
        for crop in ((None, CROP) if split == "train" else (CROP,))
    }


@pytest.fixture(scope="module")
def hand_made(tmp_path_factory):
    """Write seven training pairs and three test pairs as tars."""
    folder = tmp_path_factory.mktemp("hand-made")
    write_dataset(folder, "webdataset", {"train": 7, "test": 3}, 3)
    return folder


@pytest.mark.parametrize("backend", ["egl"], indirect=True)
@pytest.mark.parametrize("layout", ["webdataset", "kitti", "crestereo"])
def test_a_dataset_has_the_samples_of_the_stream(backend, moving, streamed, layout, tmp_path):
    lacks = find_layout(layout).lacks | ({"raw"} if layout == "crestereo" else set())
    said = moving.model_copy(update={"outputs": tuple(output for output in moving.outputs if output not in lacks)})
    generate(said, tmp_path / "set", SPLITS, SEED, layout=layout, backend=backend)
    rounding = ROUNDING.get(layout, {})
    roles = {role: channel for role, (_, channel) in ROLES.items() if channel.output not in lacks}
    for (split, crop), wanted in streamed.items():
        dataset = StereoDataset(tmp_path / "set", split, crop=crop)
        assert len(dataset) == SPLITS[split]
        for sample, stored in zip(wanted, dataset, strict=True):
            assert list(stored) == [key for key in sample if key not in ROLES or key in roles]
            assert stored["index"] == sample["index"]
            assert stored["camera"] == sample["camera"]
            assert sample.keys() == {"index", "camera", *ROLES}
            for role, channel in roles.items():
                tensor, other = sample[role], stored[role]
                assert (other.dtype, other.shape, other.is_contiguous()) == (tensor.dtype, tensor.shape, True)
                if rounding and channel.name in MASKS:  # rounding may move a point across the image's or crop's border
                    assert (other != tensor).double().mean() < (0.01 if crop else 0.001)
                    continue
                atol = rounding.get(channel.name, 0)
                np.testing.assert_allclose(other.double(), tensor.double(), rtol=0, atol=atol, err_msg=role)


@pytest.mark.parametrize("backend", ["egl"], indirect=True)
def test_pairs_of_one_scene_share_their_crop_and_no_tensor(backend, tmp_path):
    camera = {"baseline_m": None, "baselines": [0.4, 1.0, 0.7], "sway_m": 0.05}
    config = cheap(sequence={"length": 2}, camera=camera, outputs=["visibility", "flow"])
    stream = StereoStream(config, SEED, 11, crop=CROP)
    order = [3, 4, 5, 9, 10, 4]
    streamed = [stream[index] for index in order]
    assert [sample["index"] for sample in streamed] == order
    assert torch.equal(streamed[0]["left"], streamed[1]["left"])
    streamed[0]["left"] += 1  # changing one sample must not change the other
    assert not torch.equal(streamed[0]["left"], streamed[1]["left"])
    streamed[0]["left"] -= 1
    generate(config, tmp_path / "set", 11, SEED, layout="webdataset", backend=backend)
    stored = StereoDataset(tmp_path / "set", crop=CROP)
    assert [same(sample, stored[sample["index"]]) for sample in streamed] == [True] * 6


def place_of(sample, whole):
    """Return a crop's corner, from its principal point and the whole image's."""
    return tuple(round(whole["camera"][name] - sample["camera"][name]) for name in ("cx_left_px", "cy_px"))


def test_crops_are_parts_that_the_seed_and_the_epoch_choose(hand_made):
    whole, crops = StereoDataset(hand_made), StereoDataset(hand_made, crop=CROP)

    def places(dataset):
        return [place_of(sample, pair) for sample, pair in zip(dataset, whole, strict=True)]

    first = places(crops)
    assert len(set(first)) == 7
    assert places(crops) == places(StereoDataset(hand_made, crop=CROP, seed=SEED)) == first
    others, reseeded = [], StereoDataset(hand_made, crop=CROP, seed=SEED + 1)
    for dataset, epoch in ((crops, 1), (crops, 2), (reseeded, 0), (reseeded, 1)):
        dataset.set_epoch(epoch)
        others.append(places(dataset))
    assert len({*map(tuple, [first, *others])}) == 5
    crops.set_epoch(0)
    assert places(crops) == first
    test = StereoDataset(hand_made, "test", crop=CROP)
    assert [place_of(*both) for both in zip(test, StereoDataset(hand_made, "test"), strict=True)] != first[:3]


def by_worker(sample):
    return sample | {"worker": get_worker_info().id}


@pytest.mark.parametrize("backend", ["egl"], indirect=True)
def test_forked_workers_read_what_this_process_reads(backend, hand_made):
    # Render before the fork: a dataset's workers must not need OpenGL.
    assert len(StereoStream(cheap(), SEED, 1, backend=backend)[0]["left"]) == 3
    dataset = StereoDataset(hand_made, None, crop=CROP, transform=by_worker)
    found = list(DataLoader(dataset, None, num_workers=2, multiprocessing_context="fork", timeout=TIMEOUT_S))
    assert [sample.pop("worker") for sample in found] == [0, 1] * 5
    assert [same(*both) for both in zip(found, StereoDataset(hand_made, None, crop=CROP), strict=True)] == [True] * 10


def test_workers_that_stay_follow_the_epoch(hand_made):
    dataset = StereoDataset(hand_made, crop=CROP, augmentation=SMALL)
    loader = DataLoader(
        dataset, None, num_workers=1, multiprocessing_context="spawn", persistent_workers=True, timeout=TIMEOUT_S
    )
    for epoch in range(3):
        dataset.set_epoch(epoch)
        assert [same(*both) for both in zip(loader, dataset, strict=True)] == [True] * 7


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"crop": (0, 10)}, "crop: must be from 1 to 32, got 0"),
        ({"crop": (16, 10.5)}, "crop: must be a whole number, got 10.5"),
        ({"crop": 16}, r"crop: expected \(height, width\), got 16"),
        ({"seed": -1}, "seed: must be 0 or more, got -1"),
        ({"augmentation": SMALL}, "crop="),
        ({"split": "validation"}, "expected a split of train, test, got 'validation'"),
    ],
)
def test_arguments_that_cannot_be_used_are_refused(hand_made, options, message):
    with pytest.raises(InputError, match=message):
        StereoDataset(hand_made, **options)


def test_pairs_are_found_by_whole_numbers_and_keep_their_values(hand_made):
    dataset = StereoDataset(hand_made)
    dataset[6]["left"].zero_()  # as a training may change its batch
    assert dataset[-1]["left"].any()
    assert same(dataset[-1], dataset[6])
    for wrong, error in ((7, IndexError), (1.0, InputError)):
        with pytest.raises(error):
            dataset[wrong]
    with pytest.raises(InputError, match="epoch: must be from 0"):
        dataset.set_epoch(-1)


# Augmentations


@pytest.mark.parametrize("backend", ["egl"], indirect=True)
def test_a_dataset_has_the_augmented_samples_of_the_stream(backend, tmp_path):
    config = cheap(sequence={"length": 2}, outputs=["visibility", "correspondence", "flow", "depth"])
    generate(config, tmp_path / "set", 6, SEED, layout="webdataset", backend=backend)
    stream = StereoStream(config, SEED, 6, crop=(32, 40), augmentation=CHANGES)
    dataset = StereoDataset(tmp_path / "set", crop=(32, 40), augmentation=CHANGES)
    samples = list(stream)
    assert [same(*both) for both in zip(samples, dataset, strict=True)] == [True] * 6
    assert all(sample["left"].shape == (3, 32, 40) for sample in samples)
    # Both frames of a sequence get the same augmentation except noise.
    cameras = [tuple(sample["camera"].values()) for sample in samples]
    assert cameras[::2] == cameras[1::2]
    assert len(set(cameras)) == 3
    # Checked pairs are rendered whole and then cropped, unchecked ones only in the crop.
    unchecked = StereoStream(config, SEED, 6, crop=(32, 40), augmentation=CHANGES, checked=False)
    assert [same(*both) for both in zip(samples, unchecked, strict=True)] == [True] * 6


def test_a_stretched_sample_says_its_vertical_focal_length(hand_made):
    plain, stretched = (
        StereoDataset(hand_made, crop=CUT, augmentation=changes)[0]
        for changes in (None, Augmentation(stretch=(1.5, 1.5)))
    )
    assert list(plain) == list(stretched)
    assert plain["camera"]["focal_px"] == plain["camera"]["focal_y_px"] == stretched["camera"]["focal_y_px"]
    assert stretched["camera"]["focal_px"] == pytest.approx(1.5 * stretched["camera"]["focal_y_px"])
