"""The example that trains: its network, its losses, its checkpoints, and the whole command on a few small pairs."""

import json
import os
import re
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import pytest
from backends import backend_fault
from heavy import heavy

torch = heavy("torch")
pytestmark = pytest.mark.heavy
ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "examples" / "small-rooms.yaml"
sys.path.insert(0, str(ROOT / "examples"))

import predict as predict_module  # noqa: E402 - found by the line above
import stereo_evaluation as evaluation  # noqa: E402
import train_network  # noqa: E402
from click.testing import CliRunner  # noqa: E402
from network_data import Data, batches_of, read_augmentation, read_sources  # noqa: E402
from network_form import Form, find_device, load_weights  # noqa: E402
from network_losses import LOSSES, cross_entropy_loss, estimates_of, sequence_loss, smooth_l1_loss  # noqa: E402
from network_training import Plan, Training, join_processes  # noqa: E402
from PIL import Image  # noqa: E402
from snippets import blocks  # noqa: E402
from stereo_network import Estimates, StereoNetwork, correlated, warped  # noqa: E402

from semisynth_gl.augmentation import PRESETS, Augmentation  # noqa: E402
from semisynth_gl.codecs.pfm import PFM  # noqa: E402
from semisynth_gl.config import load_config  # noqa: E402
from semisynth_gl.dataset.generate import generate  # noqa: E402
from semisynth_gl.dataset.reader import open_dataset  # noqa: E402
from semisynth_gl.inputs.errors import InputError, SemisynthError  # noqa: E402
from semisynth_gl.judge.truth import Truth  # noqa: E402

SMALL = [
    "camera.width_px=96",
    "camera.height_px=64",
    "camera.focal_px=100",
    "disparity.max_px=30",
    "particles.size_px=[10, 40]",
    "models.complex=0",
    "textures.source=procedural",
    "textures.max_patches=16",
]
CROP = ("--crop", "48", "64", "--max-disparity", "32", "--batch", "2", "--workers", "0", "--device", "cpu")


@pytest.fixture(scope="module", autouse=True)
def _quiet(one_thread):
    return one_thread


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    folder = tmp_path_factory.mktemp("train") / "pairs"
    generate(load_config(CONFIG, SMALL), folder, 3, 0)
    return folder


@pytest.fixture
def network():
    torch.manual_seed(0)
    return StereoNetwork(32)


def noise(*shape, seed=0):
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


def run(*arguments):
    return CliRunner().invoke(train_network.main, [str(argument) for argument in arguments])


# --- what the documentation says ---


def test_the_documented_augmentation_is_the_preset(tmp_path):
    [block] = [block for block in blocks("training") if block.language == "yaml"]
    (tmp_path / "own.yaml").write_text(block.text)
    assert read_augmentation(str(tmp_path / "own.yaml")) == PRESETS["semisynth"]


