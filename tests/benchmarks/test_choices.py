"""`benchmarks/choices.py`: what encodings and antialiasing modes lose and gain."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from backends import backend_fault
from tiny_datasets import cheap

from semisynth_gl.bench.scenes import BenchScenes
from semisynth_gl.codecs import DISPARITY_CODECS
from semisynth_gl.config import load_config
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.scene.scene import make_scene

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from antialias_modes import MODES, REFERENCE, psnr_db, with_worn_patches
from choices import Effort, measure, table
from timing import alternated, compare_times, front


@pytest.fixture(scope="module")
def report():
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    return measure(cheap(), 3, "auto", Effort(pairs=1, rays=500, repeats=1))


def rows(report, part):
    return {row["name"]: row for row in report[part]["rows"]}


def test_the_report_is_whole_and_json(report):
    assert set(rows(report, "store")) == set(DISPARITY_CODECS)
    assert set(rows(report, "antialias")) | set(report["antialias"]["left_out"]) == {*MODES, REFERENCE}
    json.dumps(report, allow_nan=False)
    for part in ("store", "antialias"):
        assert any(row["on_front"] for row in rows(report, part).values())
        assert all(row["seconds_per_pair"] > 0 for row in rows(report, part).values())
        assert rows(report, part)[report[part]["default"]]["time_ratio"] == 1
        assert all(f" {name} " in table(report).replace("*", " ") for name in rows(report, part))


def test_storing_loses_what_the_format_says(report):
    stored = rows(report, "store")
    assert all(row["error"]["missing"] == 0 for row in stored.values())
    assert {name for name, row in stored.items() if row["lossless"]} == {"pfm"}
    assert stored["pfm"]["error"]["worst_px"] == 0
    assert 0 < stored["png16"]["error"]["worst_px"] <= 1 / 512
    assert stored["pfm"]["bytes_per_pair"] > stored["png16"]["bytes_per_pair"]


def test_more_samples_come_nearer_to_the_reference(report):
    modes = rows(report, "antialias")
    assert modes["none"]["psnr_db"] < modes["ssaa2"]["psnr_db"] < modes["ssaa3"]["psnr_db"]
    assert modes[REFERENCE]["psnr_db"] is None
    assert not modes[REFERENCE]["on_front"]


def test_the_front_keeps_what_no_point_dominates():
    points = {"cheap": (1.0, 9.0), "exact": (9.0, 0.0), "dominated": (2.0, 9.5), "nearly": (1.04, 9.0)}
    assert front(points) == {"cheap", "exact", "nearly"}
    assert front(points, tolerance=0) == {"cheap", "exact"}
    assert front({"alone": (1.0,)}) == {"alone"}
    assert front({"one": (1.0, 1.0), "same": (1.0, 1.0)}) == {"one", "same"}


def test_alternatives_take_turns():
    order = []
    seconds = alternated({name: lambda name=name: order.append(name) for name in "abc"}, 3)
    assert "".join(order) == "abcbcacab"
    assert {name: len(own) for name, own in seconds.items()} == {"a": 3, "b": 3, "c": 3}
    timing = compare_times({"a": np.array([2.0, 4, 2]), "b": np.array([4.0, 8, 8])}, "a", 2)
    assert (timing["b"].seconds, timing["b"].ratio) == (4, 2)


def test_psnr_of_known_images():
    black = np.zeros((4, 4), np.uint8)
    assert psnr_db(black, black) == np.inf
    assert psnr_db(black, black + 255) == 0
    assert psnr_db(black, black + 51) == pytest.approx(20 * np.log10(5))


def test_worn_patches_are_those_that_scenes_wear(square):
    scenes = [
        make_scene(StereoCamera.centred(8, 6, 9.0, 0.1), model=[0] * 3, world_from_model=[np.eye(4)] * 3, layer=layer)
        for layer in ([6, 2, 6], [3, 4, 4])
    ]
    small, large = (np.arange(*ends, dtype=np.uint8).repeat(4).reshape(-1, 1, 1, 4) for ends in ((4,), (10, 13)))
    worn = with_worn_patches(BenchScenes(load_config("eth3d"), [square], small, large, scenes))
    # The first patch stays.
    assert worn.layers[:, 0, 0, 0].tolist() == [0, 2, 3]
    assert worn.large_layers[:, 0, 0, 0].tolist() == [10, 12]
    assert [scene.layer.tolist() for scene in worn.scenes] == [[4, 1, 4], [2, 3, 3]]
