"""A stream and a dataset augment a pair alike, in any process, and otherwise in each epoch."""

from dataclasses import replace

import pytest
from hand_made_datasets import write_dataset
from heavy import heavy
from tiny_datasets import cheap

from semisynth_gl.augmentation import PRESETS, Augmentation
from semisynth_gl.dataset.generate import generate
from semisynth_gl.frame.channels import ROLES
from semisynth_gl.inputs.errors import InputError

torch = heavy("torch")
pytestmark = pytest.mark.heavy

from torch.utils.data import DataLoader  # noqa: E402 - torch is optional

from semisynth_gl.torch import StereoDataset, StereoStream  # noqa: E402

SEED, CROP = 3, (32, 40)
CHANGES = replace(PRESETS["raft-stereo"], mirrored=0.5, noise=(1, 4), rectangle_px=(5, 20))


def same(sample, other):
    return list(sample) == list(other) and all(
        torch.equal(value, other[name]) if name in ROLES else value == other[name] for name, value in sample.items()
    )


@pytest.mark.parametrize("backend", ["egl"], indirect=True)
def test_a_dataset_has_the_augmented_samples_of_the_stream(backend, tmp_path):
    config = cheap(sequence={"length": 2}, outputs=["visibility", "correspondence", "flow", "depth"])
    generate(config, tmp_path / "set", 6, SEED, layout="webdataset", backend=backend)
    stream = StereoStream(config, SEED, 6, crop=CROP, augmentation=CHANGES)
    dataset = StereoDataset(tmp_path / "set", crop=CROP, augmentation=CHANGES)
    samples = list(stream)
    assert [same(*both) for both in zip(samples, dataset, strict=True)] == [True] * 6
    assert all(sample["left"].shape == (3, *CROP) for sample in samples)
    # Both frames of a sequence change alike, but for their noise.
    cameras = [tuple(sample["camera"].values()) for sample in samples]
    assert cameras[::2] == cameras[1::2]
    assert len(set(cameras)) == 3
    # Where pixels come from does not matter to where they are drawn.
    unchecked = StereoStream(config, SEED, 6, crop=CROP, augmentation=CHANGES, checked=False)
    assert [same(*both) for both in zip(samples, unchecked, strict=True)] == [True] * 6


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("augmented")
    write_dataset(folder, "webdataset", {"train": 7}, 3)
    return folder


SMALL = Augmentation(scale=(0.8, 1.3), mirrored=0.5, noise=(1, 3), brightness=(0.7, 1.3))
CUT = (16, 24)


def test_samples_are_the_same_in_every_process(folder):
    dataset = StereoDataset(folder, crop=CUT, augmentation=SMALL)
    loaded = DataLoader(dataset, batch_size=None, num_workers=2, multiprocessing_context="spawn")
    assert [same(*both) for both in zip(dataset, loaded, strict=True)] == [True] * 7
    batch = next(iter(DataLoader(dataset, batch_size=7)))
    assert batch["left"].shape == (7, 3, *CUT)


def test_each_epoch_and_each_seed_changes_samples_otherwise(folder):
    def sums(dataset):
        return [int(sample["left"].sum()) for sample in dataset]

    dataset, other = (StereoDataset(folder, crop=CUT, augmentation=SMALL, seed=seed) for seed in (None, 8))
    first = sums(dataset)
    dataset.set_epoch(1)
    assert len({*first, *sums(dataset), *sums(other)}) == 21


def test_a_changed_sample_has_the_keys_of_another(folder):
    plain, changed = (StereoDataset(folder, crop=CUT, augmentation=changes)[0] for changes in (None, SMALL))
    assert list(plain) == list(changed)
    assert plain["camera"].keys() == changed["camera"].keys()
    assert plain["camera"]["focal_y_px"] == plain["camera"]["focal_px"]


def test_a_stretched_sample_says_its_vertical_focal_length(folder):
    stretched = StereoDataset(folder, crop=CUT, augmentation=Augmentation(stretch=(1.5, 1.5)))[0]["camera"]
    assert stretched["focal_px"] == pytest.approx(1.5 * stretched["focal_y_px"])


def test_augmentations_that_cannot_be_used_are_refused(folder):
    with pytest.raises(InputError, match="need crop="):
        StereoDataset(folder, augmentation=SMALL)
    with pytest.raises(InputError, match="scale: expected at least"):
        StereoDataset(folder, crop=(30, 40), augmentation=Augmentation(scale=(0.5, 0.8)))
