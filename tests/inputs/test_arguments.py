"""Arguments of Python callers: wrong types, closed renderers, other threads and processes."""

import gc
import json
import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scenes import SQUARE, facing, noise_layers, one_model

from semisynth_gl import (
    Crop,
    Frame,
    PairRenderer,
    Renderer,
    StereoCamera,
    ViewArrays,
    calibrate,
    evaluate,
    load_config,
    make_mesh,
    make_scene,
    render_pair,
    score,
)
from semisynth_gl.inputs.arguments import to_whole
from semisynth_gl.inputs.errors import BackendError, InputError
from semisynth_gl.render.context import GraphicsContext

CONFIG = load_config(
    "kitti",
    ["camera.width_px=64", "camera.height_px=48", "textures.source=procedural", "textures.max_patches=2",
     "models.variants=1", "particles.layers=[{disparity_px: [2, 30], count: 3}]", "checks.attempts=1"],
)  # fmt: skip
CAMERA = StereoCamera.centred(40, 30, 40.0, 0.1)
LAYERS = noise_layers(1, 16)
SCENE = one_model(CAMERA, [facing(CAMERA, 0, 0, 40, 30, 2.0)])
IMAGE = np.zeros((30, 40, 3), np.uint8)
FRAME = Frame(
    CAMERA, ViewArrays({"image": IMAGE, "disparity": np.ones((30, 40), np.float32)}), ViewArrays({"image": IMAGE})
)


def scene(**changed):
    values = {"model": [0], "world_from_model": [np.eye(4)], "layer": [0]}
    return make_scene(**{"camera": CAMERA} | values | changed)


RIG = {"focal_px": 700.0, "baseline_m": 0.1, "size": (64, 48), "range_px": (2, 9)}

# Keys: the argument that the error must name; the command line shows its option instead.
WRONG = {
    "index": [lambda value: render_pair(CONFIG, value), ("0", 0.5, True, -1, 10**30)],
    "seed": [lambda value: PairRenderer(CONFIG, value), ("1", None, -1, 0.0)],
    "config": [lambda value: render_pair(value, 0), ("kitti", {"name": "kitti"})],
    "focal_px": [lambda value: StereoCamera(64, 48, value, 0.1, 0, 0, 0), ("40", None, np.inf, np.nan, 1e7, 1e-12)],
    "baseline_m": [lambda value: StereoCamera(64, 48, 40.0, value, 0, 0, 0), (None, 10**30, -0.1)],
    "cx_left_px": [lambda value: StereoCamera(64, 48, 40.0, 0.1, value, 0, 0), (np.nan, -1e7)],
    "width_px": [lambda value: StereoCamera(value, 48, 40.0, 0.1, 0, 0, 0), (0, 2.0, 2**31)],
    "height_px": [lambda value: Crop(0, 0, 5, value), (0, -3)],
    "world_from_model": [lambda value: scene(world_from_model=value), ("eye", [[1, 0], [1]], np.full((1, 4, 4), "1"))],
    "scene: world_from_model": [
        lambda value: scene(world_from_model=np.full((1, 4, 4), value)),
        (np.nan, np.inf, 1e12),
    ],
    "mesh m: positions": [lambda value: make_mesh("m", value, [[0, 0]], [[0, 0, 0]]), ("abc", [[0, 0, np.nan]])],
    "outputs": [lambda value: Renderer([SQUARE], LAYERS, outputs=value), ([3], [["depth"]], ["depht"])],
    "eye": [FRAME.view, ("middle", 0, np.arange(2))],
    "prediction": [lambda value: score(value, np.ones((4, 5), np.float32), "kitti"), ("a.pfm", [[1], [1, 2]])],
    "scale": [lambda value: calibrate("photos", **RIG, scale=value), ("half", 0, np.nan, np.inf)],
    "size": [lambda value: calibrate("photos", **RIG | {"size": value}), ((3, 4, 5), (3.5, 4))],
    "truth ": [lambda value: evaluate("tests", value), ("nowhere",)],
}


@pytest.mark.parametrize("argument", WRONG)
def test_an_unfit_argument_is_named(argument):
    use, values = WRONG[argument]
    for value in values:
        with pytest.raises(InputError) as error:
            use(value)
        assert error.value.argument == argument.strip(), value


def test_numbers_of_numpy_are_numbers(backend):
    crop = Crop(np.int64(3), np.uint8(2), np.int32(12), np.int16(10))
    camera = StereoCamera.centred(np.int64(40), np.int32(30), np.float32(40), np.float64(0.1))
    assert json.loads(json.dumps(camera.values())) == camera.values()
    assert StereoCamera.from_values(camera.values()) == camera
    # The camera converts numbers to float when it is made, and then computes in float64.
    assert camera.disparity_px(np.array([3.0]))[0] == float(np.float32(40)) * 0.1 / 3
    with Renderer([SQUARE], LAYERS, backend=backend, device_index=np.int64(0)) as renderer:
        image = renderer.render(scene(camera=camera, model=np.uint8([0]), layer=np.float64([0])), crop).left.image
    assert image.shape == (10, 12, 3)
    assert render_pair(CONFIG, np.int64(1), np.uint32(7), backend).left.image.shape == (48, 64, 3)


def test_a_released_renderer_says_so(backend):
    renderer = Renderer([SQUARE], LAYERS, backend=backend)
    renderer.render(SCENE)
    renderer.release()
    renderer.release()
    with pytest.raises(BackendError, match="released"):
        renderer.render(SCENE)
    with PairRenderer(CONFIG, 0, backend) as pairs:
        pass
    with pytest.raises(BackendError, match="released"):
        pairs.render(0)


def test_another_thread_is_refused(open_renderer):
    renderer = open_renderer([SQUARE], LAYERS)
    before = renderer.render(SCENE).left.image
    with ThreadPoolExecutor(1) as pool, pytest.raises(BackendError, match="another thread"):
        pool.submit(renderer.render, SCENE).result()
    np.testing.assert_array_equal(renderer.render(SCENE).left.image, before)


def test_a_renderer_that_nobody_released_is_freed_when_it_is_collected(backend, monkeypatch):
    freed = []
    release = GraphicsContext.release
    monkeypatch.setattr(GraphicsContext, "release", lambda context: (freed.append(context), release(context)))
    renderer = Renderer([SQUARE], LAYERS, backend=backend, antialias="ssaa2", outputs=["visibility"])
    renderer.render(SCENE)
    with Renderer([SQUARE], LAYERS, backend=backend) as other:
        expected = other.render(SCENE).left.image
        freed.clear()
        del renderer
        gc.collect()
        assert len(freed) == 1
        np.testing.assert_array_equal(other.render(SCENE).left.image, expected)
    assert len(freed) == 2


def test_a_forked_child_is_told_not_to_draw_with_its_parents_renderer(open_renderer):
    renderer = open_renderer([SQUARE], LAYERS)
    renderer.render(SCENE)
    child = os.fork()
    if child == 0:
        try:
            renderer.render(SCENE)
        except BackendError as error:
            os._exit(3 if "forked" in str(error) else 4)
        os._exit(5)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 3
    renderer.render(SCENE)


def test_a_message_names_only_the_limit_that_exists():
    with pytest.raises(InputError, match="number: must be 3 or less, got 4"):
        to_whole("number", 4, most=3)
