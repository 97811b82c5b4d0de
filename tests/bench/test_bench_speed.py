"""`bench speed` tells what it measured; how fast anything is, no test asks."""

import json
import sys

import numpy as np
import pytest
from backends import backend_fault
from recorder import Recorder
from tiny_datasets import CLUTTER_ALONE, SCENES

from semisynth_gl.bench.shards import LAYOUT
from semisynth_gl.bench.speed import STAGES, Costs, Effort, measure, stage_rows, table, usual_workers
from semisynth_gl.cli import main
from semisynth_gl.config import load_config
from semisynth_gl.dataset.generate import generate
from semisynth_gl.pairs.pipeline import PAIR_STAGES
from semisynth_gl.render.backends import is_software

SMALL = (
    *CLUTTER_ALONE,
    "camera.width_px=96",
    "camera.height_px=64",
    "camera.cx_left_px=48.3",
    "camera.cx_right_px=48.3",
    "camera.cy_px=31.1",
    "particles.size_px=[8, 40]",
    "textures.source=procedural",
    "textures.max_patches=8",
    "models.variants=1",
    "models.complex=0",
)
PAIRS = 2


@pytest.fixture(scope="module")
def config():
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    return load_config("eth3d", SMALL)


@pytest.fixture(scope="module")
def report(config):
    return measure(config, 3, "auto", Effort(pairs=PAIRS, repeats=1, workers=(2, 1)))


def test_the_report_is_whole_and_json(report):
    assert json.loads(json.dumps(report, allow_nan=False)) == report
    assert [row["name"] for row in report["stages"]] == [*STAGES, "processor"]
    assert all(row["seconds"] > 0 for row in report["stages"])
    assert [row["workers"] for row in report["workers"]] == [1, 2]
    assert report["workers"][0]["ratio"] == 1
    assert all(row["pairs_per_second"] > 0 for row in report["workers"])
    assert {"renderer", "opengl", "backend", "processor", "versions", "usable_cores"} <= set(report["machine"])


def test_bytes_are_those_of_the_files(report, config, tmp_path):
    pairs = 1 + PAIRS
    generate(config, tmp_path, pairs, 3, layout=LAYOUT)
    scenes = sorted((tmp_path / SCENES).iterdir())
    sizes = [sum(path.stat().st_size for path in scene.iterdir()) for scene in scenes]
    rows = {row["name"]: row for row in report["stages"]}
    # The first pair is drawn before the others are timed.
    assert rows["write"]["bytes_per_pair"] == rows["encode"]["bytes_per_pair"] == np.mean(sizes[1:])
    # Two images of three bytes, two disparities of four, two masks of one.
    assert rows["readback"]["bytes_per_pair"] == 96 * 64 * 2 * (3 + 4 + 1)
    assert rows["draw"]["bytes_per_pair"] is None


def costs(**seconds):
    return {stage: Costs(2 * seconds.get(stage, 0.0), seconds.get(stage, 0.0), None) for stage in STAGES}


def test_the_limit_is_the_least_that_stages_and_processor_allow(report):
    pairs = [costs(draw=0.1, encode=0.05), costs(draw=0.3, encode=0.05, write=0.1)]
    stages = stage_rows(pairs, 4, software=True)
    rows = {row["name"]: row for row in stages}
    assert rows["draw"]["allows_per_second"] == pytest.approx(4 / 0.2)
    assert rows["draw"]["share"] == pytest.approx(0.2 / 0.3)
    assert rows["processor"]["allows_per_second"] == pytest.approx(4 / 0.3)
    assert "The processor allows 13.3 pairs/s" in table(report | {"stages": stages})


def test_on_a_gpu_drawing_is_not_shared_out_to_cores(report):
    stages = stage_rows([costs(draw=0.1, encode=0.05)], 8, software=False)
    rows = {row["name"]: row for row in stages}
    assert rows["draw"]["allows_per_second"] == pytest.approx(1 / 0.2)
    assert rows["encode"]["allows_per_second"] == pytest.approx(8 / 0.05)
    assert "The draw allows 5 pairs/s" in table(report | {"stages": stages})


def test_software_renderers_are_known():
    assert is_software("llvmpipe (LLVM 15.0.6, 256 bits)")
    assert not is_software("NVIDIA H100 80GB HBM3/PCIe/SSE2")


def test_usual_workers_end_with_all_cores(monkeypatch):
    for cores, expected in ((1, (1,)), (2, (1, 2)), (6, (1, 2, 4, 6)), (8, (1, 2, 4, 8))):
        monkeypatch.setattr("semisynth_gl.bench.speed.cores", lambda cores=cores: cores)
        assert usual_workers() == expected


def test_a_renderer_reports_its_stages_in_their_order(config):
    from semisynth_gl.pairs.pipeline import PairRenderer

    recorder = Recorder()
    with PairRenderer(config, 0) as renderer:
        renderer.listener = recorder
        pair = renderer.render(0)
        renderer.listener = None
        plain = renderer.render(0)
    assert tuple(dict.fromkeys(recorder.stages)) == PAIR_STAGES
    np.testing.assert_array_equal(pair.frame.left.image, plain.frame.left.image)
    np.testing.assert_array_equal(pair.frame.right.visibility, plain.frame.right.visibility)


def run(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["semisynth-gl", "bench", "speed", *arguments])
    with pytest.raises(SystemExit) as exit_:
        main()
    return exit_.value.code


def test_the_command_prints_and_writes(monkeypatch, capsys, tmp_path, report):
    monkeypatch.setattr("semisynth_gl.bench.speed.measure", lambda *_: dict(report))
    assert run(monkeypatch, "--json", str(tmp_path / "a.json")) == 0
    assert "| processor " in capsys.readouterr().out
    assert json.loads((tmp_path / "a.json").read_text())["command"].startswith("semisynth-gl bench speed --json")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--json", "nowhere/a.json"), "does not exist"),
        (("--workers", "1,x"), "whole numbers from 1 to"),
        (("--workers", "0"), "whole numbers from 1 to"),
        (("--config", "nobody"), "nobody"),
    ],
)
def test_wrong_arguments_are_refused_before_anything_is_measured(monkeypatch, capsys, arguments, expected):
    assert run(monkeypatch, *arguments) == 2
    captured = capsys.readouterr()
    assert expected in captured.err
    assert captured.out == ""
