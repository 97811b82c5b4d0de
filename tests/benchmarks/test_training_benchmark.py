"""The benchmark of training sets: its network, its crops, and the whole command with a few steps on a few pairs."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from backends import backend_fault
from heavy import heavy

torch = heavy("torch")
pytestmark = pytest.mark.heavy
ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "benchmarks" / "training"))

import compare_sets  # noqa: E402 - found by the line above
import matching_network  # noqa: E402
import trainer  # noqa: E402
import training_sets  # noqa: E402
from click.testing import CliRunner  # noqa: E402
from matching_network import MatchingNetwork, likenesses, local_level, matching_loss  # noqa: E402
from stereo_network import correlated  # noqa: E402

from semisynth_gl.augmentation import Augmentation  # noqa: E402
from semisynth_gl.inputs.errors import InputError  # noqa: E402

CPU = trainer.Hardware(torch.device("cpu"), torch.float32)
UNCHANGED = Augmentation()
BUDGET = replace(compare_sets.BUDGETS["cpu"], steps=20, crop_px=(32, 64))


@pytest.fixture(scope="module", autouse=True)
def _quiet(one_thread):
    return one_thread


def noise(*shape, seed=0):
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


# --- the network ---


@pytest.mark.parametrize("size", [(32, 64), (37, 51), (8, 130)])
def test_images_of_any_size_give_disparities_of_that_size(size):
    with torch.inference_mode():
        matched = MatchingNetwork(40)(noise(1, 3, *size), noise(1, 3, *size, seed=1))
    few = tuple(-(-side // 4) for side in size)
    assert (matched.final.shape, matched.near.shape) == ((1, *size), (1, *few))
    assert matched.scores.shape == (1, 20, *few)
    assert torch.isfinite(matched.final).all()


def test_likenesses_are_those_of_shifting_level_by_level():
    left, right = noise(2, 16, 3, 30) - 0.5, noise(2, 16, 3, 30, seed=1) - 0.5
    expected = correlated((left, right), 9, matching_network.GROUPS)[..., ::2]
    assert torch.allclose(likenesses(left, right, 9), expected, atol=1e-4)


def test_the_level_is_the_mean_next_to_the_best():
    scores = torch.full((1, 12, 1, 2), -20.0)
    scores[0, [4, 5], 0, 0] = torch.tensor([1.0, 1.0]).log()
    scores[0, 9, 0, 1] = 0.0
    scores[0, 3, 0, 1] = -0.1  # another surface, which would draw a mean of all to itself
    assert local_level(scores)[0, 0].tolist() == pytest.approx([4.5, 9.0], abs=1e-3)


@pytest.mark.parametrize("invalid", [torch.inf, torch.nan, 0.0, 40.0])
def test_pixels_without_a_usable_truth_do_not_count(invalid):
    network = MatchingNetwork(40)
    matched = network(noise(1, 3, 16, 32), noise(1, 3, 16, 32, seed=1))
    truth = torch.full((1, 16, 32), 8.0)
    truth[:, :, 20:] = invalid
    loss = matching_loss(matched, truth, 40)
    loss.backward()
    assert all(torch.isfinite(each.grad).all() for each in network.parameters() if each.grad is not None)
    beyond, within = matched.final.clone(), matched.final.clone()
    beyond[:, :, 20:] += 100
    within[:, :, :20] += 100
    assert matching_loss(matched._replace(final=beyond), truth, 40) == loss
    assert matching_loss(matched._replace(final=within), truth, 40) > loss


# --- training ---


def pairs(count=2, size=(40, 80), shift=6):
    """Pairs of noise that is shifted by some pixels."""
    made = []
    for seed in range(count):
        wide = (255 * noise(size[0], size[1] + shift, 3, seed=seed)).byte().numpy()
        truth = np.full(size, shift, np.float32)
        made.append(trainer.frame_of(wide[:, : size[1]], wide[:, shift:], truth))
    return made


def crops(budget, seed, augmentation=UNCHANGED):
    return trainer.crops(pairs(), budget, augmentation, seed)


def test_crops_are_the_same_part_of_both_images_and_repeat():
    budget = replace(BUDGET, batch=3, crop_px=(16, 24))
    batch, again = (next(crops(budget, 7)) for _ in range(2))
    assert batch["left"].shape == (3, 3, 16, 24)
    assert all(torch.equal(batch[name], again[name]) for name in batch)
    assert torch.equal(batch["left"][..., 6:], batch["right"][..., :-6])
    changed = next(crops(budget, 7, training_sets.COLOURS))
    assert torch.equal(changed["disparity_left"], batch["disparity_left"])
    assert not torch.equal(changed["left"][..., 6:], changed["right"][..., :-6])
    with pytest.raises(
        InputError, match=r"whole numbers of up to \(40, 80\) px, the image size of a pair, got \(64, 24\)"
    ):
        next(crops(replace(budget, crop_px=(64, 24)), 7))


def test_a_row_says_what_is_changed_in_its_pairs(monkeypatch, tmp_path):
    monkeypatch.setattr(compare_sets.Sources, "pairs", lambda *_: pairs())
    sources = compare_sets.Sources((), tmp_path, {}, 0)
    for row, alike in (("unchanged", True), ("calibrated", False), ("real", False)):
        batch = next(sources.batches(row, BUDGET, 0))
        assert torch.equal(batch["left"][..., 6:], batch["right"][..., :-6]) == alike, row


def test_a_few_steps_reduce_the_loss(monkeypatch):
    monkeypatch.setattr(trainer, "STEPS_SHOWN", 15)
    lines = []
    budget = replace(BUDGET, steps=30, batch=1)
    trainer.train(crops(budget, 0), budget, CPU, 0, tell=lines.append)
    losses = [float(line.partition("loss ")[2].partition(",")[0]) for line in lines]
    assert len(losses) == 2
    assert losses[1] < 0.8 * losses[0]


def test_equal_seeds_give_equal_networks():
    budget = replace(BUDGET, steps=2)
    networks = [trainer.train(crops(budget, seed), budget, CPU, seed, tell=lambda _: None) for seed in (1, 1, 2)]
    first, again, other = (torch.cat([each.flatten() for each in network.parameters()]) for network in networks)
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


# --- the command ---


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """The benchmark's rig with few textures and models."""
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    folder = tmp_path_factory.mktemp("rig")
    path = folder / "rig.yaml"
    few = "textures: {source: procedural, max_patches: 16}\nmodels: {complex: 0, variants: 1}\n"
    path.write_text(f"extends: {training_sets.RIG}\n{few}")
    return path