@pytest.mark.usefixtures("small_motorcycle")
def test_the_documented_network_learns_by_the_documented_command(dataset, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    [written] = [block for block in blocks("training") if "def make(" in block.text]
    (tmp_path / "my_network.py").write_text(written.text)
    [command] = [words for each in blocks("training") for words in each.commands if "my_network:make" in words]
    given = [str(dataset) if word == "place.yaml" else word for word in command[2:]]
    done = run(*given, *CROP, "--steps", "20", "--out", "out")
    assert done.exit_code == 0, done.output
    losses = json.loads((tmp_path / "out" / "metrics.json").read_text())["losses"]
    assert np.mean(losses[-5:]) < 0.9 * np.mean(losses[:5])
    found = {each.relative_to("out").as_posix() for each in Path("out").rglob("*") if each.is_file()}
    assert found == {"checkpoint.pt", "pictures/step-000020.png", "weights.pt", "metrics.json"}


# --- the network ---


@pytest.mark.parametrize("size", [(48, 64), (37, 51), (16, 130)])
def test_images_of_any_size_give_disparities_of_that_size(network, size):
    with torch.inference_mode():
        estimates = network(noise(1, 3, *size), noise(1, 3, *size, seed=1))
    assert [each.shape for each in estimates.disparities] == [(1, *size)] * 3
    assert all(torch.isfinite(each).all() and (each >= 0).all() for each in estimates.disparities)


def test_the_cost_volume_finds_a_shift():
    left = noise(1, 16, 3, 20) - 0.5
    right = torch.roll(left, -4, dims=-1)
    volume = correlated((left, right), levels=8, groups=4)
    assert volume.shape == (1, 4, 8, 3, 20)
    assert (volume.mean(1).argmax(1)[..., 4:] == 4).all()
    assert (volume[:, :, 5, :, :5] == 0).all()


def test_warping_undoes_a_shift():
    left = noise(1, 2, 6, 20)
    right = torch.roll(left, -3, dims=-1)
    there = warped(right, torch.full((1, 6, 20), 3.0))
    assert torch.allclose(there[..., 3:], left[..., 3:], atol=1e-5)


# --- losses ---


@pytest.mark.parametrize("loss", LOSSES.values())
@pytest.mark.parametrize("invalid", [torch.inf, torch.nan, 0.0, 32.0, 500.0])
def test_pixels_without_a_usable_truth_do_not_count(network, loss, invalid):
    truth = torch.full((1, 16, 32), 8.0)
    truth[:, :, 20:] = invalid
    estimates = network(noise(1, 3, 16, 32), noise(1, 3, 16, 32, seed=1))
    found = loss(estimates, truth, 32)
    found.backward()
    assert all(torch.isfinite(each.grad).all() for each in network.parameters() if each.grad is not None)
    changed = [each.clone() for each in estimates.disparities]
    for each in changed:
        each[:, :, 20:] += 100
    assert loss(Estimates(changed, estimates.scores), truth, 32) == found
    for each in changed:
        each[:, :, :20] += 100
    assert loss(Estimates(changed, estimates.scores), truth, 32) > found + 100
    assert loss(estimates, torch.full((1, 16, 32), torch.inf), 32) == 0


def test_scores_of_the_true_level_cost_least():
    truth = torch.full((1, 8, 8), 10.0)  # between the levels 2 and 3
    disparities = [truth] * 3
    losses = []
    for levels in ([2, 3], [2], [6]):
        scores = torch.full((1, 8, 2, 2), -9.0)
        scores[:, levels] = 9.0
        losses.append(cross_entropy_loss(Estimates(disparities, scores), truth, 32).item())
    assert losses == sorted(losses)
    assert losses[0] == pytest.approx(np.log(2), abs=1e-3)
    with pytest.raises(InputError, match=r"which has no scores: .* --loss smooth-l1 or sequence"):
        cross_entropy_loss(disparities, truth, 32)
    with pytest.raises(InputError, match=r"gave scores \(1, 8, 2, 1\) with step_px 4: expected"):
        cross_entropy_loss(Estimates(disparities, scores[..., :1]), truth, 32)


def test_estimates_weigh_as_their_authors_have_it():
    truth = torch.full((1, 4, 4), 10.0)

    def of(loss, *errors):
        return loss([truth + error for error in errors], truth, 32).item()

    # The first of n estimates weighs 0.9 ** 15 in RAFT-Stereo, for any n.
    for count in (2, 5, 16):
        assert of(sequence_loss, 4, *[0] * (count - 1)) == pytest.approx(4 * 0.9**15, rel=1e-5)
    assert of(sequence_loss, 4) == of(sequence_loss, 0, 4) == 4
    assert [of(smooth_l1_loss, *errors) for errors in ((4, 0, 0), (0, 4, 0), (0, 0, 4), (4,))] == pytest.approx([
        0.5 * 3.5, 0.7 * 3.5, 3.5, 3.5
    ])  # fmt: skip
    assert of(smooth_l1_loss, 4, 0, 0, 0) == pytest.approx(0.5 * 3.5)


def test_disparities_are_found_in_what_networks_give():
    flat = noise(2, 4, 6)
    for output in (flat, [flat], (flat[:, None], flat), Estimates([flat], flat)):
        assert torch.equal(estimates_of(output)[-1], flat)
    for output, came in (
        ({"disparity": flat}, "a dict with the keys disparity"),
        ([], "a list of nothing"),
        ([flat, None], "a list of Tensor, NoneType"),
        (3.0, "float"),
    ):
        with pytest.raises(InputError, match=f"^gave {came}: expected a tensor .* wrap the network"):
            estimates_of(output)
    for output in (noise(2, 3, 4, 6), [noise(2, 2, 3), flat]):
        with pytest.raises(InputError, match=r"expected \(B, H, W\), the images', each"):
            estimates_of(output)


# --- data ---


DATA = Data((), (), (32, 48), Augmentation(), batch=1, seed=3)


def read_disparity(path):
    return PFM.decode(path.read_bytes(), path)


def crops_of(folder, count, **changes):
    """What is trained on, of a dataset."""
    samples = iter(replace(DATA, sources=((str(folder), 1.0),), **changes).samples(0))
    return [next(samples) for _ in range(count)]


def test_crops_agree_with_the_pairs_and_repeat(dataset):
    crops, again = crops_of(dataset, 7), crops_of(dataset, 7)
    assert all(torch.equal(crops[i][name], again[i][name]) for i in (6, 2) for name in crops[i])
    first = crops[0]
    assert set(first) == {"left", "right", "disparity_left"}
    assert (first["left"].shape, first["left"].dtype) == ((3, 32, 48), torch.uint8)
    whole = [pair.left.disparity for pair in open_dataset(dataset)]
    windows = [np.lib.stride_tricks.sliding_window_view(each, (32, 48)) for each in whole]
    assert any((window == first["disparity_left"].numpy()).all(axis=(-1, -2)).any() for window in windows)
    # Each pair comes once before one comes again.
    of = [[(w == crops[i]["disparity_left"].numpy()).all(axis=(-1, -2)).any() for w in windows] for i in range(3)]
    assert np.array(of).sum(0).tolist() == [1, 1, 1]


def test_batches_go_on_from_any_sample_whatever_the_workers(dataset):
    data = replace(DATA, sources=((str(dataset), 1.0),), augmentation=PRESETS["semisynth"], batch=2)
    begun, later = batches_of(data, 0, 0), batches_of(data, 6, 2)
    for _ in range(3):
        next(begun)
    for _ in range(2):
        expected, found = next(begun), next(later)
        assert all(torch.equal(expected[name], found[name]) for name in expected)


def test_crops_are_changed_by_the_augmentation_and_their_truth_is_not(dataset):
    for source in (dataset, CONFIG):
        plain, changed = (
            crops_of(source, 3, settings=tuple(SMALL), augmentation=augmentation)
            for augmentation in (Augmentation(), PRESETS["semisynth"])
        )
        for one, other in zip(plain, changed, strict=True):
            assert torch.equal(one["disparity_left"], other["disparity_left"])
            assert not torch.equal(one["left"], other["left"])


def test_an_edited_config_makes_another_training(tmp_path):
    config = tmp_path / "rooms.yaml"
    found = []
    for density in ("sparse", "dense", "sparse"):
        config.write_text(f"extends: {CONFIG}\nname: rooms\nparticles: {{density: {density}}}\n")
        data = replace(DATA, sources=((str(config), 1.0),), settings=tuple(SMALL))
        found.append(json.dumps(data.samples().source.identity))
    assert found[0] == found[2] != found[1]


def test_batches_that_divide_a_sequence_are_refused():
    data = replace(DATA, sources=((str(CONFIG), 1.0),), settings=(*SMALL, "sequence.length=4"))
    assert replace(data, batch=8).samples().dealing.block == 8
    with pytest.raises(
        InputError, match=r"--batch 2: expected a multiple of .* here 4; or give --set sequence.length=1"
    ):
        replace(data, batch=2).samples()


def test_another_seed_gives_other_crops(dataset):
    crops, others = crops_of(dataset, 3), crops_of(dataset, 3, seed=4)
    assert not any(torch.equal(one["left"], other["left"]) for one in crops for other in others)


def test_streams_and_datasets_mix(dataset):
    data = replace(DATA, sources=((str(dataset), 1.0), (str(CONFIG), 3.0)), settings=tuple(SMALL))
    samples = iter(data.samples(0))
    drawn = [next(samples)["disparity_left"].numpy() for _ in range(24)]
    whole = [pair.left.disparity for pair in open_dataset(dataset)]
    windows = [np.lib.stride_tricks.sliding_window_view(each, (32, 48)) for each in whole]
    of_dataset = sum(any((window == crop).all(axis=(-1, -2)).any() for window in windows) for crop in drawn)
    assert 2 <= of_dataset <= 12


def test_shares_and_augmentations_are_read(tmp_path):
    assert read_sources(("a=b/c=2", "out/rooms", "x=0.5")) == (("a=b/c", 2.0), ("out/rooms", 1.0), ("x", 0.5))
    with pytest.raises(InputError, match="expected a number after =, the share, got much"):
        read_sources(("rooms=much",))
    assert read_augmentation("psmnet") == Augmentation()
    own = tmp_path / "own.yaml"
    own.write_text("noise: [0, 3]\nmirrored: 0.5\n")
    assert read_augmentation(str(own)) == Augmentation(noise=(0, 3), mirrored=0.5)
    for text, words in (
        ("noise: [0, 3]\nmirorred: 0.5\n", ":2: mirorred: unknown key; did you mean mirrored?"),
        ("# none\n\nfog: 1", f":3: fog: unknown key; expected one of: {', '.join(sorted(Augmentation().values))}"),
        ("noise: [0, 3]\njpeg: 2\n", ":2: jpeg: expected a share from 0 to 1, got 2"),
        ("noise: 3\nmirorred: 1", ":1: noise: expected (low, high), got 3\n--augment FILE:2: mirorred: unknown key;"),
        ("- noise", ":1: expected keys of Augmentation, such as noise: [0, 3], got ['noise']"),
        ("", ":1: expected keys of Augmentation"),
        ("noise: [0, 1]\nnoise: [0, 2]", ":2: noise: not valid YAML: found duplicate key"),
        ("noise: [", ":1: not valid YAML"),
    ):
        own.write_text(text)
        with pytest.raises(InputError) as raised:
            read_augmentation(str(own))
        assert str(raised.value).replace(str(own), "FILE").startswith(f"--augment FILE{words}")
    own.write_bytes(b"noise: [0, 3]  # \xff")
    for name, words in (
        ("semisinth", "did you mean semisynth? expected raft-stereo, .*, or a YAML file with .*: No such file"),
        ("absent", "expected raft-stereo"),
        (str(own), "expected raft-stereo, .* can't decode"),
    ):
        with pytest.raises(InputError, match=f"--augment {name}: {words}".replace("?", r"\?")):
            read_augmentation(name)


# --- training ---


FORM = Form("somewhere:Network", (), "unit", max_disparity_px=32, multiple_px=1)
PLAN = Plan(steps=20, loss="cross-entropy", learning_rate=2e-3, precision="float32", fixed_norms=False, seed=0)


class Shift(torch.nn.Module):
    """The difference of the images plus what it learns, through layers that training and evaluation run differently."""

    def __init__(self):
        super().__init__()
        self.shift = torch.nn.Parameter(torch.zeros(()))
        self.norm = torch.nn.BatchNorm2d(1)
        self.dropout = torch.nn.Dropout(0.5)

    def forward(self, left, right):
        found = self.norm((left - right).mean(1, keepdim=True)) + self.shift
        return self.dropout(found) if self.training else found


def training_of(network, **changes):
    return Training(network, FORM, replace(PLAN, **changes), torch.device("cpu"), 0, {"data": ["rooms"]})


def batch_of(seed=0, size=(8, 8)):
    images = {name: (255 * noise(1, 3, *size, seed=seed + i)).byte() for i, name in enumerate(("left", "right"))}
    return images | {"disparity_left": torch.full((1, *size), 5.0)}


def test_a_few_steps_reduce_the_loss(dataset, network):
    training = training_of(network)
    data = replace(DATA, sources=((str(dataset), 1.0),), crop=(48, 64), batch=2)
    batches = batches_of(data, 0, 0)
    for _ in range(20):
        training.learn(next(batches))
    assert np.mean(training.losses[-5:]) < 0.8 * np.mean(training.losses[:5])


@pytest.mark.parametrize("steps", [1, 2, 3, 20])
def test_any_number_of_steps_can_be_scheduled(steps):
    network = Shift()
    training = training_of(network, steps=steps, loss="smooth-l1")
    for _ in range(steps):
        training.learn(batch_of())
    assert training.step == len(training.losses) == steps
    assert network.shift > 0


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_a_loaded_checkpoint_goes_on_exactly(precision, tmp_path):
    def trained(steps, training):
        for step in range(training.step, steps):
            training.learn(batch_of(step))
        return training

    changes = {"loss": "smooth-l1", "precision": precision}
    whole = trained(8, training_of(Shift(), **changes))
    trained(5, training_of(Shift(), **changes)).save(tmp_path / "checkpoint.pt")
    torch.rand(7)  # somebody else's draws
    later = training_of(Shift(), **changes)
    later.load(tmp_path / "checkpoint.pt")
    trained(8, later)
    assert later.losses == whole.losses
    for name, value in whole.network.state_dict().items():
        assert torch.equal(value, later.network.state_dict()[name]), name
    assert len(set(whole.losses)) == 8  # dropout draws anew in each step


def test_another_trainings_checkpoint_is_refused(tmp_path):
    path = tmp_path / "checkpoint.pt"
    training_of(Shift(), loss="sequence").save(path)
    with pytest.raises(
        InputError, match=r"another training: loss \('sequence' there, 'smooth-l1' now\), learning_rate \("
    ):
        training_of(Shift(), loss="smooth-l1", learning_rate=1.0).load(path)
    torch.save(Shift().state_dict(), path)
    with pytest.raises(InputError, match="is no checkpoint of this program: give its weights to --pretrained"):
        training_of(Shift()).load(path)
    path.write_bytes(b"nothing")
    with pytest.raises(InputError, match=r"expected tensors in a file of torch\.save"):
        training_of(Shift()).load(path)


class Failing(Shift):
    """Gives what a test wants of the left image and the right one."""

    def __init__(self, of):
        super().__init__()
        self.of = of

    def forward(self, left, right):
        return self.of(left, right) + 0 * self.shift


class OneImage(Shift):
    def forward(self, left):
        return left[:, 0]


def halved(left, right):
    smaller = torch.nn.functional.interpolate(left, scale_factor=1 / 8)
    return (right + torch.nn.functional.interpolate(smaller, scale_factor=8))[:, 0]


def halved_line():
    return halved.__code__.co_firstlineno + 2


HINT = "; it got images of 9 x 12 px: if their sides must be multiples of N, "
FAULTS = {
    "signature": (
        OneImage,
        r": TypeError: .*forward\(\) takes 2 .* given: expected a forward\(left, right\) that takes images .*gives",
        "",
    ),
    "own code": (lambda: Failing(lambda left, _: left.absent), r": AttributeError: .*absent' \(FILE, line \d+\)$", ""),
    "sides": (lambda: Failing(halved), rf": RuntimeError: .*size.* \(FILE, line {halved_line()}\)", HINT),
    "shape": (
        lambda: Failing(lambda left, _: left[:, 0, 1:]),
        r" gave disparities \(1, 8, 12\): expected \(1, 9, 12\), the images' size",
        HINT,
    ),
    "type": (lambda: Failing(lambda left, _: left), r" gave disparities of the sizes .*3, 9, 12\)\]: expected", ""),
}


@pytest.mark.parametrize(("make", "words", "hint"), FAULTS.values(), ids=FAULTS)
def test_a_network_that_fails_is_named_with_its_line_and_what_is_expected(make, words, hint):
    words = rf"^network somewhere:Network{words}".replace("FILE", re.escape(__file__)) + hint
    with pytest.raises(InputError, match=words + ("give them to --crop$" if hint else "")) as raised:
        training_of(make(), loss="sequence").learn(batch_of(size=(9, 12)))
    assert "\n" not in str(raised.value)
    assert (raised.value.__cause__ is None) == (" gave " in words)
    image = np.zeros((9, 12, 3), np.uint8)
    with pytest.raises(InputError, match=words + ("give --multiple N" if hint else "")):
        FORM.predict(make(), image, image)


def test_sides_that_suit_all_networks_are_not_blamed():
    with pytest.raises(InputError, match=r"RuntimeError: no \(.*, line \d+\)$"):
        training_of(Failing(refuse), loss="sequence").learn(batch_of(size=(32, 64)))


def test_disparities_that_do_not_depend_on_the_network_are_refused():
    with pytest.raises(InputError, match="expected disparities that depend on its parameters"):
        training_of(Seen(), loss="sequence").learn(batch_of())


def refuse(_, __):
    raise RuntimeError("no")


def test_norms_stay_where_they_are_told_to():
    network = Shift()
    training_of(network, loss="smooth-l1", fixed_norms=True).learn(batch_of())
    assert (network.norm.running_mean, network.norm.num_batches_tracked) == (0, 0)
    training_of(network, loss="smooth-l1").learn(batch_of())
    assert network.norm.num_batches_tracked == 1


def test_a_loss_that_is_not_finite_ends_the_training():
    network = Shift()
    network.shift.data.fill_(torch.nan)
    with pytest.raises(SemisynthError, match="step 1: the loss is nan, in float32: lower --learning-rate"):
        training_of(network, loss="sequence").learn(batch_of())
    assert network.norm.weight.isfinite().all()


class Seen(torch.nn.Module):
    """A network that keeps what it is asked, and gives its first channel."""

    def __init__(self):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.zeros(1))

    def forward(self, left, right):
        self.asked = left, right
        return left[:, :1]


