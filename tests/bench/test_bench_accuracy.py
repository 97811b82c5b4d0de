"""`bench accuracy` measures what it says: the product's own pixels, known errors, known shifts."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from backends import backend_fault
from bench_reports import SMALL, rows
from tiny_datasets import cheap

from semisynth_gl import PairRenderer
from semisynth_gl.bench.accuracy import Effort, measure, table
from semisynth_gl.bench.antialias import MODES, REFERENCE, psnr_db
from semisynth_gl.bench.scenes import BenchScenes, cast_truth, edges, grown, sample_scenes
from semisynth_gl.bench.summary import front
from semisynth_gl.bench.timing import alternated, compare_times
from semisynth_gl.cli import main
from semisynth_gl.codecs import DISPARITY_CODECS
from semisynth_gl.config import load_config
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.scene import make_scene


@pytest.fixture(scope="module")
def report():
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    return measure(load_config("eth3d", SMALL), 3, "auto", Effort(pairs=1, rays=4000, repeats=1))


def test_the_report_is_whole_and_json(report):
    assert set(rows(report, "store")) == set(DISPARITY_CODECS)
    assert set(rows(report, "antialias")) | set(report["antialias"]["left_out"]) == {*MODES, REFERENCE}
    assert json.loads(json.dumps(report, allow_nan=False))["pixels_compared"] > 1000
    for part in ("store", "antialias"):
        assert report[part]["default"] in rows(report, part)
        assert any(row["on_front"] for row in rows(report, part).values())
        assert all(row["seconds_per_pair"] > 0 for row in rows(report, part).values())
        assert rows(report, part)[report[part]["default"]]["time_ratio"] == 1
        assert all(f" {name} " in table(report).replace("*", " ") for name in rows(report, part))


def test_the_disparity_is_exact_to_float32(report):
    error = report["disparity"]
    assert error["missing"] == 0
    assert 0 < error["median_px"] < error["p999_px"] <= error["worst_px"] < 1e-4
    assert f"worst {error['worst_px']:.1e} px" in table(report)


def test_storing_loses_what_the_format_says(report):
    stored = rows(report, "store")
    assert all(row["error"]["missing"] == 0 for row in stored.values())
    assert {name for name, row in stored.items() if row["lossless"]} == {"pfm"}
    assert stored["pfm"]["error"]["worst_px"] == 0
    assert 0 < stored["png16"]["error"]["worst_px"] <= 1 / 512
    assert stored["pfm"]["bytes_per_pair"] > stored["png16"]["bytes_per_pair"]


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
    few = replace(bench, scenes=bench.scenes[1:]).with_worn_patches()
    assert len(few.layers) < len(bench.layers)
    assert len(few.large_layers) > 0
    stated = {"large_layers": bench.large_layers, "wrap": "mirror", "anisotropy": 2, "large_anisotropy": 4}
    with Renderer(bench.models, bench.layers, **stated) as renderer:
        np.testing.assert_array_equal(renderer.render(bench.scenes[1]).left.image, expected)
    for measured, scene in ((bench, bench.scenes[1]), (few, few.scenes[0])):
        with measured.open_renderer("auto") as renderer:
            np.testing.assert_array_equal(renderer.render(scene).left.image, expected)


def test_worn_patches_are_those_that_scenes_wear(square):
    scenes = [
        make_scene(StereoCamera.centred(8, 6, 9.0, 0.1), model=[0] * 3, world_from_model=[np.eye(4)] * 3, layer=layer)
        for layer in ([6, 2, 6], [3, 4, 4])
    ]
    small, large = (np.arange(*ends, dtype=np.uint8).repeat(4).reshape(-1, 1, 1, 4) for ends in ((4,), (10, 13)))
    worn = BenchScenes(load_config("eth3d"), [square], small, large, scenes).with_worn_patches()
    # The first patch stays.
    assert worn.layers[:, 0, 0, 0].tolist() == [0, 2, 3]
    assert worn.large_layers[:, 0, 0, 0].tolist() == [10, 12]
    assert [scene.layer.tolist() for scene in worn.scenes] == [[4, 1, 4], [2, 3, 3]]


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


def test_psnr_of_known_images():
    black = np.zeros((4, 4), np.uint8)
    assert psnr_db(black, black) == np.inf
    assert psnr_db(black, black + 255) == 0
    assert psnr_db(black, black + 51) == pytest.approx(20 * np.log10(5))


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
    effort = ("--pairs", "1", "--rays", "500", "--repeats", "1")
    settings = [word for setting in SMALL for word in ("--set", setting)]
    json_file = ("--json", str(tmp_path / "a.json"))
    assert run(monkeypatch, "bench", "accuracy", *effort, *settings, *json_file) == 0
    assert asked == [(load_config("eth3d", SMALL), 0, "auto", Effort(pairs=1, rays=500, repeats=1))]
    assert "**pfm**" in capsys.readouterr().out
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
    measured = measure(cheap(**settings), 3, "auto", Effort(pairs=2, rays=500, repeats=1))
    assert measured["disparity"]["worst_px"] < 1e-4
    assert all(row["error"]["missing"] == 0 for row in rows(measured, "store").values())
