"""`bench accuracy` measures rendered pixels, and finds known errors."""

import json
from dataclasses import replace

import numpy as np
import pytest
from tiny_datasets import CLUTTER_ALONE, cheap

from semisynth_gl import PairRenderer
from semisynth_gl.bench.accuracy import measure
from semisynth_gl.bench.scenes import sample_scenes
from semisynth_gl.config import load_config
from semisynth_gl.listener import Listener
from semisynth_gl.render.renderer import Renderer

SMALL = (*CLUTTER_ALONE, "scale=0.15", "textures.source=procedural", "textures.max_patches=8", "models.variants=1")


def test_the_command_finds_the_disparity_exact_to_float32(program, tmp_path):
    settings = [word for setting in SMALL for word in ("--set", setting)]
    code, out, err = program("bench", "accuracy", "--pairs", 1, "--rays", 2000, *settings, "--json", "a.json")
    assert code == 0, err
    report = json.loads((tmp_path / "a.json").read_text())
    error = report["disparity"]
    assert error["missing"] == 0
    assert 0 < error["median_px"] < error["p999_px"] <= error["worst_px"] < 1e-4
    assert f"worst {error['worst_px']:.1e} px" in out
    assert report["pixels_compared"] > 1000
    assert report["pixels_compared"] + report["pixels_left_out"] == 4000


def test_surfaces_that_are_not_drawn_count_as_errors(monkeypatch):
    render = Renderer.render

    def lose_every_other(renderer, scene):
        poses = scene.world_from_model.copy()
        poses[1::2, 0, 3] += 1e6
        return render(renderer, replace(scene, world_from_model=poses))

    monkeypatch.setattr(Renderer, "render", lose_every_other)
    report = measure(load_config("eth3d", SMALL), 6, "auto", 1, 2000, listener=Listener())
    assert report["disparity"]["p999_px"] > 1
    assert report["pixels_compared"] > 2000


def test_what_is_measured_is_what_datasets_show():
    patches = ["textures.patch_px=64", "textures.max_patches=60", "textures.large_px=128", "textures.anisotropy=2"]
    scenes = ["scenes=[]", "scale=0.1", "models.variants=1", "models.complex=0", "structures.panels=3"]
    config = load_config("middlebury", [*patches, "textures.texels_per_pixel=[2, 3]", *scenes])
    bench = sample_scenes(config, 5, 2)
    assert len(bench.sources.atlas.large_layers) > 0
    with PairRenderer(config, 5) as pairs, bench.open_renderer("auto") as renderer:
        np.testing.assert_array_equal(renderer.render(bench.scenes[1]).left.image, pairs.render(1).frame.left.image)


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
    error = measure(cheap(**settings), 3, "auto", 1, 500, listener=Listener())["disparity"]
    assert error["worst_px"] < 1e-4
    assert error["missing"] == 0