def test_levels_are_those_that_networks_take():
    white = np.full((2, 2, 3), 255, np.uint8)
    for levels, expected in (("unit", [1] * 3), ("byte", [255] * 3), ("imagenet", [2.2489, 2.4286, 2.6400])):
        for image in (white, white[..., 0]):  # grey cameras have one channel
            network = Seen()
            replace(FORM, levels=levels).predict(network, image, image)
            assert network.asked[0][0, :, 0, 0].tolist() == pytest.approx(expected, abs=1e-4)


def test_images_are_padded_where_no_pixel_moves():
    image, network = (255 * noise(5, 9, 3)).byte().numpy(), Seen()
    found = replace(FORM, levels="byte", multiple_px=8).predict(network, image, image)
    assert network.asked[0].shape == (1, 3, 8, 16)
    np.testing.assert_array_equal(found, image[..., 0].astype(np.float32))


def test_weights_are_found_in_files_of_other_trainings(tmp_path):
    cpu, path = torch.device("cpu"), tmp_path / "weights.pth"
    source = Shift()
    source.shift.data.fill_(3.0)
    state = source.state_dict()
    for saved in (state, {"state_dict": {f"module.{name}": value for name, value in state.items()}}, {"model": state}):
        torch.save(saved, path)
        network = Shift()
        load_weights(network, path, cpu)
        assert network.shift == 3
    torch.save({**state, "norm.weight": torch.zeros(4)}, path)
    with pytest.raises(InputError, match=r"5 of its 6 tensors fit the network's 6, and norm\.weight is not among them"):
        load_weights(Shift(), path, cpu)
    torch.save({**state, "more": torch.zeros(4)}, path)
    with pytest.raises(InputError, match="6 of its 7 tensors fit the network's 6, and more is not among them"):
        load_weights(Shift(), path, cpu)
    torch.save([1], path)
    with pytest.raises(InputError, match="expected a dictionary of tensors, got list"):
        load_weights(Shift(), path, cpu)


