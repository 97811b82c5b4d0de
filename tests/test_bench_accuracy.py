"""`bench accuracy` measures what it says: the product's own pixels, known errors, known shifts."""

import json
import sys

import numpy as np
import pytest
from backends import backend_fault

from semisynth_gl import encodings
from semisynth_gl.bench.accuracy import Effort, measure, table
from semisynth_gl.bench.images import MODES, REFERENCE, psnr_db, shift_px, truth_shift_px
from semisynth_gl.bench.scenes import edges, grown, sample_scenes
from semisynth_gl.bench.stores import image_stores, stores
from semisynth_gl.bench.timing import alternated, compared, front
from semisynth_gl.bench.ways import error_stats
from semisynth_gl.camera import EYES, StereoCamera
from semisynth_gl.cli import main
from semisynth_gl.config import load_config
from semisynth_gl.encodings import IMAGE_ENCODINGS
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.render.variants import DEFAULT_WAY, WAYS, DisparityVariants
from semisynth_gl.scene.background import FACE
from semisynth_gl.scene.scene import make_scene

SMALL = (
    "camera.width_px=160",
    "camera.height_px=100",
    "camera.cx_left_px=80.3",
    "camera.cx_right_px=80.3",
    "camera.cy_px=49.1",
    "particles.size_px=[8, 60]",
    "textures.source=procedural",
    "textures.max_patches=8",
    "models.variants=1",
)
LOSSLESS = {"pfm", "tiff", "deflate", "delta", "blosc2"}
LARGEST_ERROR_PX = {"png16": 1 / 512, "grid": 1 / 2048, "grid-delta": 1 / 2048}


@pytest.fixture(scope="module")
def report():
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    return measure(load_config("eth3d", SMALL), 3, "auto", Effort(pairs=1, rays=4000, repeats=1))


def rows(report, part):
    return {row["name"]: row for row in report[part]["rows"]}


def test_the_report_is_whole_and_json(report):
    assert set(rows(report, "get")) | set(report["get"]["left_out"]) == set(WAYS)
    assert set(rows(report, "store")) >= LOSSLESS - {"blosc2"} | set(LARGEST_ERROR_PX) | {"half"}
    assert set(rows(report, "images_store")) | set(report["images_store"]["left_out"]) == {
        *IMAGE_ENCODINGS, "png-pillow",
    }  # fmt: skip
    assert all(row["lossless"] for row in rows(report, "images_store").values())
    assert set(rows(report, "antialias")) | set(report["antialias"]["left_out"]) == {*MODES, REFERENCE}
    assert json.loads(json.dumps(report, allow_nan=False))["pixels_compared"] > 1000
    for part in ("get", "store", "images_store", "antialias"):
        assert report[part]["default"] in rows(report, part)
        assert any(row["on_front"] for row in rows(report, part).values())
        assert all(row["seconds_per_pair"] > 0 for row in rows(report, part).values())
        assert rows(report, part)[report[part]["default"]]["time_ratio"] == 1
        assert all(f" {name} " in table(report).replace("*", " ") for name in rows(report, part))


def test_errors_are_ordered_as_the_numbers_behind_them(report):
    error = {name: row["error"] for name, row in rows(report, "get").items()}
    assert all(one["missing"] == 0 for one in error.values())
    assert error["depth24"]["median_px"] > 10 * error[DEFAULT_WAY]["median_px"]
    assert error["depth24"]["median_px"] > 3 * error["depth24-tight"]["median_px"]
    assert error[DEFAULT_WAY]["worst_px"] < 1e-3


def test_planes_in_float64_leave_the_rounding_of_the_result_to_float32(report):
    if "plane64" in report["get"]["left_out"]:
        pytest.skip(report["get"]["left_out"]["plane64"])
    error = rows(report, "get")["plane64"]["error"]
    assert error["worst_px"] <= np.spacing(np.float32(report["disparity_px"]["largest"]))


