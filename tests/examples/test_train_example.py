"""The example that trains: its network, its loss, and the whole command on a dataset of a few small pairs."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from backends import backend_fault
from heavy import heavy

torch = heavy("torch")
pytestmark = pytest.mark.heavy
ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "examples" / "small-rooms.yaml"
sys.path.insert(0, str(ROOT / "examples"))

import stereo_evaluation as evaluation  # noqa: E402 - found by the line above
import train_stereo  # noqa: E402
from click.testing import CliRunner  # noqa: E402
from PIL import Image  # noqa: E402
from stereo_network import Estimates, StereoNetwork, correlated, disparity_loss, warped  # noqa: E402

from semisynth_gl.codecs.pfm import PFM  # noqa: E402
from semisynth_gl.config import load_config  # noqa: E402
from semisynth_gl.dataset.reader import open_dataset  # noqa: E402
from semisynth_gl.generation.generate import generate  # noqa: E402
from semisynth_gl.inputs.errors import InputError  # noqa: E402
from semisynth_gl.metrics.truth import Truth  # noqa: E402

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
def _one_thread():
    """Threads that wait for each other are slow where tests of other processes run too."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


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
    return CliRunner().invoke(train_stereo.main, [str(argument) for argument in arguments])


# --- what the documentation says ---


def test_the_documented_figures_are_those_of_the_measured_run():
    text = (ROOT / "docs" / "training.md").read_text()
    report = json.loads((ROOT / "benchmarks" / "results" / "training.json").read_text())
    [motorcycle] = report["results"]
    rows = motorcycle["figures"]
    trained, untrained, constant = rows["trained"], rows["untrained"], rows["constant, each truth's own median"]
    documented = (
        f"an average error of {trained['avgerr']:.2f} px; {trained['bad-2']:.1f} % of the pixels are off by more "
        f"than 2 px. Untrained it has {untrained['avgerr']:.2f} px and {untrained['bad-2']:.1f} %, and a constant "
        f"disparity, the truth's own median, {constant['avgerr']:.2f} px and {constant['bad-2']:.1f} %"
    )
    assert documented in " ".join(text.split())
    assert rows["trained"]["avgerr"] < 0.6 * min(row["avgerr"] for name, row in rows.items() if name != "trained")
    assert all(row["bad-2"] > 1.5 * rows["trained"]["bad-2"] for name, row in rows.items() if name != "trained")


# --- the network ---


def test_it_is_as_large_as_documented(network):
    parameters = sum(each.numel() for each in network.parameters())
    assert 400_000 < parameters < 600_000
    assert f"{parameters:,} parameters" in (ROOT / "docs" / "training.md").read_text()


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


# --- the loss ---


@pytest.mark.parametrize("invalid", [torch.inf, torch.nan, 0.0, 32.0, 500.0])
def test_pixels_without_a_usable_truth_do_not_count(network, invalid):
    truth = torch.full((1, 16, 32), 8.0)
    truth[:, :, 20:] = invalid
    estimates = network(noise(1, 3, 16, 32), noise(1, 3, 16, 32, seed=1))
    loss = disparity_loss(estimates, truth, 32)
    loss.backward()
    assert all(torch.isfinite(each.grad).all() for each in network.parameters() if each.grad is not None)
    changed = [each.clone() for each in estimates.disparities]
    for each in changed:
        each[:, :, 20:] += 100
    assert disparity_loss(Estimates(changed, estimates.scores), truth, 32) == loss
    for each in changed:
        each[:, :, :20] += 100
    assert disparity_loss(Estimates(changed, estimates.scores), truth, 32) > loss + 100


def test_without_any_truth_the_loss_is_0(network):
    estimates = network(noise(1, 3, 16, 32), noise(1, 3, 16, 32, seed=1))
    assert disparity_loss(estimates, torch.full((1, 16, 32), torch.inf), 32) == 0


def test_scores_of_the_true_level_cost_least():
    truth = torch.full((1, 8, 8), 10.0)  # between the levels 2 and 3
    disparities = [truth] * 3
    losses = []
    for levels in ([2, 3], [2], [6]):
        scores = torch.full((1, 8, 2, 2), -9.0)
        scores[:, levels] = 9.0
        losses.append(disparity_loss(Estimates(disparities, scores), truth, 32).item())
    assert losses == sorted(losses)
    assert losses[0] == pytest.approx(np.log(2), abs=1e-3)


# --- training ---


def crops_of(folder, crop, steps, batch=1):
    """What is trained on, of a dataset."""
    return train_stereo.open_source(str(folder), str(CONFIG), (), crop, steps, batch, seed=3)


def test_crops_agree_with_the_pairs_and_repeat(dataset):
    crops = list(crops_of(dataset, (32, 48), 7))
    again = list(crops_of(dataset, (32, 48), 7))
    assert len(crops) == 7
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