# --- evaluation ---


def test_constants_are_scored_as_they_should_be():
    truth = np.full((4, 6), 10, np.float32)
    truth[:, :2] = 4
    truth[0] = np.inf
    image = np.zeros((4, 6, 3), np.uint8)
    judges = evaluation.Judges("two planes", "middlebury", {"a": lambda: evaluation.View(image, image, Truth(truth))})
    found = evaluation.figures(judges, evaluation.constant(10))
    assert found["avgerr"] == pytest.approx(2.0)
    assert found["bad-4"] == pytest.approx(100 / 3)
    assert evaluation.figures(judges, evaluation.best_constant) == found
    assert "| ten " in evaluation.table(judges, {"ten": found})


def test_motorcycle_is_as_documented():
    [view] = (read() for read in evaluation.motorcycle().views.values())
    assert view.left.shape == view.right.shape == (500, 741, 3)
    known = np.isfinite(view.truth.disparity)
    assert (view.truth.disparity[known].min() > 7, view.truth.disparity[known].max() < 60) == (True, True)
    # The disparity is that of the left view: what it points at looks alike.
    y, x = np.nonzero(known)
    there = np.clip(np.rint(x - view.truth.disparity[y, x]).astype(int), 0, 740)
    assert np.abs(view.left[y, x].astype(float) - view.right[y, there]).mean() < 10