def test_storing_loses_what_the_format_says(report):
    for name, row in rows(report, "store").items():
        assert row["error"]["missing"] == 0
        if name in LOSSLESS:
            assert row["error"]["worst_px"] == 0
        if name in LARGEST_ERROR_PX:
            assert 0 < row["error"]["worst_px"] <= LARGEST_ERROR_PX[name]
    sizes = {name: row["bytes_per_pair"] for name, row in rows(report, "store").items()}
    assert sizes["pfm"] > sizes["deflate"] > sizes["delta"]
    assert 2 * 160 * 100 * 2 < sizes["half"] < 2 * 160 * 100 * 2 + 400


def test_more_samples_come_nearer_to_the_reference_and_none_shifts(report):
    found = rows(report, "antialias")
    assert found["none"]["psnr_db"] < found["ssaa2"]["psnr_db"] < found["ssaa3"]["psnr_db"]
    assert found[REFERENCE]["psnr_db"] is None
    assert not found[REFERENCE]["on_front"]
    assert all(row["shift_px"] <= 0.01 for row in found.values())


def test_the_default_way_is_the_products_own(backend):
    bench = sample_scenes(load_config("eth3d", SMALL), 5, 1)
    with DisparityVariants(bench.models, backend) as variants:
        ways = {(eye, way): variants.disparity(bench.scenes[0], eye, way) for eye in EYES for way in variants.ways}
        instance, triangle = variants.surface(bench.scenes[0], "left")
    with Renderer(bench.models, bench.layers, outputs=("instances",), backend=backend) as renderer:
        frame = renderer.render(bench.scenes[0])
    np.testing.assert_array_equal(ways["left", DEFAULT_WAY], frame.disparity_left)
    np.testing.assert_array_equal(ways["right", DEFAULT_WAY], frame.disparity_right)
    np.testing.assert_array_equal(instance + 1, frame.instances_left)
    assert (triangle >= 0).all()
    for (eye, way), disparity in ways.items():
        difference = np.abs(disparity - ways[eye, DEFAULT_WAY])
        assert np.quantile(difference, 0.99) < 1e-3, way


def test_every_way_knows_what_has_no_disparity(backend):
    far = np.diag([1.0, 1.0, 1.0, 1.0])
    far[:3, 3] = -0.5, -0.5, 2.0
    with DisparityVariants([FACE], backend) as variants:
        for size in ((40, 30), (17, 9)):
            camera = StereoCamera(*size, 30.0, 0.1, 15.0, 19.0, 8.0)  # 30 * 0.1 / 2 is below doffs: none is positive
            scene = make_scene(camera, model=[0], world_from_model=[far], layer=[0])
            empty = make_scene(camera, model=[], world_from_model=np.zeros((0, 4, 4)), layer=[])
            assert (variants.surface(scene, "left")[0] == 0).any()
            assert (variants.surface(empty, "left")[0] == -1).all()
            for way in variants.ways:
                for shown in (scene, empty):
                    disparity = variants.disparity(shown, "right", way)
                    assert disparity.shape == size[::-1]
                    assert np.isposinf(disparity).all(), way


@pytest.mark.parametrize("store", stores(), ids=lambda store: store.name)
@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (7, 1), (31, 45)])
def test_stores_round_trip(store, shape):
    rng = np.random.default_rng(1)
    disparity = rng.uniform(0.01, 255.9, shape).astype(np.float32)
    disparity[rng.random(shape) < 0.2] = np.inf
    back = store.decode(store.encode(disparity), shape)
    assert back.dtype == np.float32
    np.testing.assert_array_equal(np.isinf(back), np.isinf(disparity))
    if store.name in LOSSLESS:
        np.testing.assert_array_equal(back, disparity)
    finite = np.isfinite(disparity)
    np.testing.assert_allclose(back[finite], disparity[finite], rtol=0, atol=LARGEST_ERROR_PX.get(store.name, 0.07))


def test_what_a_store_cannot_hold_counts_as_missing():
    store = next(store for store in stores() if store.name == "png16")
    disparity = np.array([[0.001, 255.99, 256.1, 300, np.inf]], np.float32)
    back = store.decode(store.encode(disparity), disparity.shape)
    assert np.isfinite(back).tolist() == [[True, True, False, False, False]]
    assert error_stats(back, disparity.astype(np.float64)).missing == 2


