"""What the library says in its own words and the command line in options, and the commands as functions."""

import json
import shutil

import pytest
from click.testing import CliRunner
from hand_made_datasets import write_dataset
from PIL import Image

import semisynth_gl
from semisynth_gl import InputError, calibrate, compare, report, verify
from semisynth_gl.cli.evaluate import evaluate
from semisynth_gl.cli.generate import generate
from semisynth_gl.cli.verify import verify as verify_command
from semisynth_gl.cli.wording import in_options

PAIRS = {"train": 2, "validation": 1}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    root = tmp_path_factory.mktemp("wording") / "set"
    write_dataset(root, "middlebury", PAIRS, 2)
    return root


@pytest.mark.parametrize(
    ("command", "text", "expected"),
    [
        (generate, "another folder for `out`, or give `overwrite`", "another folder for --out, or give --overwrite"),
        (generate, "`shard_pairs` must be 1 or more", "--shard-pairs must be 1 or more"),
        (generate, "name them in `textures.images`", "name them in --images"),
        (generate, "`overrides` camera.width_px: expected", "--set camera.width_px: expected"),
        (evaluate, "`predictions` a: no prediction; `truth` b", "--pred a: no prediction; --gt b"),
        # What the command has no option for, or is no name of an argument, stays.
        (evaluate, "give `gpus`? `semisynth-gl doctor` tells", "give `gpus`? `semisynth-gl doctor` tells"),
        (evaluate, "name them in `textures.images`", "name them in `textures.images`"),
    ],
)
def test_a_command_names_its_options(command, text, expected):
    assert in_options(text, command) == expected


def test_the_library_and_its_command_name_one_thing_in_their_own_words(tmp_path):
    with pytest.raises(InputError, match=r"^`predictions` none: there is no such folder"):
        semisynth_gl.evaluate("none", write_truth(tmp_path))
    done = CliRunner().invoke(evaluate, ["--pred", "none", "--gt", str(tmp_path)])
    assert str(done.exception).startswith("--pred none: there is no such folder")


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
    with pytest.raises(InputError, match="`pixels` must be 1 or more"):
        verify(dataset, oracle=True, pixels=0)
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
    with pytest.raises(InputError, match="`sample` must be 1 or more"):
        report(dataset, sample=0)


def test_calibrate_makes_a_config_and_refuses_in_the_words_of_python(tmp_path):
    path = tmp_path / "photo.png"
    Image.effect_noise((300, 300), 80).convert("RGB").save(path)
    rig = {"focal_px": 700.0, "baseline_m": 0.12, "size": (300, 300), "range_px": (2.0, 96.0)}
    made = calibrate(path, **rig, trials=0, name="my lab")
    assert (made.config.name, made.config.camera.width_px, made.config.camera.baseline_m.low) == ("my-lab", 300, 0.12)
    assert made.text.startswith("# my-lab: written by semisynth-gl calibrate.")
    assert "The range is the one given" in made.text
    for changed, words in (
        ({"disparity": ["a.pfm"]}, "`range_px` and `disparity` both state the disparities"),
        ({"size": None}, "`size` missing: give `calib`, or `focal_px`, `baseline_m` and `size`"),
        ({"size": (300,)}, "`size`: expected width and height"),
        ({"baseline_m": -1}, "`baseline_m` -1: expected a distance above 0"),
        ({"unit": "feet"}, "`unit`: expected one of m, cm, mm"),
        ({"trials": -1}, "`trials` must be 0 or more"),
        ({"calib": 7}, "`calib` must be"),
    ):
        with pytest.raises(InputError) as caught:
            calibrate([path], **(rig | {"trials": 0} | changed))
        assert words in str(caught.value)


def test_compare_takes_folders(dataset, tmp_path):
    for number in range(2):
        Image.effect_noise((64, 48), 40 + 40 * number).convert("RGB").save(tmp_path / f"{number}.png")
    comparison = compare(dataset, tmp_path, width_px=32, sample=2, split="train")
    assert (comparison.pairs, comparison.width_px, comparison.place.photographs) == (2, 32, 2)
