"""`bench accuracy` measures what it says: the product's own pixels, known errors, known shifts."""

import json
import sys

import numpy as np
import pytest
from backends import backend_fault
from tiny_datasets import CLUTTER_ALONE, cheap

from semisynth_gl import PairRenderer
from semisynth_gl.bench.accuracy import Effort, measure, table
from semisynth_gl.bench.scenes import cast_truth, edges, grown, sample_scenes
from semisynth_gl.cli import main
from semisynth_gl.config import load_config
from semisynth_gl.render.renderer import Renderer

SMALL = (
    *CLUTTER_ALONE,
    "camera.width_px=160",
    "camera.height_px=100",
    "camera.cx_left_px=80.3",
    "camera.cx_right_px=80.3",
    "camera.cy_px=49.1",
    "particles.size_px=[8, 60]",
    "textures.source=procedural",
    "textures.max_patches=8",
    "models.variants=1",
    "models.complex=0",
)


@pytest.fixture(scope="module")
def report():
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    return measure(load_config("eth3d", SMALL), 3, "auto", Effort(pairs=1, rays=4000))


def test_the_disparity_is_exact_to_float32(report):
    error = report["disparity"]
    assert error["missing"] == 0
    assert 0 < error["median_px"] < error["p999_px"] <= error["worst_px"] < 1e-4
    assert f"worst {error['worst_px']:.1e} px" in table(report)
    assert json.loads(json.dumps(report, allow_nan=False))["pixels_compared"] > 1000


def test_truth_lies_off_edges_and_on_the_drawn_surface():
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    bench = sample_scenes(load_config("eth3d", SMALL), 6, 1)
    with bench.open_renderer("auto", outputs=("instances",)) as renderer:
        frame = renderer.render(bench.scenes[0])
    truths, outlines = cast_truth(bench, [frame], 2000, np.random.default_rng(0))
    assert [part.eye for part in truths] == ["left", "right"]
    for part, outline in zip(truths, outlines, strict=True):
        assert len(part.row) + part.dropped == 2000
        assert len(part.row) > 300
        assert not grown(outline, 2)[part.row, part.column].any()
        drawn = frame.view(part.eye).disparity[part.row, part.column]
        np.testing.assert_allclose(drawn, part.disparity_px, rtol=0, atol=1e-4)


def test_what_is_measured_is_what_datasets_show():
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    patches = ["textures.patch_px=64", "textures.max_patches=60", "textures.large_px=128", "textures.anisotropy=2"]
    patches += ["textures.texels_per_pixel=[2, 3]"]
    scenes = ["scenes=[]", "scale=0.1", "models.variants=1", "models.complex=0", "structures.panels=3"]
    config = load_config("middlebury", [*patches, *scenes, "particles.density=sparse"])
    with PairRenderer(config, 5) as renderer:
        expected = renderer.render(1).frame.left.image
    bench = sample_scenes(config, 5, 2)
    assert len(bench.large_layers) > 0
    stated = {"large_layers": bench.large_layers, "wrap": "mirror", "anisotropy": 2, "large_anisotropy": 4}
    with Renderer(bench.models, bench.layers, **stated) as renderer:
        np.testing.assert_array_equal(renderer.render(bench.scenes[1]).left.image, expected)
    with bench.open_renderer("auto") as renderer:
        np.testing.assert_array_equal(renderer.render(bench.scenes[1]).left.image, expected)


def test_edges_and_their_surroundings():
    image = np.zeros((5, 9))
    image[:, 4:] = 3
    image[2, 8] = np.inf
    marked = edges(image, 1)
    assert marked[0].tolist() == [False, False, False, True, True, False, False, False, False]
    assert marked[2, 7:].all()
    assert marked[1, 8]
    assert not edges(np.full((3, 3), np.inf), 1).any()
    assert grown(np.eye(1, 5, 2, dtype=bool), 1).tolist() == [[False, True, True, True, False]]


def run(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["semisynth-gl", *arguments])
    with pytest.raises(SystemExit) as exit_:
        main()
    return exit_.value.code


def test_the_command_prints_and_writes(monkeypatch, capsys, tmp_path, report):
    asked = []

    def measured(config, seed, backend, effort, _say):
        asked.append((config, seed, backend, effort))
        return report

    monkeypatch.setattr("semisynth_gl.bench.accuracy.measure", measured)
    effort = ("--pairs", "1", "--rays", "500")
    settings = [word for setting in SMALL for word in ("--set", setting)]
    json_file = ("--json", str(tmp_path / "a.json"))
    assert run(monkeypatch, "bench", "accuracy", *effort, *settings, *json_file) == 0
    assert asked == [(load_config("eth3d", SMALL), 0, "auto", Effort(pairs=1, rays=500))]
    assert "Disparity against float64 rays" in capsys.readouterr().out
    assert json.loads((tmp_path / "a.json").read_text())["command"].startswith("semisynth-gl bench accuracy --pairs 1")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--json", "nowhere/a.json"), "does not exist"),
        (("--config", "nobody"), "nobody"),
    ],
)
def test_wrong_arguments_are_refused_before_anything_is_measured(monkeypatch, capsys, arguments, expected):
    assert run(monkeypatch, "bench", "accuracy", *arguments) == 2
    captured = capsys.readouterr()
    assert expected in captured.err
    assert captured.out == ""


@pytest.mark.parametrize(
    "settings",
    [
        {"rig": {"focal_ratio": 1.02, "right_roll_deg": 0.5}},
        {"truth": "left"},
        {"disparity": {"signed": True, "min_px": -8, "max_px": 12, "target": {"form": "uniform"}},
         "camera": {"doffs_px": 10}, "background": {"wall_disparity_px": [-7, -3]}},
    ],
    ids=["deviating", "left", "signed"],
)  # fmt: skip
def test_other_rigs_are_measured_as_exactly(settings):
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    measured = measure(cheap(**settings), 3, "auto", Effort(pairs=2, rays=500))
    assert measured["disparity"]["worst_px"] < 1e-4
    assert measured["disparity"]["missing"] == 0