def test_views_are_photographed_apart():
    images = torch.full((2, 3, 8, 8), 128, dtype=torch.uint8)
    seen = train_stereo.photographed(images, torch.Generator().manual_seed(0))
    assert seen.shape == images.shape
    assert (seen[0] - seen[1]).abs().mean() > 0.01
    assert torch.equal(seen, train_stereo.photographed(images, torch.Generator().manual_seed(0)))


def test_a_few_steps_reduce_the_loss(dataset, network):
    done = train_stereo.train(
        network,
        train_stereo.batches_of(crops_of(dataset, (48, 64), 20, 2), 2, 0),
        steps=20,
        max_disparity=32,
        device=torch.device("cpu"),
        tell=lambda _: None,
    )
    assert np.mean(done.losses[-5:]) < 0.8 * np.mean(done.losses[:5])
    assert 4 < done.truths.histogram.quantile(0.5) < 30


@pytest.mark.parametrize("steps", [1, 2, 3, 20])
def test_any_number_of_steps_can_be_scheduled(steps):
    class Shift(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.shift = torch.nn.Parameter(torch.zeros(()))

        def forward(self, left, right):
            found = (left - right).mean(1) + self.shift
            return Estimates([found] * 3, found.new_zeros(len(found), 2, 2, 2) + self.shift)

    sample = {name: torch.zeros(1, 3, 8, 8, dtype=torch.uint8) for name in ("left", "right")}
    batches = iter([sample | {"disparity_left": torch.full((1, 8, 8), 5.0)}] * steps)
    network = Shift()
    done = train_stereo.train(network, batches, steps=steps, max_disparity=8, device=torch.device("cpu"))
    assert len(done.losses) == steps
    assert network.shift > 0


def test_pairs_that_end_early_are_told(network):
    with pytest.raises(InputError, match="ended after 0 of 2 steps"):
        train_stereo.train(network, iter([]), steps=2, max_disparity=32, device=torch.device("cpu"))


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


def test_the_command_trains_and_reports(dataset, tmp_path, monkeypatch):
    # Motorcycle at a fifth of its size, which is faster.
    whole = evaluation.motorcycle().views["Motorcycle"]()
    small = evaluation.View(
        whole.left[::5, ::5], whole.right[::5, ::5], Truth(np.ascontiguousarray(whole.truth.disparity[::5, ::5] / 5))
    )
    monkeypatch.setattr(
        evaluation, "motorcycle", lambda: evaluation.Judges("Motorcycle", "middlebury", {"Motorcycle": lambda: small})
    )
    picture = tmp_path / "picture.png"
    done = run(
        "--data", dataset, "--steps", "2", *CROP, "--evaluate", dataset, "--picture", picture, "--out", tmp_path / "out"
    )
    assert done.exit_code == 0, done.output
    assert "step 2 of 2" in done.output
    assert "| trained " in done.output
    report = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert [each["on"] for each in report["results"]] == ["Motorcycle", str(dataset)]
    for each in report["results"]:
        assert len(each["figures"]) == 4
        assert all(set(row) == set(evaluation.COLUMNS) for row in each["figures"].values())
    assert len(report["losses"]) == 2
    with Image.open(picture) as drawn:
        assert drawn.width > 800
    saved = torch.load(tmp_path / "out" / "weights.pt")
    StereoNetwork(saved["max_disparity"]).load_state_dict(saved["network"])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--data", "absent"), "there is no such folder"),
        (("--data", "absent", "--set", "camera.width_px=64"), "--config and --set are the stream's"),
        (("--config", "absent.yaml"), "absent.yaml"),
        (("--evaluate", "absent"), "there is no such folder"),
        (("--picture", "absent/picture.png"), "absent does not exist"),
    ],
)
def test_what_cannot_be_followed_is_refused(arguments, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = run(*arguments, "--steps", "1")
    assert done.exit_code == 2
    assert words in done.output


def test_crops_larger_than_the_pairs_are_refused(dataset):
    done = run("--data", dataset, "--steps", "1", "--crop", "80", "64")
    assert done.exit_code == 2
    assert (
        f"crop: expected (height, width), whole numbers of up to (64, 96) px, the image size of {dataset}"
        in done.output
    )


def test_cuda_is_refused_where_there_is_none(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(InputError, match="finds no CUDA"):
        train_stereo.find_device("cuda")
    assert train_stereo.find_device("auto").type == "cpu"


def test_the_stream_can_be_trained_on():
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    source = train_stereo.open_source("stream", str(CONFIG), tuple(SMALL), (48, 64), steps=2, batch=2, seed=0)
    batches = list(train_stereo.batches_of(source, 2, 0))
    assert [set(batch) for batch in batches] == [{"left", "right", "disparity_left"}] * 2
    assert batches[0]["left"].shape == (2, 3, 48, 64)
    assert batches[0]["disparity_left"].shape == (2, 48, 64)