@pytest.fixture
def command(rig, tmp_path, monkeypatch):
    monkeypatch.setattr(training_sets, "RIG", rig)
    small = replace(compare_sets.BUDGETS["gpu"], steps=1, batch=1, crop_px=(64, 96), width=1)
    monkeypatch.setitem(compare_sets.BUDGETS, "gpu", small)
    out = tmp_path / "report.json"

    def run(*arguments):
        given = ("--device", "cpu", "--data", rig.parent / "data", "--json", out, *arguments)
        done = CliRunner().invoke(compare_sets.main, [str(each) for each in given])
        return done, json.loads(out.read_text()) if out.is_file() else None

    return run


def test_the_command_trains_judges_and_goes_on(command):
    some = ("--set", "real", "--set", "clutter", "--steps", "1", "--pairs", "2")
    done, report = command(*some, "--seeds", "1")
    assert done.exit_code == 0, done.output
    assert "| SGBM" in done.output
    assert [(run["set"], run["seed"]) for run in report["runs"]] == [("real", 0), ("clutter", 0)]
    for run in report["runs"]:
        assert list(run["pairs"]) == ["Motorcycle"]
        assert 0 < run["mean"] <= 100
    assert report["semi_global"]["mean"] < 10
    before = report["runs"]
    done, report = command(*some, "--seeds", "2", "--go-on")
    assert report["runs"][:2] == before
    assert [(run["set"], run["seed"]) for run in report["runs"][2:]] == [("real", 1), ("clutter", 1)]
    done, _ = command("--set", "real", "--steps", "2", "--go-on")
    assert done.exit_code == 2
    assert "--go-on" in done.output


def test_pairs_are_rendered_while_it_trains(command):
    done, report = command("--budget", "gpu", "--set", "clutter", "--set", "few", "--seeds", "1")
    assert done.exit_code == 0, done.output
    assert [run["set"] for run in report["runs"]] == ["clutter"]
    assert report["left_out"] == ["few (is about the number of pairs, and rendering has no such number)"]
    assert report["setup"]["budget"]["pairs"] == 0


def test_what_time_does_not_allow_is_left_out(command):
    done, report = command("--set", "real", "--set", "calibrated", "--minutes", "1e-6", "--seeds", "2")
    assert done.exit_code == 0, done.output
    assert report["runs"] == []
    assert report["left_out"] == [
        "calibrated (needs photographs of the place, --images)",
        "real, seed 0 (no time was left)",
        "real, seed 1 (no time was left)",
    ]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--budget", "gpu", "--pairs", "3"), "leave --pairs out"),
        (("--real", "absent"), "there is no such folder"),
        (("--go-on",), "expected --json with the file of an earlier command"),
    ],
)
def test_what_cannot_be_followed_is_refused(command, arguments, words):
    done, _ = command("--set", "real", "--steps", "1", *arguments)
    assert done.exit_code == 2
    assert words in done.output


def test_a_processor_without_units_for_it_is_spared_bfloat16(monkeypatch):
    for units, expected in ((True, torch.bfloat16), (False, torch.float32)):
        monkeypatch.setattr(torch.cpu, "get_capabilities", lambda units=units: {"amx_bf16": units})
        assert trainer.find_precision(torch.device("cpu")) == expected
    assert trainer.find_precision(torch.device("cuda")) == torch.bfloat16


def test_real_pairs_are_learnt_from_as_they_are_judged():
    view = compare_sets.read_pairs([], 2, 40)["Motorcycle"]
    [frame] = trainer.of_judges({"Motorcycle": view})
    assert np.array_equal(frame.left.image, view.left)
    assert np.array_equal(frame.left.disparity, view.truth.disparity)
