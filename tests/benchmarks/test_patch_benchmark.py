"""The benchmark of MC-CNN's patch network: costs, the points that it learns from, its page; without its packages."""

import json
import sys
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest
from heavy import heavy

from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.frame.channels import OCCLUDED, VISIBLE, View
from semisynth_gl.frame.frame import Frame

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "benchmarks" / "training"))

import patch_report  # noqa: E402 - found by the line above
from patch_costs import census_costs, learnt_costs, winner  # noqa: E402
from patch_report import WAYS  # noqa: E402

RESULTS = ROOT / "benchmarks" / "results"
SHIFT = 7


def grey(height, width, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width), dtype=np.uint8)


# --- costs ---


def test_census_finds_a_shift_in_spite_of_another_exposure():
    wide = grey(40, 120)
    darker = (wide * 0.6 + 20).astype(np.uint8)
    costs = census_costs(wide[:, :100], darker[:, SHIFT : SHIFT + 100], 20)
    assert costs.shape == (40, 100, 20)
    assert (winner(costs)[:, SHIFT:] == SHIFT).mean() > 0.99
    # Away from the borders, which are repeated outwards, all signs agree but for rounded levels.
    assert costs[8:-8, 20:-20, SHIFT].max() < 0.05


def test_census_counts_the_neighbours_that_are_darker_in_one_image_alone():
    left = np.full((11, 11), 100, np.uint8)
    right = left.copy()
    right[3, 4] = right[9, 9] = 99
    assert census_costs(left, right, 1)[5, 5, 0] == pytest.approx(2 / 120)


def test_costs_of_vectors_are_half_of_one_less_their_cosine():
    rng = np.random.default_rng(0)
    left, right = (each / np.linalg.norm(each, axis=0) for each in rng.normal(size=(2, 6, 5, 12)).astype(np.float32))
    costs = learnt_costs(left, right, 15)
    for row, column, disparity in np.ndindex(costs.shape):
        expected = 1.0
        if column >= disparity:
            expected = (1 - left[:, row, column] @ right[:, row, column - disparity]) / 2
        assert costs[row, column, disparity] == pytest.approx(expected, abs=1e-6)


# --- points ---


@pytest.fixture
def patch_network(monkeypatch):
    heavy("torch")
    packages = "h5py", "mc_cnn", "mc_cnn.model", "mc_cnn.dataset_generator", "mc_cnn.weights"
    modules = "mc_cnn.model.mc_cnn_fast", "mc_cnn.dataset_generator.middlebury_generator"
    for name in (*packages, *modules):
        monkeypatch.setitem(sys.modules, name, MagicMock(name=name))
    import patch_network

    yield patch_network
    del sys.modules["patch_network"]


@pytest.mark.heavy
@pytest.mark.parametrize("masked", [True, False])
def test_points_are_seen_by_both_and_have_their_patches_inside(patch_network, masked):
    height, width, far, near = 40, 100, 6.25, 20.75
    rng = np.random.default_rng(0)
    disparity = np.full((height, width), far, np.float32)
    disparity[10:30, 50:70] = near
    disparity[35:] = np.inf
    mask = np.full(disparity.shape, VISIBLE, np.uint8)
    mask[:, 36:50] = OCCLUDED
    image = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
    left = View({"image": image, "disparity": disparity} | ({"visibility": mask} if masked else {}))
    camera = StereoCamera.centred(width, height, focal_px=width, baseline_m=0.1)
    points = patch_network.points_of(Frame(camera, left, View({"image": image})), 10_000, rng)
    rows, columns = points[:, :2].T.astype(int)
    assert (points[:, 2] == disparity[rows, columns]).all()
    assert set(points[:, 2]) == {np.float32(far), np.float32(near)}
    assert len(np.unique(points[:, :2], axis=0)) == len(points)
    assert (mask[rows, columns] == VISIBLE).all() == masked
    # The patch, the matching one, and any of up to 6 px beside that lie in the images.
    for least, most, side in ((rows - 5, rows + 5, height), (columns - 5, columns + 5, width)):
        assert least.min() >= 0
        assert most.max() < side
    matches = columns - points[:, 2]
    assert matches.min() - 1 - 5 >= 0
    assert matches.max() + 7 + 5 < width
    few = patch_network.points_of(Frame(camera, left, View({"image": image})), 50, rng)
    assert len(few) == 50


# --- the page ---


def run(name, seed, alone, matched):
    def way(mean):
        return {"mean": mean, "pairs": {"Cones": mean - 1, "Pipes": mean + 1}}

    return {"set": name, "seed": seed, "seconds": 600, "winner": way(alone), "semi_global": way(matched)}


def test_the_table_has_mean_and_spread_of_both_ways():
    report = {
        "setup": {"pairs": ["Cones", "Pipes"]},
        "runs": [run("zero-shot", 0, 14, 9), run("zero-shot", 1, 16, 10), run("census", 0, 30, 9.5)],
    }
    lines = patch_report.table(report).splitlines()
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines if line.startswith("|")]
    assert cells[2][:9] == ["zero-shot", "2", "15.00", "1.41", "16.00", "9.50", "0.71", "10.50", "10"]
    assert cells[3][:8] == ["census", "1", "30.00", "-", "31.00", "9.50", "-", "10.50"]
    assert cells[6:] == [["zero-shot", "14.0", "16.0"], ["census", "29.0", "31.0"]]


def test_the_documented_figures_are_those_of_the_measured_runs():
    report = json.loads((RESULTS / "patch-network.json").read_text())
    sets = patch_report.runs_by_set(report)
    alone, smooth = ({name: f"{patch_report.mean_of(runs, way):.1f}" for name, runs in sets.items()} for way in WAYS)
    text = " ".join((ROOT / "docs" / "training.md").read_text().split())
    steps = f"{report['setup']['budget']['steps']:,}"
    assert (
        f"matches with {alone['zero-shot']} % wrong after {steps} steps on `zero-shot`, with {alone['four-real']} %"
        in text
    )
    public = alone["shipped-middlebury"], alone["shipped-satellites"], alone["census"]
    assert "have {} % (Middlebury, these scenes among them) and {} % (satellites), census {} %".format(*public) in text
    rows = ("zero-shot", "four-real", "shipped-middlebury", "shipped-satellites", "census")
    *first, last = (smooth[name] for name in rows)
    assert f"it is {', '.join(first)} and {last} %" in text
    assert len(sets["zero-shot"]) == 3
    longer = json.loads((RESULTS / "patch-network-long.json").read_text())
    assert longer["setup"]["budget"]["steps"] == 4 * report["setup"]["budget"]["steps"]
    assert longer["setup"]["pairs"] == report["setup"]["pairs"]
    sets = patch_report.runs_by_set(longer)
    ours, real, *after = (
        f"{patch_report.mean_of(sets[name], way):.1f}" for way in WAYS for name in ("zero-shot", "four-real")
    )
    assert f"have {ours} % on `zero-shot` and {real} % on the four, {' and '.join(after)} % after" in text
    assert set(patch_report.FOUR_PAIRS) < set(report["setup"]["pairs"])