def scene(folder, size=(6, 8), image=(6, 8)):
    folder.mkdir(parents=True)
    (folder / "disp0GT.pfm").write_bytes(PFM.encode(np.full(size, 3, np.float32)))
    for name in ("im0.png", "im1.png"):
        Image.fromarray(np.zeros(image, np.uint8)).save(folder / name)


def test_scenes_of_a_folder_are_read(tmp_path):
    scene(tmp_path / "Vase")
    judges = evaluation.folder(tmp_path)
    assert list(judges.views) == ["Vase"]
    view = judges.views["Vase"]()
    assert view.left.shape == (6, 8, 3)
    assert evaluation.figures(judges, evaluation.constant(3))["avgerr"] == 0


def test_scenes_that_cannot_be_judged_are_refused(tmp_path):
    scene(tmp_path / "sizes" / "Vase", image=(6, 9))
    with pytest.raises(InputError, match=r"9 x 6 pixels, .* 8 x 6: expected one size"):
        evaluation.folder(tmp_path / "sizes").views["Vase"]()
    (tmp_path / "sizes" / "Vase" / "im1.png").write_bytes(b"nothing")
    with pytest.raises(InputError, match="expected an image"):
        evaluation.folder(tmp_path / "sizes").views["Vase"]()
    (tmp_path / "sizes" / "Vase" / "im1.png").unlink()
    with pytest.raises(InputError, match=r"expected im0\.png and im1\.png"):
        evaluation.folder(tmp_path / "sizes")
    with pytest.raises(InputError, match="there is no such folder"):
        evaluation.folder(tmp_path / "absent")