def test_images_without_imagecodecs_are_left_out_with_the_reason(monkeypatch):
    def refuse(name):
        raise ImportError(name)

    monkeypatch.setattr(encodings, "import_module", refuse)
    found, left_out = image_stores()
    assert [store.name for store in found] == ["png", "png-pillow"]
    assert set(left_out) == {"qoi", "jxl"}
    assert all("imagecodecs" in reason for reason in left_out.values())


def test_the_front_keeps_what_no_other_point_beats():
    points = {"cheap": (1.0, 9.0), "exact": (9.0, 0.0), "beaten": (2.0, 9.5), "nearly": (1.04, 9.0)}
    assert front(points) == {"cheap", "exact", "nearly"}
    assert front(points, tolerance=0) == {"cheap", "exact"}
    assert front({"alone": (1.0,)}) == {"alone"}
    assert front({"one": (1.0, 1.0), "same": (1.0, 1.0)}) == {"one", "same"}


def test_alternatives_take_turns():
    order = []
    seconds = alternated({name: lambda name=name: order.append(name) for name in "abc"}, 3)
    assert "".join(order) == "abcbcacab"
    assert {name: len(own) for name, own in seconds.items()} == {"a": 3, "b": 3, "c": 3}
    timing = compared({"a": np.array([2.0, 4, 2]), "b": np.array([4.0, 8, 8])}, "a", 2)
    assert (timing["b"].seconds, timing["b"].ratio) == (4, 2)


def test_edges_and_their_surroundings():
    image = np.zeros((5, 9))
    image[:, 4:] = 3
    image[2, 8] = np.inf
    found = edges(image, 1)
    assert found[0].tolist() == [False, False, False, True, True, False, False, False, False]
    assert found[2, 7:].all()
    assert found[1, 8]
    assert not edges(np.full((3, 3), np.inf), 1).any()
    assert grown(np.eye(1, 5, 2, dtype=bool), 1).tolist() == [[False, True, True, True, False]]


def test_a_known_shift_is_found():
    y, x = np.mgrid[:60, :80].astype(float)

    def image(x, y):
        return 90 + 50 * np.sin(x / 5) * np.cos(y / 7 + x / 40)

    expected = image(x, y)
    gradients = [(image(x + dx, y + dy) - image(x - dx, y - dy)).ravel() for dx, dy in ((0.5, 0), (0, 0.5))]
    moved = 0.9 * image(x - 0.03, y + 0.02) + 4
    assert shift_px(moved.ravel(), expected.ravel(), *gradients) == pytest.approx((0.03, -0.02), abs=1e-3)


def test_psnr_of_known_images():
    black = np.zeros((4, 4), np.uint8)
    assert psnr_db(black, black) == np.inf
    assert psnr_db(black, black + 255) == 0
    assert psnr_db(black, black + 51) == pytest.approx(20 * np.log10(5))


def test_images_lie_on_their_truth(backend):
    assert truth_shift_px("none", backend) < 0.001


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
    files = ("--json", str(tmp_path / "a.json"), "--plot", str(tmp_path / "a.png"))
    assert run(monkeypatch, "bench", "accuracy", *effort, *settings, *files) == 0
    assert asked == [(load_config("eth3d", SMALL), 0, "auto", Effort(pairs=1, rays=500, repeats=1))]
    assert "**pfm**" in capsys.readouterr().out
    assert json.loads((tmp_path / "a.json").read_text())["command"].startswith("semisynth-gl bench accuracy --pairs 1")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--plot", "a.jpg"), "ends in .png"),
        (("--json", "nowhere/a.json"), "does not exist"),
        (("--config", "nobody"), "nobody"),
    ],
)
def test_wrong_arguments_are_refused_before_anything_is_measured(monkeypatch, capsys, arguments, expected):
    assert run(monkeypatch, "bench", "accuracy", *arguments) == 2
    captured = capsys.readouterr()
    assert expected in captured.err
    assert captured.out == ""
