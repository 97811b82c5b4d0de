"""The examples train.py and predict.py: network, losses, order of samples, and both commands."""

import hashlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from heavy import heavy
from PIL import Image
from snippets import blocks

torch = heavy("torch")
for package in ("lightning", "tensorboard"):
    heavy(package)
pytestmark = pytest.mark.heavy
ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "examples"))

import judged_pairs  # noqa: E402 - found by the line above
import predict  # noqa: E402
import train  # noqa: E402
from stereo_network import StereoNetwork, correlated, warped  # noqa: E402

from semisynth_gl.codecs.pfm import PFM  # noqa: E402
from semisynth_gl.config import load_config  # noqa: E402
from semisynth_gl.dataset.generate import generate  # noqa: E402
from semisynth_gl.dataset.reader import open_dataset  # noqa: E402
from semisynth_gl.inputs.errors import InputError  # noqa: E402
from semisynth_gl.judge.protocol import Truth  # noqa: E402
from semisynth_gl.torch import Augmentation  # noqa: E402

SMALL = (
    "camera.width_px=96 camera.height_px=64 camera.focal_px=100 disparity.max_px=30 particles.size_px=[10,40] "
    "models.complex=0 textures.source=procedural textures.max_patches=16"
)
CROP = ("--crop", 48, 64, "--max-disparity", 32, "--batch", 2, "--workers", 0)
LEARNT = ("--network", "their_networks:Learnt", "--loss", "sequence")
NETWORKS = """
import hashlib, os, time
from pathlib import Path
import torch


class Learnt(torch.nn.Module):
    # Learns one number, beside layers that training and evaluation run differently.
    def __init__(self, start=3.0):
        super().__init__()
        self.number = torch.nn.Parameter(torch.tensor(start))
        self.norm, self.dropout = torch.nn.BatchNorm2d(6), torch.nn.Dropout(0.5)

    def forward(self, left, right):
        if not self.training:
            return self.number.expand(left[:, 0].shape)
        if "SEEN" in os.environ:
            seen = Path(os.environ["SEEN"] + os.environ.get("LOCAL_RANK", "0"))
            with seen.open("a") as lines:
                lines.writelines(hashlib.sha256(each.numpy().tobytes()).hexdigest() + "\\n" for each in left)
            if len(seen.read_text().split()) > int(os.environ.get("HANGS_AFTER", 1000)):
                seen.with_suffix(".hangs").touch()
                time.sleep(600)
        return self.number + self.dropout(self.norm(torch.cat([left, right], 1))).mean(1)


class Seen(torch.nn.Module):
    def forward(self, left, right):
        self.asked = left, right
        return left[:, :1]
"""


@pytest.fixture(scope="module", autouse=True)
def _alone(one_thread, tmp_path_factory):
    """Use one thread and no GPU, here and in child processes; all can import the networks above."""
    folder = tmp_path_factory.mktemp("networks")
    (folder / "their_networks.py").write_text(NETWORKS)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        patch.setenv("PYTHONPATH", f"{ROOT}{os.pathsep}{folder}")
        patch.setenv("OMP_NUM_THREADS", "1")
        patch.setenv("CUDA_VISIBLE_DEVICES", "")
        patch.setattr(torch.cuda, "device_count", lambda: 0)
        yield one_thread


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("train") / "pairs"
    generate(load_config(ROOT / "examples" / "small-rooms.yaml", SMALL.split()), folder, 6, 0)
    return folder


@pytest.fixture(scope="module", autouse=True)
def _small_motorcycle():
    """Shrink Motorcycle to a fifth, to be fast."""
    pair = judged_pairs.motorcycle()[0]
    images = [pair[eye].numpy().transpose(1, 2, 0)[::5, ::5] for eye in ("left", "right")]
    truth = Truth(np.ascontiguousarray(pair["truth"].disparity[::5, ::5] / 5))
    small = judged_pairs.JudgedPairs("Motorcycle", "middlebury", [("Motorcycle", lambda: images, lambda: truth)])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(train, "motorcycle", lambda: small)
        yield


def noise(*shape, seed=0):
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


DEFAULTS = {"levels": "unit", "loss": "smooth-l1", "learning_rate": 2e-3, "steps": 1, "seed": 0}


def module_of(network, *arguments, **options):
    return train.StereoModule(network, arguments, 32, **DEFAULTS | options)


def run(*arguments, command=train.main):
    return CliRunner().invoke(command, [str(each) for each in arguments])


def checked(done):
    assert done.exit_code == 0, done.output
    return done.output


