"""The options in messages of the command line, and the commands as functions."""

import json
import shutil

import click
import pytest
from click.testing import CliRunner
from hand_made_datasets import write_dataset
from PIL import Image

import semisynth_gl
from semisynth_gl import InputError, calibrate, compare, report, verify
from semisynth_gl.cli.evaluate import evaluate
from semisynth_gl.cli.generate import generate
from semisynth_gl.cli.verify import verify as verify_command

PAIRS = {"train": 2, "validation": 1}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    root = tmp_path_factory.mktemp("wording") / "set"
    write_dataset(root, "middlebury", PAIRS, 2)
    return root


@pytest.mark.parametrize(
    ("command", "argument", "option"),
    [
        (generate, "gpus", "--gpus"),
        (generate, "shard_pairs", "--shard-pairs"),
        (generate, "overrides", "--set"),
        (evaluate, "predictions", "--pred"),
        (evaluate, "truth", "--gt"),
        (evaluate, "gpus", "gpus"),  # no option of the command
    ],
)
def test_a_command_names_its_option_for_an_argument(command, argument, option, monkeypatch):
    def refuse(*_):
        raise InputError("is wrong", argument=argument)

    monkeypatch.setattr(click.Command, "invoke", refuse)
    with pytest.raises(InputError, match=f"^{option}: is wrong"):
        command.invoke(click.Context(command))


def test_the_library_and_its_command_name_one_thing_in_their_own_words(tmp_path):
    with pytest.raises(InputError, match=r"^predictions: none: there is no such folder"):
        semisynth_gl.evaluate("none", write_truth(tmp_path))
    done = CliRunner().invoke(evaluate, ["--pred", "none", "--gt", str(tmp_path)])
    assert str(done.exception).startswith("--pred: none: there is no such folder")


def write_truth(folder):
    write_dataset(folder / "truth", "middlebury", {"train": 1}, 1)
    return folder / "truth"


def test_verify_returns_what_the_command_writes(dataset, tmp_path):
    heard = []
    found = verify(dataset, on_finding=heard.append)
    done = CliRunner().invoke(verify_command, [str(dataset), "--json", str(tmp_path / "a.json")])
    assert done.exit_code == bool(found.findings)
    assert json.loads((tmp_path / "a.json").read_text()) == json.loads(json.dumps(found.values()))
    assert heard == found.findings
    assert (found.pairs, len(found.verdicts)) == (3, 4)
    with pytest.raises(InputError, match="no such folder"):
        verify(tmp_path / "none")


def test_verify_finds_a_fault_and_counts_its_pair(dataset, tmp_path):
    broken = shutil.copytree(dataset, tmp_path / "set", symlinks=True)
    image = next((broken / "validation").rglob("im0.png"))
    Image.new("RGB", Image.open(image).size).save(image)
    (broken / "train" / "stray.png").write_bytes(b"")
    found = verify(broken)
    assert [bool(verdict.findings) for verdict in found.verdicts].count(True) == 2
    assert found.faulty_pairs == 1  # the dataset as a whole is no pair
    assert "sha256" in {finding.check for finding in found.findings}


def test_report_is_a_page(dataset):
    page = report(dataset, pairs=1, sample=2).page
    assert page.lower().startswith("<!doctype html>")


def test_calibrate_makes_a_config_and_refuses_what_does_not_fit(tmp_path):
    path = tmp_path / "photo.png"
    Image.effect_noise((300, 300), 80).convert("RGB").save(path)
    rig = {"focal_px": 700.0, "baseline_m": 0.12, "size": (300, 300), "range_px": (2.0, 96.0)}
    made = calibrate(path, **rig, trials=0, name="my lab")
    assert (made.config.name, made.config.camera.width_px, made.config.camera.baseline_m.low) == ("my-lab", 300, 0.12)
    assert made.text.startswith("# my-lab: written by semisynth-gl calibrate.")
    assert "The range is the one given" in made.text
    for changed, argument in (
        ({"disparity": ["a.pfm"]}, "disparity"),
        ({"size": None}, "size"),
        ({"calib": "calib.txt"}, "focal_px"),
        ({"baseline_m": -1}, "baseline_m"),
        ({"unit": "feet"}, "unit"),
        ({"rectify_to": tmp_path / "new"}, "rectify_to"),
    ):
        with pytest.raises(InputError) as caught:
            calibrate([path], **(rig | {"trials": 0} | changed))
        assert caught.value.argument == argument


def test_compare_takes_folders(dataset, tmp_path):
    for number in range(2):
        Image.effect_noise((64, 48), 40 + 40 * number).convert("RGB").save(tmp_path / f"{number}.png")
    comparison = compare(dataset, tmp_path, width_px=32, sample=2, split="train")
    assert (comparison.pairs, comparison.width_px, comparison.place.photographs) == (2, 32, 2)
