"""`benchmarks/alternatives.py`: variants of the disparity and encodings that the program does not offer."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from backends import backend_fault
from bench_reports import SMALL, rows

from semisynth_gl.bench.accuracy import Effort, table
from semisynth_gl.bench.encodings import offered_encodings
from semisynth_gl.bench.scenes import sample_scenes
from semisynth_gl.bench.summary import error_stats
from semisynth_gl.config import load_config
from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.scene.background import FACE
from semisynth_gl.scene.scene import make_scene

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from alternatives import command_line, measure, more_disparity_encodings
from disparity_variants import RENDERERS_VARIANT, VARIANTS, DisparityVariants

LOSSLESS = {"pfm", "deflate", "delta", "blosc2"}
LARGEST_ERROR_PX = {"png16": 1 / 512, "grid": 1 / 2048, "grid-delta": 1 / 2048}
ENCODINGS = [*offered_encodings(), *more_disparity_encodings()]


@pytest.fixture(scope="module")
def report():
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    return measure(load_config("eth3d", SMALL), 3, "auto", Effort(pairs=1, rays=4000, repeats=1))


def test_no_option_has_to_be_given():
    options = command_line().parse_args([])
    assert Effort(options.pairs, options.rays, options.repeats) == Effort()
    assert load_config(options.config, options.settings).name == "eth3d"


def test_the_report_has_offered_and_other_alternatives(report):
    assert set(rows(report, "get")) | set(report["get"]["left_out"]) == set(VARIANTS)
    assert set(rows(report, "store")) >= LOSSLESS - {"blosc2"} | set(LARGEST_ERROR_PX) | {"half"}
    assert json.loads(json.dumps(report, allow_nan=False))["pixels_compared"] > 1000
    for part in ("get", "store"):
        assert report[part]["default"] in rows(report, part)
        assert any(row["on_front"] for row in rows(report, part).values())
        assert all(f" {name} " in table(report).replace("*", " ") for name in rows(report, part))


def test_errors_are_ordered_as_the_numbers_behind_them(report):
    error = {name: row["error"] for name, row in rows(report, "get").items()}
    assert all(own["missing"] == 0 for own in error.values())
    assert error["depth24"]["median_px"] > 10 * error[RENDERERS_VARIANT]["median_px"]
    assert error["depth24"]["median_px"] > 3 * error["depth24-tight"]["median_px"]
    assert error[RENDERERS_VARIANT]["worst_px"] < 1e-3


def test_planes_in_float64_leave_the_rounding_of_the_result_to_float32(report):
    if "plane64" in report["get"]["left_out"]:
        pytest.skip(report["get"]["left_out"]["plane64"])
    error = rows(report, "get")["plane64"]["error"]
    assert error["worst_px"] <= np.spacing(np.float32(report["disparity_px"]["largest"]))


def test_storing_loses_what_the_format_says(report):
    for name, row in rows(report, "store").items():
        assert row["error"]["missing"] == 0
        assert row["lossless"] == (name in LOSSLESS)
        if name in LARGEST_ERROR_PX:
            assert 0 < row["error"]["worst_px"] <= LARGEST_ERROR_PX[name]
    sizes = {name: row["bytes_per_pair"] for name, row in rows(report, "store").items()}
    assert sizes["pfm"] > sizes["deflate"] > sizes["delta"]
    assert 2 * 160 * 100 * 2 < sizes["half"] < 2 * 160 * 100 * 2 + 400


def test_the_renderers_variant_draws_as_the_renderer_does(backend):
    bench = sample_scenes(load_config("eth3d", SMALL), 5, 1)
    with DisparityVariants(bench.models, backend) as variants:
        drawn = {
            (eye, variant): variants.disparity(bench.scenes[0], eye, variant)
            for eye in EYES
            for variant in variants.usable
        }
    with bench.open_renderer(backend) as renderer:
        frame = renderer.render(bench.scenes[0])
    for (eye, variant), disparity in drawn.items():
        own = frame.view(eye).disparity
        if variant == RENDERERS_VARIANT:
            np.testing.assert_array_equal(disparity, own)
        assert np.quantile(np.abs(disparity - own), 0.99) < 1e-3, variant


def test_every_variant_knows_what_has_no_disparity(backend):
    far = np.diag([1.0, 1.0, 1.0, 1.0])
    far[:3, 3] = -0.5, -0.5, 2.0
    with DisparityVariants([FACE], backend) as variants:
        for size in ((40, 30), (17, 9)):
            camera = StereoCamera(*size, 30.0, 0.1, 15.0, 19.0, 8.0)  # 30 * 0.1 / 2 is below doffs: none is positive
            scene = make_scene(camera, model=[0], world_from_model=[far], layer=[0])
            empty = make_scene(camera, model=[], world_from_model=np.zeros((0, 4, 4)), layer=[])
            for variant in variants.usable:
                for shown in (scene, empty):
                    disparity = variants.disparity(shown, "right", variant)
                    assert disparity.shape == size[::-1]
                    assert np.isposinf(disparity).all(), variant


@pytest.mark.parametrize("encoding", ENCODINGS, ids=lambda encoding: encoding.name)
@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (7, 1), (31, 45)])
def test_encodings_round_trip(encoding, shape):
    rng = np.random.default_rng(1)
    disparity = rng.uniform(0.01, 255.9, shape).astype(np.float32)
    disparity[rng.random(shape) < 0.2] = np.inf
    back = encoding.decode(encoding.encode(disparity), shape)
    assert back.dtype == np.float32
    np.testing.assert_array_equal(np.isinf(back), np.isinf(disparity))
    finite = np.isfinite(disparity)
    largest = 0 if encoding.name in LOSSLESS else LARGEST_ERROR_PX.get(encoding.name, 0.07)
    np.testing.assert_allclose(back[finite], disparity[finite], rtol=0, atol=largest)


def test_disparities_beyond_an_encoding_count_as_missing():
    png16 = next(encoding for encoding in ENCODINGS if encoding.name == "png16")
    disparity = np.array([[0.001, 255.99, 256.1, 300, np.inf]], np.float32)
    back = png16.decode(png16.encode(disparity), disparity.shape)
    assert np.isfinite(back).tolist() == [[True, True, False, False, False]]
    assert error_stats(back, disparity.astype(np.float64))["missing"] == 2
