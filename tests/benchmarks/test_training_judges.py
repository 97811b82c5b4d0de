"""What the benchmark of training sets judges by, without PyTorch: real pairs, their score, the sets, the page."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from semisynth_gl.calibration.style import untried_style
from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.metrics import score
from semisynth_gl.metrics.truth import Truth

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "benchmarks" / "training"))

import real_pairs  # noqa: E402 - found by the line above
import training_report  # noqa: E402
import training_sets  # noqa: E402
from real_pairs import (  # noqa: E402
    View,
    judge,
    judge_without_truth,
    plainness,
    seen_by_both,
    semi_global,
    shrunk,
    shrunk_disparity,
)
from training_sets import REAL, SETS, config_of  # noqa: E402

INF = np.inf


def textured(height, width, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def view(truth, visible=None):
    truth = np.asarray(truth, np.float32)
    image = np.zeros((*truth.shape, 3), np.uint8)
    return View(image, image, Truth(truth, visible))


# --- pairs ---


@pytest.mark.parametrize(
    ("square", "expected"),
    [
        ([[8, 8], [8, 8]], 4.0),
        ([[8, 8.5], [9, 8.5]], 4.25),  # a slanted surface
        ([[8, 8], [8, 9.5]], INF),  # an edge
        ([[8, 8], [8, INF]], INF),
        ([[INF, INF], [INF, INF]], INF),
    ],
)
def test_a_square_on_one_surface_has_a_disparity(square, expected):
    assert shrunk_disparity(np.array(square, np.float32), 2) == np.float32([[expected]])


def test_what_is_left_over_is_left_out():
    visible = np.ones((7, 8), bool)
    visible[0, 0] = visible[6] = False
    pair = View(textured(7, 8), textured(7, 8, 1), Truth(np.full((7, 8), 6, np.float32), visible))
    small = shrunk(pair, 3)
    assert small.left.shape == small.right.shape == (2, 2, 3)
    assert (small.truth.disparity == 2).all()
    assert small.truth.visible.tolist() == [[False, True], [True, True]]
    assert (small.left[1, 0] == np.rint(pair.left[3:6, :3].mean((0, 1)))).all()


def test_what_a_nearer_surface_hides_is_not_seen_by_both():
    truth = np.full((2, 40), 2, np.float32)
    truth[:, 20:26] = 10  # hides columns 12 to 19, and is seen itself
    truth[1, 30] = INF
    expected = np.ones((2, 40), bool)
    expected[:, :2] = False  # out of the right view
    expected[:, 12:18] = False
    expected[1, 30] = False
    assert (seen_by_both(truth) == expected).all()


def scene(folder, disparity, mask=None):
    folder.mkdir(parents=True)
    (folder / "disp0GT.pfm").write_bytes(PFM.encode(np.asarray(disparity, np.float32)))
    for name in ("im0.png", "im1.png"):
        Image.fromarray(textured(*disparity.shape)).save(folder / name)
    if mask is not None:
        Image.fromarray(mask).save(folder / "mask0nocc.png")


def test_pairs_are_shrunk_until_they_fit_the_search(tmp_path):
    scene(tmp_path / "a" / "Near", np.full((60, 90), 50.0))
    scene(tmp_path / "a" / "Far", np.full((60, 90), 10.0), np.full((60, 90), 128, np.uint8))
    pairs = real_pairs.read_pairs([tmp_path / "a"], 2, 20)
    assert list(pairs) == ["Motorcycle", "Far", "Near"]
    assert {name: pairs[name].left.shape[:2] for name in ("Far", "Near")} == {"Far": (30, 45), "Near": (20, 30)}
    assert not pairs["Far"].truth.visible.any()
    assert 0.2 < pairs["Near"].truth.visible.mean() < 0.5
    assert all(np.nanmax(each.truth.disparity[np.isfinite(each.truth.disparity)]) <= 20 for each in pairs.values())
    scene(tmp_path / "b" / "Near", np.full((60, 90), 5.0))
    with pytest.raises(InputError, match="Near is there twice"):
        real_pairs.read_pairs([tmp_path / "a", tmp_path / "b"], 2, 20)


# --- the score ---


def test_the_score_is_bad_1_of_what_both_eyes_see():
    rng = np.random.default_rng(0)
    pairs, found = {}, {}
    for name, share in (("a", 0.3), ("b", 0.8)):
        truth = rng.uniform(2, 30, (30, 40)).astype(np.float32)
        truth[rng.random(truth.shape) < 0.1] = INF
        visible = rng.random(truth.shape) < 0.7
        pairs[name] = view(truth, visible)
        wrong = rng.random(truth.shape) < share
        found[name] = np.where(np.isfinite(truth), truth, 1) + np.where(wrong, 1.5, 0.5).astype(np.float32)
        counted = np.isfinite(truth) & visible
        found[name, "bad"] = 100 * wrong[counted].mean()
    by_pair, mean = judge(pairs, lambda pair: next(found[name] for name in pairs if pairs[name] is pair))
    for name, pair in pairs.items():
        by_metrics = score(found[name], pair.truth.disparity, "middlebury", mask=pair.truth.visible).figures()["bad-1"]
        assert by_pair[name] == by_metrics == pytest.approx(found[name, "bad"])
    assert mean == pytest.approx((found["a", "bad"] + found["b", "bad"]) / 2)


def test_semi_global_matching_finds_a_shift():
    wide = textured(40, 130)
    pair = View(wide[:, :120], wide[:, 7:127], Truth(np.full((40, 120), 7, np.float32), np.ones((40, 120), bool)))
    found = semi_global(32)(pair)
    assert found.shape == (40, 120)
    assert np.isfinite(found).all()
    assert (np.abs(found - 7) < 0.5)[:, 10:].mean() > 0.95


def test_a_network_is_judged_without_truth_by_the_mirrored_pair():
    shift = 5
    wide = textured(40, 130)
    pair = View(wide[:, :120], wide[:, shift : 120 + shift], Truth(np.full((40, 120), shift, np.float32)))
    found = judge_without_truth({"wall": pair}, lambda view: semi_global(32)(view)[:, 10:-10])
    assert found["wall"] < 3
    noisy = np.random.default_rng(0)
    assert judge_without_truth({"wall": pair}, lambda view: noisy.uniform(0, 30, view.left.shape[:2]))["wall"] > 80


def test_a_wall_of_one_colour_is_plainer_than_noise():
    half = textured(60, 60)
    half[:, :30] = 128
    assert plainness(View(textured(60, 60), half, Truth(np.ones((60, 60))))) == 0
    assert 40 < plainness(View(half, half, Truth(np.ones((60, 60))))) < 50


# --- the sets ---


def test_every_set_is_a_config_of_the_rig(tmp_path, monkeypatch):
    def blurred(facts, place, trials, _):
        # What a trial finds is tested with `calibrate`: here it has to reach the config.
        assert len(place.values["contrast"]) == 2
        assert trials == SETS["calibrated"].trials
        return replace(untried_style(facts.recipes), blur_px=0.4)

    monkeypatch.setattr(training_sets, "tried_style", blurred)
    photographs = tmp_path / "photographs"
    photographs.mkdir()
    for number in range(2):
        Image.fromarray(textured(300, 300, number)).save(photographs / f"{number}.png")
    own = [name for name, row in SETS.items() if not row.pairs_of]
    configs = {name: config_of(name, (str(photographs),), tmp_path) for name in own}
    clutter = configs["clutter"]
    for name, config in configs.items():
        assert (config.name, config.truth) == (name, clutter.truth)
        if SETS[name].own_rig:
            assert config.camera.width_px == clutter.camera.width_px
            assert (config.camera.focal_px, config.disparity) != (clutter.camera.focal_px, clutter.disparity)
            assert config.textures.source == "builtin"
            continue
        assert (config.camera, config.disparity) == (clutter.camera, clutter.disparity)
        other = {"photographs": "photographs", "procedural": "procedural", "builtin": "builtin"}
        assert config.textures.source == other.get(name, "images")
    assert (configs["calibrated"].imperfections.blur_px.high, configs["untried"].imperfections.blur_px.high) == (0.4, 0)
    # But for the number of pairs, sets differ in what they show.
    assert len({config.model_copy(update={"name": "any"}).digest() for config in configs.values()}) == len(own) - 1
    assert config_of("clutter", (), tmp_path).textures.source == "builtin"
    # Other rows differ in what is changed in the pairs.
    for name, row in SETS.items():
        if row.pairs_of:
            assert config_of(name, (str(photographs),), tmp_path) == configs[row.pairs_of]
            assert row.augmentation != SETS[row.pairs_of].augmentation


# --- the page ---


def report(**runs):
    return {
        "machine": {"processor": "P", "device": "cpu", "threads": 1, "precision": "bfloat16", "date": "2000-01-01"},
        "setup": {
            "budget": {"crop_px": [96, 160], "pairs": 96, "steps": 2000, "batch": 2, "max_disparity_px": 40},
            "pairs": ["Cones", "Vase"],
            "plainness": {"Cones": 2.0, "Vase": 30.0},
        },
        "parameters": 200000,
        "sets": {name: row.what for name, row in SETS.items()} | {REAL: "the judged pairs themselves"},
        "semi_global": {"mean": 4.0, "pairs": {"Cones": 3.0, "Vase": 5.0}},
        "runs": [
            {
                "set": name,
                "seed": seed,
                "mean": mean,
                "pairs": {"Cones": mean - 1, "Vase": mean + 1},
                "unconfirmed": {"Cones": 2 * mean, "Vase": 2 * mean + 6},
                "seconds": 90,
            }
            for name, means in runs.items()
            for seed, mean in enumerate(means)
        ],
        "left_out": ["room, seed 1 (no time was left)"],
    }


def test_the_table_has_mean_and_spread_of_each_set():
    lines = training_report.table(report(clutter=[9, 11], real=[5.0], procedural=[14, 12])).splitlines()
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines if line.startswith("|")]
    assert cells[2][:8] == ["real", "5.0", "5.00", "-", "4.0", "6.0", "13.0", "1.5"]
    assert cells[3][:4] == ["clutter", "9.0, 11.0", "10.00", "1.41"]
    assert [row[0] for row in cells[2:6]] == ["real", "clutter", "procedural", "SGBM"]
    assert cells[8:] == [["real", "4.0", "6.0"], ["clutter", "9.0", "11.0"], ["procedural", "12.0", "14.0"],
                         ["SGBM", "3.0", "5.0"]]  # fmt: skip
    assert "room, seed 1 (no time was left)" in lines[-1]


def test_the_headline_says_what_was_trained():
    line = training_report.headline(report())
    assert line.startswith("96 pairs a set; 2,000 steps of 2 crops of 160 x 96 px; 200,000 parameters")
    assert line.endswith("P, cpu, 1 thread; 2000-01-01")


def test_the_documented_means_are_those_of_the_measured_runs():
    measured = json.loads((ROOT / "benchmarks" / "results" / "training-sets.json").read_text())
    sets = training_report.runs_by_set(measured)
    means = {name: f"{training_report.mean_of(runs):.2f} %" for name, runs in sets.items()}
    once = {"raft-stereo", "moved"}  # which the page says
    assert {name: len(runs) for name, runs in sets.items()} == {name: 1 if name in once else 3 for name in sets}
    text = " ".join((ROOT / "docs" / "training.md").read_text().split())
    assert (
        f"What `calibrate` writes has {means['calibrated']}, floating models in a box {means['clutter']}, OpenCV's "
        f"SGBM {measured['semi_global']['mean']:.2f} %"
    ) in text
    assert f"`zero-shot`, which knows nothing of the place, has {means['zero-shot']}" in text
    assert f"Crops alone have {means['unchanged']}; with the colours of `semisynth` it is {means['calibrated']}" in text
    assert f"Scale and stretch on top come to {means['scaled']}" in text
    assert f"`raft-stereo` ({means['raft-stereo']})" in text
    assert f"moved and hidden in part ({means['moved']})" in text
    wrong = sorted(round(run["pairs"]["Wood2"]) for run in sets["clutter"])[1:]
    assert "two of their three networks are wrong in {} and in {} % of the pixels".format(*wrong) in text


def test_the_documented_trust_in_a_judge_without_truth_is_the_measured_one():
    results = ROOT / "benchmarks" / "results"
    measured, short = (json.loads((results / f"{name}.json").read_text()) for name in ("training-sets", "unconfirmed"))
    text = " ".join((ROOT / "docs" / "evaluate.md").read_text().split())
    every = {"runs": measured["runs"] + short["runs"]}
    assert f"Over {len(every['runs'])} networks" in text
    assert f"its correlation with bad-1 was {training_report.trust(every):.2f}" in text
    best = {"runs": [run for run in every["runs"] if run["mean"] < 8]}
    assert f"over the {len(best['runs'])} best" in text
    assert f"none ({training_report.trust(best):.2f})" in text


def test_the_documented_figures_are_those_of_the_measured_runs():
    report = json.loads((ROOT / "benchmarks" / "results" / "calibrated-floating.json").read_text())
    few, many = (report[name] for name in ("two to six floating models", "12 to 40 floating models"))

    def listed(runs):
        *first, last = (f"{run['mean']:.2f}" for run in runs)
        return f"{', '.join(first)} and {last}"

    documented = " ".join((ROOT / "docs" / "training.md").read_text().split())
    assert f"bad-1 fell from {listed(few)} to {listed(many)}" in documented
