"""`bench speed` reports its measurements; no test depends on the speed."""

import json

import pytest
from recorder import Recorder
from tiny_datasets import CLUTTER_ALONE

from semisynth_gl.bench.speed import STAGES, usual_workers
from semisynth_gl.config import load_config
from semisynth_gl.pairs.pipeline import PAIR_STAGES, PairRenderer

SMALL = (*CLUTTER_ALONE, "scale=0.1", "textures.source=procedural", "textures.max_patches=8", "models.variants=1")
FEW = (*SMALL, "models.complex=0", "particles.layers=[{count: 20}]", "sequence.length=3", "outputs=[flow]")


def test_the_command_times_stages_and_workers(program, tmp_path):
    settings = [word for setting in FEW for word in ("--set", setting)]
    command = ("bench", "speed", "--config", "eth3d", "--pairs", 2, "--workers", 2, "--workers", 1, *settings)
    code, out, err = program(*command, "--json", "a.json")
    assert code == 0, err
    report = json.loads((tmp_path / "a.json").read_text())
    assert [row["name"] for row in report["stages"]] == list(STAGES)
    assert all(row["seconds"] > 0 for row in report["stages"])
    assert sum(row["share"] for row in report["stages"]) == pytest.approx(1)
    assert [row["workers"] for row in report["workers"]] == [1, 2]
    assert all(row["pairs_per_second"] > 0 for row in report["workers"])
    assert {"renderer", "opengl", "backend", "processor", "versions", "usable_cores"} <= set(report["machine"])
    for row in report["stages"]:
        assert f"| {row['name']} " in out


def test_usual_workers_are_powers_of_two_and_all_cores(monkeypatch):
    monkeypatch.setattr("semisynth_gl.bench.speed.cores", lambda: 6)
    assert usual_workers() == {1, 2, 4, 6}


def test_a_renderer_reports_its_stages_in_their_order():
    recorder = Recorder()
    with PairRenderer(load_config("eth3d", SMALL), 0) as renderer:
        renderer.renderer.listener = recorder
        renderer.render(0)
    assert tuple(dict.fromkeys(recorder.stages)) == PAIR_STAGES == tuple(STAGES)[: len(PAIR_STAGES)]