# --- the command ---


@pytest.fixture
def small_motorcycle(monkeypatch):
    """Motorcycle at a fifth of its size, which is faster."""
    whole = evaluation.motorcycle().views["Motorcycle"]()
    small = evaluation.View(
        whole.left[::5, ::5], whole.right[::5, ::5], Truth(np.ascontiguousarray(whole.truth.disparity[::5, ::5] / 5))
    )
    monkeypatch.setattr(
        evaluation, "motorcycle", lambda: evaluation.Judges("Motorcycle", "middlebury", {"Motorcycle": lambda: small})
    )


@pytest.mark.usefixtures("small_motorcycle")
def test_the_command_trains_and_reports(dataset, tmp_path):
    out = tmp_path / "out"
    options = ("--data", dataset, "--steps", "3", "--every", "2", *CROP, "--evaluate", dataset, "--out", out)
    done = run(*options)
    assert done.exit_code == 0, done.output
    assert all(words in done.output for words in ("untrained, Motorcycle: avgerr", "step 2, Motorcycle", "step 3 of 3"))
    assert "| trained " in done.output
    report = json.loads((out / "metrics.json").read_text())
    assert [each["on"] for each in report["results"]] == ["Motorcycle", str(dataset)]
    for each in report["results"]:
        assert list(each["figures"]) == ["untrained", "constant, each truth's own median", "trained"]
        assert all(set(row) == set(evaluation.COLUMNS) for row in each["figures"].values())
    assert len(report["losses"]) == 3
    assert report["augmentation"] == PRESETS["semisynth"].values
    assert sorted(each.name for each in (out / "pictures").iterdir()) == ["step-000002.png", "step-000003.png"]
    with Image.open(out / "pictures" / "step-000003.png") as drawn:
        assert drawn.width > 800
    again = run(*options)
    assert (again.exit_code, "checkpoint.pt is there already: give --resume" in again.output) == (2, True)
    tuned = run(*options[:-1], tmp_path / "tuned", "--pretrained", out / "weights.pt")
    assert tuned.exit_code == 0, tuned.output
    [first, _] = json.loads((tmp_path / "tuned" / "metrics.json").read_text())["results"]
    assert first["figures"]["pretrained"] == report["results"][0]["figures"]["trained"]


def test_a_killed_training_goes_on_with_the_same_losses(dataset, tmp_path):
    options = ["--data", dataset, *CROP, "--steps", "8", "--every", "2", "--augment", "raft-stereo"]
    done = run(*options, "--out", tmp_path / "whole")
    assert done.exit_code == 0, done.output
    killed = tmp_path / "killed"
    begun = subprocess.Popen(
        [sys.executable, train_network.__file__, *map(str, options), "--out", str(killed)],
        stdout=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
    )
    try:
        while begun.poll() is None and not (killed / "checkpoint.pt").exists():
            time.sleep(0.02)
    finally:
        begun.kill()
        begun.wait()
    assert not (killed / "metrics.json").exists()
    done = run(*options, "--out", killed, "--resume")
    assert done.exit_code == 0, done.output
    whole, gone_on = (json.loads((each / "metrics.json").read_text()) for each in (tmp_path / "whole", killed))
    assert gone_on["losses"] == whole["losses"]
    assert gone_on["results"] == whole["results"]
    assert "going on from step" in done.output
    refused = run(*options, "--out", killed, "--resume", "--seed", "1")
    assert (refused.exit_code, "is from another training: seed (0 there, 1 now)" in refused.output) == (2, True)