def fails(done, words):
    """Tell whether a command ended with an error message with these words, without a traceback."""
    said = done.output.rpartition("Error: ")[2]
    return (done.exit_code, words in said, "Traceback" in done.output) == (2, True, False)


def started(*arguments, **environment):
    """Start the training in a new process."""
    words = [sys.executable, train.__file__, *map(str, arguments)]
    return subprocess.Popen(words, env=os.environ | environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)


def checkpoint_of(folder):
    return torch.load(folder / "checkpoint.ckpt", weights_only=True)


# --- documentation ---


def test_the_documented_network_learns_by_the_documented_command(dataset, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    [written] = [block for block in blocks("training") if "def make(" in block.text]
    Path("my_network.py").write_text(written.text)
    [command] = [words for each in blocks("training") for words in each.commands if "my_network:make" in words]
    given = [str(dataset) if word == "lab.yaml" else word for word in command[2:]]
    output = checked(run(*given, *CROP, "--steps", 60, "--evaluate", dataset, "--out", "out"))
    before, after = (float(line.split()[-2]) for line in output.splitlines() if f"{dataset}: avgerr" in line)
    assert after < 0.8 * before
    assert sorted(each.name for each in Path("out").iterdir()) == ["checkpoint.ckpt", "logs"]
    assert [*Path("out/logs").rglob("events.out.tfevents.*")]


# --- the network and its losses ---


@pytest.mark.parametrize("size", [(48, 64), (37, 51)])
def test_images_of_any_size_give_disparities_of_that_size(size):
    with torch.inference_mode():
        found = StereoNetwork(32)(noise(1, 3, *size), noise(1, 3, *size, seed=1))
    assert [each.shape for each in found.disparities] == [(1, *size)] * 3
    assert all(torch.isfinite(each).all() and (each >= 0).all() for each in found.disparities)


def test_the_cost_volume_finds_a_shift_and_warping_undoes_it():
    left = noise(1, 16, 3, 20) - 0.5
    right = torch.roll(left, -4, dims=-1)
    volume = correlated((left, right), levels=8, groups=4)
    assert volume.shape == (1, 4, 8, 3, 20)
    assert (volume.mean(1).argmax(1)[..., 4:] == 4).all()
    assert (volume[:, :, 5, :, :5] == 0).all()
    assert torch.allclose(warped(right, torch.full((1, 3, 20), 4.0))[..., 4:], left[..., 4:], atol=1e-5)


@pytest.mark.filterwarnings("ignore:You are trying to `self.log")
@pytest.mark.parametrize("loss", train.LOSSES)
@pytest.mark.parametrize("invalid", [torch.inf, 0.0, 32.0])
def test_pixels_without_a_usable_truth_do_not_count(loss, invalid):
    module = module_of("stereo_network:StereoNetwork", loss=loss)
    found = module(255 * noise(1, 3, 16, 32), 255 * noise(1, 3, 16, 32, seed=1))
    module.forward = lambda *_: found

    def loss_of(truth, columns=slice(0)):
        for each in found.disparities:
            each.data[:, :, columns] += 100
        return module.training_step({"left": truth, "right": truth, "disparity_left": truth}, 0)

    truth = torch.full((1, 16, 32), 8.0)
    truth[:, :, 20:] = invalid
    first = loss_of(truth)
    first.backward(retain_graph=True)
    assert all(torch.isfinite(each.grad).all() for each in module.parameters() if each.grad is not None)
    assert loss_of(truth, slice(20, None)) == first
    assert loss_of(truth, slice(20)) > first + 90
    assert loss_of(torch.full((1, 16, 32), torch.inf)) == 0


def test_estimates_weigh_as_their_authors_have_it():
    truth = torch.full((1, 4, 4), 10.0)

    def of(loss, *errors):
        return train.loss_of(loss, [truth + error for error in errors], truth, truth > 0).item()

    # In RAFT-Stereo, the first of n estimates has the weight 0.9 ** 15 for any n.
    for count in (2, 5, 16):
        assert of("sequence", 4, *[0] * (count - 1)) == pytest.approx(4 * 0.9**15, rel=1e-5)
    assert of("sequence", 4) == of("sequence", 0, 4) == 4
    for errors, weight in (((4, 0, 0, 0), 0.5), ((4, 0, 0), 0.5), ((0, 4, 0), 0.7), ((0, 0, 4), 1), ((4,), 1)):
        assert of("smooth-l1", *errors) == pytest.approx(weight * 3.5)


def test_levels_and_padding_are_those_that_networks_take():
    for levels, expected in (("unit", [1] * 3), ("byte", [255] * 3), ("imagenet", [2.2489, 2.4286, 2.6400])):
        for channels in (3, 1):  # 1: grey camera
            module = module_of("their_networks:Seen", levels=levels)
            module.predict_disparity(*torch.full((2, channels, 2, 2), 255, dtype=torch.uint8))
            assert module.network.asked[0][0, :, 0, 0].tolist() == pytest.approx(expected, abs=1e-4)
    left, right = (255 * noise(2, 3, 9, 35)).byte()
    module = module_of("their_networks:Seen", levels="byte")
    assert torch.equal(module.predict_disparity(left, right), left[0].float())
    assert module.network.asked[1].shape == (1, 3, 32, 64)


@pytest.mark.parametrize("steps", [1, 2, 30])
def test_the_learning_rate_falls_to_nothing_in_any_number_of_steps(steps):
    found = module_of("their_networks:Learnt", steps=steps).configure_optimizers()
    for _ in range(steps - 1):
        found["optimizer"].step()
        found["lr_scheduler"]["scheduler"].step()
    assert 0 <= found["optimizer"].param_groups[0]["lr"] < 1e-4


# --- data ---


class Part(list):
    def set_epoch(self, epoch):
        self.epoch = epoch


def order(*sizes_and_shares, step=0, rank=0, world=1, seed=0):
    """Return the pair numbers from a step to the epoch's end, and the epoch that each source is set to."""
    sources = [(Part(range(size)), share) for size, share in sizes_and_shares]
    trainer = SimpleNamespace(global_step=step, global_rank=rank, world_size=world)
    return [*train.TrainingOrder(sources, 2, seed, trainer)], [part.epoch for part, _ in sources]


def test_the_step_decides_which_pairs_are_taken():
    first, second = (order((12, 1.0), step=6 * epoch) for epoch in range(2))
    assert (sorted(first[0]), first[1]) == (sorted(second[0]), [0]) == ([*range(12)], [0])
    assert (first[0] != second[0], second[1]) == (True, [1])
    assert order((12, 1.0), seed=5)[0] not in (first[0], second[0])
    assert order((12, 1.0), step=8) == (second[0][4:], [1])
    # Three devices take different pairs; the order drops the thirteenth.
    numbers = [number for rank in range(3) for number in order((13, 1.0), step=4, rank=rank, world=3)[0]]
    assert len({*numbers}) == len(numbers) == 12
    assert [len(order((13, 1.0), step=5, rank=rank, world=3)[0]) for rank in range(3)] == [2, 2, 2]


def test_two_sources_come_in_their_shares():
    numbers, told = order((600, 3.0), (1000, 1.0), step=400)
    assert (len(numbers), told) == (800, [1, 1])
    assert 0.7 < np.mean(np.array(numbers) < 600) < 0.8


def test_augmentations_are_read(tmp_path):
    own = tmp_path / "own.yaml"
    own.write_text("noise: [0, 3]\nmirrored: 0.5\n")
    assert train.read_augmentation(str(own)) == Augmentation(noise=(0, 3), mirrored=0.5)
    for text, words in (
        ("mirorred: 0.5", "unexpected keyword argument 'mirorred'"),
        ("occluded: 2", "occluded: must be from 0 to 1"),
    ):
        own.write_text(text)
        with pytest.raises(InputError, match=f"--augment .*: expected raft-stereo, .*{words}"):
            train.read_augmentation(str(own))


# --- weights ---


def test_weights_are_found_in_files_of_other_trainings(tmp_path):
    path, state = tmp_path / "weights.pth", module_of("their_networks:Learnt", "start=5.0").network.state_dict()
    for prefix, key in (("", None), ("module.", None), ("network.", "state_dict"), ("module.", "model")):
        named = {prefix + name: each for name, each in state.items()}
        torch.save({key: named} if key else named, path)
        network = module_of("their_networks:Learnt").network
        train.load_weights(network, path)
        assert network.number == 5
    for wrong in ({**state, "more": state["number"]}, {**state, "number": torch.zeros(4)}, {}):
        torch.save(wrong, path)
        with pytest.raises(InputError, match=r"weights\.pth: expected weights of this .*(more|number)"):
            train.load_weights(network, path)


class Evil:
    def __reduce__(self):
        return os.mkdir, (self.path,)


def test_code_in_a_checkpoint_is_not_run(dataset, tmp_path):
    path, Evil.path = tmp_path / "evil.ckpt", str(tmp_path / "evil")
    torch.save({"state_dict": Evil(), "hyper_parameters": {"network": Evil()}}, path)
    images = ("--left", dataset, "--right", dataset, "--out", tmp_path / "out")
    trained = run(*LEARNT, *CROP, "--data", dataset, "--pretrained", path, "--out", tmp_path / "out")
    assert fails(trained, "evil.ckpt: expected weights of this network, and no code")
    assert fails(run(path, *images, command=predict.main), "evil.ckpt: expected a checkpoint of train.py")
    assert not Path(Evil.path).exists()


# --- the command ---


def scene(folder, image=(6, 8)):
    folder.mkdir(parents=True)
    (folder / "disp0GT.pfm").write_bytes(PFM.encode(np.full((6, 8), 3, np.float32)))
    for name in ("im0.png", "im1.png"):
        Image.fromarray(np.zeros(image, np.uint8)).save(folder / name)


def test_the_command_trains_judges_tunes_and_resumes(dataset, tmp_path):
    scene(tmp_path / "scenes" / "Vase")
    options = (*LEARNT, *CROP, "--data", dataset, "--every", 2, "--steps", 3)
    options += ("--evaluate", tmp_path / "scenes", "--evaluate", dataset, "--out")
    output = checked(run(*options, tmp_path / "out", "--learning-rate", 0))
    # The network predicts 3 px everywhere, the truth of the scene.
    assert all(f"step {step}: {tmp_path / 'scenes'}: avgerr 0.00 px" in output for step in (0, 2, 3))
    truths = [frame.left.disparity for frame in open_dataset(dataset)]
    mean = np.mean([np.abs(truth[np.isfinite(truth)] - 3).mean() for truth in truths])
    assert f"step 0: {dataset}: avgerr {mean:.2f} px" in output
    tuned = tmp_path / "tuned"
    checked(run(*options, tuned, "--pretrained", tmp_path / "out" / "checkpoint.ckpt"))
    assert checkpoint_of(tuned)["state_dict"]["network.number"] != 3
    assert fails(run(*options, tuned), "checkpoint.ckpt: exists: add --resume")
    checked(run(*options, tuned, "--resume"))
    assert checkpoint_of(tuned)["global_step"] == 3


def test_a_killed_training_goes_on_as_if_nothing_had_happened(dataset, tmp_path, monkeypatch):
    # 8 steps in epochs of 3 steps, with one worker.
    options, every = (*LEARNT, *CROP, "--data", dataset, "--steps", 8, "--workers", 1), 4
    monkeypatch.setenv("SEEN", str(tmp_path / "undisturbed"))
    checked(run(*options, "--every", 8, "--out", tmp_path / "whole"))
    seen, whole = (tmp_path / "undisturbed0").read_text().split(), checkpoint_of(tmp_path / "whole")
    assert len({*seen}) == 16  # each epoch samples other crops and augmentations
    options += ("--every", every, "--out", tmp_path / "out")
    with started(*options, SEEN=str(tmp_path / "killed"), HANGS_AFTER="10") as begun:
        while begun.poll() is None and not (tmp_path / "killed0.hangs").exists():
            time.sleep(0.02)
        begun.send_signal(signal.SIGKILL)
    assert (begun.returncode, checkpoint_of(tmp_path / "out")["global_step"]) == (-signal.SIGKILL, every)
    monkeypatch.setenv("SEEN", str(tmp_path / "resumed"))
    checked(run(*options, "--resume"))
    # The resumed training takes the remaining samples, and ends with the same state bit for bit.
    assert (tmp_path / "resumed0").read_text().split() == seen[2 * every :]
    resumed = checkpoint_of(tmp_path / "out")
    assert resumed["global_step"] == whole["global_step"] == 8
    assert resumed["lr_schedulers"] == whole["lr_schedulers"]
    assert all(torch.equal(value, resumed["state_dict"][name]) for name, value in whole["state_dict"].items())


def test_two_devices_share_the_samples_of_an_epoch(dataset, tmp_path):
    whole = ("--crop", 64, 96, "--augment", "psmnet", "--batch", 1, "--workers", 0, "--devices", 2, "--steps", 6)
    with started(*LEARNT, *whole, "--data", dataset, "--out", tmp_path, SEEN=str(tmp_path / "seen")) as begun:
        output = begun.communicate()[0].decode()
    assert begun.returncode == 0, output
    assert output.count("step 6: Motorcycle: avgerr") == output.count("weights are in") == 1
    first, second = ((tmp_path / f"seen{rank}").read_text().split() for rank in range(2))
    images = [torch.tensor(np.moveaxis(frame.left.image, -1, 0)) / 255 for frame in open_dataset(dataset)]
    known = sorted(hashlib.sha256(image.numpy().tobytes()).hexdigest() for image in images)
    assert sorted(first[:3] + second[:3]) == sorted(first[3:] + second[3:]) == known


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--data", "absent"), "no such config: absent; expected a YAML file, or one of: ablation-"),
        (("--batch", 7), "--data: 6 pairs are fewer than --batch 7 for each device"),
        (("--crop", 80, 64), "crop: must be from 1 to 64, got 80"),
        (("--network", "absent:Network"), "--network absent:Network: expected module:callable and its --arguments: No"),
        (("--argument", "start=.nan"), "step 0: the loss is nan: lower --learning-rate"),
        (("--loss", "cross-entropy"), "the network gives no scores: use --loss smooth-l1 or sequence"),
        (("--resume",), "checkpoint.ckpt: expected with --resume"),
    ],
)
def test_what_cannot_be_followed_is_refused_in_a_sentence(arguments, words, dataset, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data = () if "--data" in arguments else ("--data", dataset)
    done = run(*LEARNT, *CROP, "--steps", 1, *data, *arguments)
    assert fails(done, words), done.output


# --- real pairs ---


def test_scenes_that_cannot_be_judged_are_refused(tmp_path):
    scene(tmp_path / "sizes" / "Vase", image=(6, 9))
    with pytest.raises(InputError, match="Vase: expected images and truth of one size"):
        judged_pairs.folder(tmp_path / "sizes")[0]
    (tmp_path / "sizes" / "Vase" / "im1.png").unlink()
    with pytest.raises(InputError, match=r"expected im0\.png and im1\.png"):
        judged_pairs.folder(tmp_path / "sizes")[0]


def test_motorcycle_is_as_documented():
    [pair] = judged_pairs.motorcycle()
    left, right = (pair[eye].numpy().transpose(1, 2, 0).astype(float) for eye in ("left", "right"))
    assert left.shape == right.shape == (500, 741, 3)
    y, x = np.nonzero(np.isfinite(pair["truth"].disparity))
    disparity = pair["truth"].disparity[y, x]
    assert 7 < disparity.min() < disparity.max() < 60
    # Left pixels resemble the right pixels that the left view's disparity points to.
    assert np.abs(left[y, x] - right[y, np.clip(np.rint(x - disparity).astype(int), 0, 740)]).mean() < 10


# --- predictions ---


def test_the_trained_network_predicts_pairs(dataset, tmp_path):
    checked(run(*CROP, "--data", dataset, "--steps", 1, "--out", tmp_path))
    weights, scenes, found = tmp_path / "checkpoint.ckpt", tmp_path / "scenes", tmp_path / "found"
    frame = open_dataset(dataset)[0]
    for name, rows in (("one", 40), ("two", 64)):
        (scenes / name).mkdir(parents=True)
        for eye, view in (("im0", frame.left), ("im1", frame.right)):
            Image.fromarray(view.image[:rows]).save(scenes / name / f"{eye}.png")

    def predicted(*options, left="*/im0.png"):
        given = ("--left", scenes / left, "--right", scenes / "*/im1.png", "--out", found, "--device", "cpu", *options)
        return run(weights, *given, command=predict.main)

    checked(predicted("--right-out", tmp_path / "right"))
    module = predict.load(weights, "stereo_network:StereoNetwork")
    left, right = (torch.tensor(view.image).permute(2, 0, 1) for view in (frame.left, frame.right))
    with torch.inference_mode():
        expected = module.predict_disparity(left, right)
        mirrored = module.predict_disparity(right.flip(-1), left.flip(-1)).flip(-1)
    for folder, disparity in ((found, expected), (tmp_path / "right", mirrored)):
        np.testing.assert_array_equal(PFM.decode((folder / "two.pfm").read_bytes(), folder), disparity)
    assert PFM.decode((found / "one.pfm").read_bytes(), found).shape == (40, 96)
    Image.fromarray(frame.left.image[:50]).save(scenes / "two" / "im0.png")
    assert fails(predicted(), "two/im1.png: has (64, 96) px, ")
    assert fails(predicted(left="one/im0.png"), "expected as many images of each, got 1 and 2")
    assert fails(predicted(left="absent"), "no image matches")
    assert fails(predicted("--network", "their_networks:Learnt"), "of train.py with --network their_networks:Learnt")
    torch.save(module.network.state_dict(), weights)
    assert fails(predicted(), "expected a checkpoint of train.py")