def test_two_processes_learn_what_one_learns_of_batches_twice_as_large(dataset, tmp_path):
    weights = []
    for processes, batch in ((1, 2), (2, 1)):
        out = tmp_path / f"of-{processes}"
        options = ["--data", dataset, *CROP, "--batch", batch, "--steps", "6", "--augment", "psmnet", "--out", out]
        command = ["-m", "torch.distributed.run", f"--nproc-per-node={processes}", train_network.__file__, *options]
        done = subprocess.run(
            [sys.executable, *map(str, command)],
            env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert f"on {processes} x cpu" in done.stdout
        assert done.stdout.count("step 6 of 6") == 1
        weights.append(torch.load(out / "weights.pt")["network"])
    torch.manual_seed(0)
    begun, one, two = (
        torch.cat([value.flatten() for value in state.values()]) for state in (StereoNetwork(32).state_dict(), *weights)
    )
    # Adam lets rounding grow where gradients are all but 0.
    assert (one - two).norm() < 0.1 * (one - begun).norm()


NETWORK = """
import torch

class Learnt(torch.nn.Module):
    def __init__(self, size=1, max_disparity=0):
        super().__init__()
        self.made = torch.nn.Parameter(torch.full((size,), float(max_disparity)))

    def forward(self, left, right):
        assert left.shape[-1] % 8 == left.shape[-2] % 8 == 0
        return [left.mean(1, keepdim=True) + self.made.mean()] * 2

class Odd(Learnt):
    def __init__(self):
        super().__init__()
        self.idle, self.beside = (torch.nn.Parameter(torch.ones(())) for _ in range(2))

    def forward(self, left, right):
        return Found(super().forward(left, right), self.beside * left)

class Found:
    def __init__(self, disparities, beside):
        self.disparities, self.beside = disparities, beside

class Negative(Learnt):
    def forward(self, left, right):
        return [-each for each in super().forward(left, right)]

def number():
    return 3

def broken():
    return {}["key"]

nothing = 3
"""


def test_processes_share_what_networks_of_any_output_learn_and_do_not_warn(dataset, tmp_path):
    (tmp_path / "their_networks.py").write_text(NETWORK)
    options = ["--data", dataset, *CROP, "--steps", 3, "--loss", "sequence", "--multiple", 8]
    started = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2", train_network.__file__, *options]
    processes = [
        subprocess.Popen(
            [sys.executable, *map(str, started), "--network", f"their_networks:{network}", "--out", network],
            env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
            cwd=tmp_path,
            stderr=subprocess.PIPE,
            text=True,
        )
        for network in ("Odd", "Learnt")
    ]
    for process in processes:
        _, said = process.communicate()
        assert (process.returncode, "unused" in said) == (0, False), said
    made = torch.load(tmp_path / "Odd" / "weights.pt")["network"]
    assert (made["idle"], made["beside"], made["made"] > 0) == (1, 1, True)


@pytest.mark.usefixtures("small_motorcycle")
def test_any_network_can_be_trained(dataset, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "their_networks.py").write_text(NETWORK)
    (tmp_path / "their_mistake.py").write_text("torhc.nn")
    options = ("--data", dataset, "--steps", "2", *CROP, "--loss", "sequence", "--out", "out")
    done = run("--network", "their_networks:Learnt", "--argument", "size=7", "--multiple", "8", *options)
    assert done.exit_code == 0, done.output
    assert "7 parameters" in done.output
    made = torch.load("out/weights.pt")["network"]["made"]
    assert 31.9 < made[0] < 32  # it began at what --max-disparity said
    for network, words in (
        ("their_networks:Absent", "expected module:callable: module 'their_networks' has no attribute 'Absent'"),
        ("absent:Network", "expected module:callable: No module named 'absent'\n"),
        ("their_networks:number", "expected a torch.nn.Module, got int"),
        ("their_networks:nothing", "expected module:callable, got int"),
        ("their_networks:broken", f"KeyError: 'key' ({tmp_path}/their_networks.py, line 33)"),
        ("their_mistake:Network", "their_mistake cannot be imported: NameError: name 'torhc' is not defined ("),
        ("torch.nn:Identity", "expected parameters to learn, got a network without any"),
    ):
        refused = run("--network", network, *options[:-1], "other")
        assert (refused.exit_code, words in refused.output) == (2, True), refused.output
    warning, weights = (
        "Warning: no disparity that the network predicts is above 0 px",
        ("--pretrained", "out/weights.pt"),
    )
    options = (*options, "--multiple", "8")
    assert warning not in done.output
    negative = run("--network", "their_networks:Negative", *options, "--out", "negative", "--every", "1")
    assert (negative.exit_code, negative.output.count(warning)) == (0, 2)  # not before it learns
    tuned = run("--network", "their_networks:Negative", "--argument", "size=7", *options, "--out", "tuned", *weights)
    assert (tuned.exit_code, tuned.output.count(warning)) == (0, 2)
    refused = run("--network", "their_networks:Learnt", "--argument", "width=7", *options, "--out", "other")
    assert "--argument width=7: " in refused.output


# --- predictions ---


@pytest.mark.usefixtures("small_motorcycle")
def test_the_trained_network_predicts_pairs(dataset, tmp_path):
    done = run("--data", dataset, "--steps", "1", *CROP, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    weights, scenes, found = tmp_path / "out" / "weights.pt", tmp_path / "scenes", tmp_path / "found"
    frame = open_dataset(dataset)[0]
    for name in ("one", "two"):
        (scenes / name).mkdir(parents=True)
        for eye, view in (("im0", frame.left), ("im1", frame.right)):
            Image.fromarray(view.image[: 40 if name == "one" else 64]).save(scenes / name / f"{eye}.png")

    def predict(*options, left="*/im0.png"):
        given = weights, "--left", scenes / left, "--right", scenes / "*/im1.png", "--out", found, *options
        return CliRunner().invoke(predict_module.main, [str(each) for each in given])

    done = predict("--right-out", tmp_path / "right")
    assert done.exit_code == 0, done.output
    network = StereoNetwork(32)
    network.load_state_dict(torch.load(weights)["network"])
    expected = FORM.predict(network, frame.left.image, frame.right.image)
    np.testing.assert_array_equal(read_disparity(found / "two.pfm"), expected)
    assert read_disparity(found / "one.pfm").shape == (40, 96)
    done = predict("--multiple", "7")
    assert done.exit_code == 0, done.output
    padded = replace(FORM, multiple_px=7).predict(network, frame.left.image, frame.right.image)
    np.testing.assert_array_equal(read_disparity(found / "two.pfm"), padded)
    assert (padded != expected).any()
    flipped = FORM.predict(network, frame.right.image[:, ::-1], frame.left.image[:, ::-1])[:, ::-1]
    np.testing.assert_array_equal(read_disparity(tmp_path / "right" / "two.pfm"), flipped)
    for options, words in (
        ({"left": "one/im0.png"}, "expected as many images of each, got 1 and 2"),
        ({"left": "absent"}, "no image matches"),
    ):
        done = predict(**options)
        assert (done.exit_code, words in done.output) == (2, True), done.output
    torch.save(network.state_dict(), weights)
    assert "expected weights.pt of train_network.py" in predict().output


@pytest.mark.parametrize("model", ["raft-stereo-realtime", "igev-stereo"])
def test_networks_of_the_package_can_be_trained(model):
    for package in ("stereo_matching", *(["torchvision"] if model == "igev-stereo" else [])):
        pytest.importorskip(package, reason="needs pip install stereo-matching timm")
    from public_networks import stereo_matching

    training = training_of(stereo_matching(model, num_iters=2), loss="sequence")
    # Narrower images vanish in the pyramids of their correlations.
    assert np.isfinite(training.learn(batch_of(size=(64, 160))))
    left = np.zeros((64, 160, 3), np.uint8)
    assert training.form.predict(training.network, left, left).shape == (64, 160)
    with pytest.raises(InputError, match=r"fog: .* has the settings"):
        stereo_matching(model, fog=1)
    with pytest.raises(InputError, match=r"model: expected one of .*raft-stereo.*, got 'absent'"):
        stereo_matching("absent")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ("--data", "out/absent"),
            "--data out/absent: there is neither a file nor a folder {here}/out/absent, nor a packaged",
        ),
        (("--data", "absent.yaml=2"), "--data absent.yaml: there is neither"),
        (("--data", "absent"), "expected a dataset's folder, or a config: a YAML file, or one of: ablation-"),
        (("--data", "kiti"), "that name; did you mean kitti? expected a dataset"),
        (("--data", "kitti.yaml", "--set", "camera.x=1"), "Error: override camera.x: unknown key; expected one of: "),
        (("--set", "camera.width_px=wide"), "Error: override camera.width_px: input should be"),
        (("--set", "camera"), "Error: override camera: expected dotted.key=value"),
        (("--evaluate", "absent"), "Error: --evaluate: absent: there is no such folder"),
        (("--resume",), "there is no out/stereo-network/checkpoint.pt: leave --resume out to begin"),
        (("--pretrained", "absent.pth"), "absent.pth: expected tensors in a file of torch.save"),
        (("--loss", "sequence", "--augment", "fog"), "--augment fog: expected raft-stereo"),
    ],
)
@pytest.mark.usefixtures("small_motorcycle")
def test_what_cannot_be_followed_is_refused(arguments, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = run(*arguments, "--steps", "1", "--device", "cpu")
    assert done.exit_code == 2
    assert words.format(here=tmp_path) in done.output


def test_numbers_have_bounds_within_which_seeds_fit():
    types = {option.name: option.type for option in train_network.main.params}
    ranges = {name: kind for name, kind in types.items() if isinstance(kind, click.IntRange | click.FloatRange)}
    assert {"seed", "steps", "learning_rate", "multiple"} <= ranges.keys()
    for name, kind in ranges.items():
        assert kind.max is not None, name
        for wrong in (kind.max * 2, "nan"):
            with pytest.raises(click.BadParameter):
                kind.convert(wrong, None, None)
    seed, steps = ranges["seed"].max, ranges["steps"].max
    training = training_of(Shift(), seed=seed, steps=steps, loss="smooth-l1")
    training.step = steps - 1
    training.learn(batch_of())


@pytest.mark.usefixtures("small_motorcycle")
def test_crops_larger_than_the_pairs_are_refused(dataset, tmp_path):
    done = run("--data", dataset, "--steps", "1", "--crop", "80", "64", "--out", tmp_path)
    assert done.exit_code == 2
    assert (
        f"crop: expected (height, width), whole numbers of up to (64, 96) px, the image size of {dataset}"
        in done.output
    )


@pytest.mark.usefixtures("small_motorcycle")
@pytest.mark.parametrize("workers", [0, 1])
def test_changes_that_pairs_do_not_allow_are_refused_in_a_sentence(workers, dataset, tmp_path):
    own = tmp_path / "own.yaml"
    options = (
        *CROP,
        "--data",
        dataset,
        "--steps",
        "1",
        "--augment",
        own,
        "--workers",
        workers,
        "--out",
        tmp_path / "out",
    )
    for text, words in (
        ("mirrored: 1", "mirrored: expected truth of both views, got the left one's: set truth: both, or leave it out"),
        ("scale: [0.1, 0.2]", "scale: expected at least 0.7"),
    ):
        own.write_text(text)
        done = run(*options)
        assert done.exit_code == 2
        [error] = [line for line in done.output.splitlines() if line.startswith("Error: ")]
        assert error.startswith(f"Error: --augment {own}: {words}")
        assert "Traceback" not in done.output
    shutil.copytree(dataset, tmp_path / "broken")
    [*images] = (tmp_path / "broken").rglob("im0.png")
    for image in images[1:]:
        image.write_bytes(image.read_bytes()[:100])
    done = run(*CROP, "--data", tmp_path / "broken", "--steps", "3", "--workers", workers, "--out", tmp_path / "out")
    assert (done.exit_code, "im0.png: " in done.output, "Traceback" in done.output) == (2, True, False), done.output


def test_cuda_is_refused_where_there_is_none(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(InputError, match="finds no CUDA"):
        find_device("cuda")
    assert find_device("auto").type == find_device("cpu").type == "cpu"
    assert join_processes(torch.device("cpu")) == (0, 1)
