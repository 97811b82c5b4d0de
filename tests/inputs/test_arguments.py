"""What callers in Python hand in: wrong types, closed renderers, other threads and processes."""

import gc
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from itertools import count

import numpy as np
import pytest
from hand_made_datasets import write_dataset
from scenes import facing, noise_layers

from semisynth_gl import (
    Crop,
    Frame,
    PairRenderer,
    Renderer,
    StereoCamera,
    View,
    calibrate,
    compare,
    evaluate,
    generate,
    load_config,
    make_mesh,
    make_model,
    make_scene,
    move,
    open_dataset,
    render_pair,
    report,
    score,
    verify,
)
from semisynth_gl.frame.channels import DRAWN_OUTPUTS
from semisynth_gl.inputs.errors import BackendError, InputError
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.targets import EyeTargets

CONFIG = load_config(
    "kitti",
    ["camera.width_px=64", "camera.height_px=48", "textures.source=procedural", "textures.max_patches=2",
     "models.variants=1", "particles.layers=[{disparity_px: [2, 30], count: 3}]", "checks.attempts=1"],
)  # fmt: skip
CAMERA = StereoCamera.centred(40, 30, 40.0, 0.1)
SQUARE = make_mesh("square", [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 0], [1, 0], [1, 1], [0, 1]], [[0, 1, 2], [0, 2, 3]])  # fmt: skip # noqa: E501
LAYERS = noise_layers(1, 16)
SCENE = make_scene(CAMERA, model=[0], world_from_model=[facing(CAMERA, 0, 0, 40, 30, 2.0)], layer=[0])


TRUTH = np.ones((4, 5), np.float32)
IMAGE = np.zeros((30, 40, 3), np.uint8)
FRAME = Frame(CAMERA, View({"image": IMAGE, "disparity": np.ones((30, 40), np.float32)}), View({"image": IMAGE}))


class Hostile:
    """Of no use, and fails when it is shown or made an array."""

    def __repr__(self):
        raise RuntimeError("not shown")

    def __array__(self, *_args, **_options):
        raise RuntimeError("no array")


def DATASET(out):  # noqa: N802 - as a constant of the cases
    write_dataset(out.parent / "there", "middlebury", {"train": 1}, 1)
    return open_dataset(out.parent / "there")


def scene(**changed):
    values = {"model": [0], "world_from_model": [np.eye(4)], "layer": [0]}
    return make_scene(**{"camera": CAMERA} | values | changed)


RIG = {"focal_px": 700.0, "baseline_m": 0.1, "size": (64, 48), "range_px": (2, 9)}

WRONG = {
    "config by name": lambda _: render_pair("kitti", 0),
    "config as a mapping": lambda _: PairRenderer({"name": "kitti"}, 0),
    "index as text": lambda _: render_pair(CONFIG, "0"),
    "fractional index": lambda _: render_pair(CONFIG, 0.5),
    "index that is a truth value": lambda _: render_pair(CONFIG, index=True),
    "seed as text": lambda _: render_pair(CONFIG, 0, "1"),
    "no seed": lambda _: PairRenderer(CONFIG, None),
    "split by name": lambda _: PairRenderer(CONFIG, "train"),
    "calibration of a number": lambda _: calibrate("photos", calib=3),
    "scale as text": lambda _: calibrate("photos", **RIG, scale="half"),
    "scale of nothing": lambda _: calibrate("photos", **RIG, scale=0),
    "range of one number": lambda _: calibrate("photos", **RIG | {"range_px": 3}),
    "range of text": lambda _: calibrate("photos", **RIG | {"range_px": ("2", "9")}),
    "size of three": lambda _: calibrate("photos", **RIG | {"size": (3, 4, 5)}),
    "focal length as text of a rig": lambda _: calibrate("photos", **RIG | {"focal_px": "700"}),
    "name of a number": lambda _: calibrate("photos", **RIG, name=3),
    "one photograph for two eyes": lambda _: calibrate("photos", **RIG, pairs=[("left",)]),
    "photographs of a number": lambda out: compare(out, 3),
    "width as text": lambda out: compare(out, "photos", width_px="256"),
    "sample of none": lambda out: compare(out, "photos", sample=0),
    "dataset to verify of a number": lambda _: verify(3),
    "rays as text": lambda out: verify(out, pixels="5"),
    "report of a number": lambda _: report(3),
    "half a pair to show": lambda out: report(out, pairs=0.5),
    "unknown backend": lambda _: render_pair(CONFIG, 0, backend=3),
    "fractional crop": lambda _: Crop(0, 0, 12.5, 10),
    "crop of text": lambda _: Crop("0", "0", "12", "10"),
    "empty crop": lambda _: Crop(0, 0, 0, 10),
    "crop of a tuple": lambda _: CAMERA.cropped((0, 0, 12, 10)),
    "fractional image": lambda _: StereoCamera.centred(64.5, 48, 40.0, 0.1),
    "image of text": lambda _: StereoCamera("64", 48, 40.0, 0.1, 0, 0, 0),
    "focal length of text": lambda _: StereoCamera(64, 48, "40", 0.1, 0, 0, 0),
    "no baseline": lambda _: StereoCamera(64, 48, 40.0, None, 0, 0, 0),
    "nan": lambda _: StereoCamera(64, 48, 40.0, 0.1, float("nan"), 0, 0),
    "huge baseline": lambda _: StereoCamera(64, 48, 40.0, 10**400, 0, 0, 0),
    "huge negative index": lambda _: render_pair(CONFIG, -(10**5000)),
    "infinite focal length": lambda _: StereoCamera(64, 48, float("inf"), 0.1, 0, 0, 0),
    "camera of a tuple": lambda _: scene(camera=(64, 48)),
    "fractional model": lambda _: scene(model=[0.5]),
    "model by name": lambda _: scene(model=["square"]),
    "ragged matrices": lambda _: scene(world_from_model=[[1, 0], [1]]),
    "matrices of text": lambda _: scene(world_from_model="eye"),
    "layer of none": lambda _: scene(layer=[None]),
    "three values of uv": lambda _: scene(uv_scale=(1, 2, 3)),
    "pose of text": lambda _: scene(camera_from_world="eye"),
    "near plane of text": lambda _: scene(near_m="0.1"),
    "motion of no scene": lambda _: move("scene"),
    "motion of ragged poses": lambda _: move(SCENE, world_from_model=[[1], [1, 2]]),
    "positions of text": lambda _: make_mesh("m", "abc", [[0, 0]], [[0, 0, 0]]),
    "ragged uv": lambda _: make_mesh("m", [[0, 0, 0]], [[0], [0, 0]], [[0, 0, 0]]),
    "four indices": lambda _: make_mesh("m", [[0, 0, 0]], [[0, 0]], [0, 0, 0, 0]),
    "fractional indices": lambda _: make_mesh("m", [[0, 0, 0]], [[0, 0]], [[0, 0.5, 0]]),
    "models by name": lambda _: Renderer("square", LAYERS),
    "one model": lambda _: Renderer(SQUARE, LAYERS),
    "a model by name": lambda _: Renderer(["square"], LAYERS),
    "layers as a list": lambda _: Renderer([SQUARE], LAYERS.tolist()),
    "outputs as one text": lambda _: Renderer([SQUARE], LAYERS, outputs="depth"),
    "outputs as a number": lambda _: Renderer([SQUARE], LAYERS, outputs=3),
    "outputs of numbers": lambda _: Renderer([SQUARE], LAYERS, outputs=[3]),
    "truth as a number": lambda _: Renderer([SQUARE], LAYERS, truth=1),
    "antialias as a number": lambda _: Renderer([SQUARE], LAYERS, antialias=4),
    "anisotropy of a half": lambda _: Renderer([SQUARE], LAYERS, anisotropy=2.5),
    "device as text": lambda _: Renderer([SQUARE], LAYERS, device_index="0"),
    "config as a number": lambda _: load_config(3),
    "override that is one text": lambda _: load_config("kitti", "camera.width_px=64"),
    "override that is a number": lambda _: load_config("kitti", 3),
    "override of three": lambda _: load_config("kitti", [("camera", "width_px", 64)]),
    "override that is a number among others": lambda _: load_config("kitti", ["camera.width_px=64", 3]),
    "override of a key that is a number": lambda _: load_config("kitti", {3: 4}),
    "override that is a section's": lambda _: load_config("kitti", {"camera": 4}),
    "override of an array": lambda _: load_config("kitti", {"camera.width_px": np.arange(2)}),
    "override of an object": lambda _: load_config("kitti", {"camera.width_px": object()}),
    "dataset of a config's name": lambda out: generate("kitti", out, 1),
    "fractional pairs": lambda out: generate(CONFIG, out, 0.5),
    "pairs as text": lambda out: generate(CONFIG, out, "3"),
    "pairs of an unknown split": lambda out: generate(CONFIG, out, {"train": 1, "valid": 1}),
    "GPUs as text": lambda out: generate(CONFIG, out, 3, gpus="0"),
    "GPUs as a number": lambda out: generate(CONFIG, out, 3, gpus=0),
    "listener of text": lambda out: generate(CONFIG, out, 3, listener="loud"),
    "empty shards": lambda out: generate(CONFIG, out, 3, shard_pairs=0),
    "fractional shards": lambda out: generate(CONFIG, out, 3, shard_pairs=1.5),
    "unknown layout": lambda out: generate(CONFIG, out, 3, layout=3),
    "shards as a pair": lambda out: generate(CONFIG, out, 3, shards=(0, 1)),
    "engine by name": lambda out: generate(CONFIG, out, 3, engine="local"),
    "place of a number": lambda _: generate(CONFIG, 3, 3),
    "dataset of a number": lambda _: open_dataset(3),
    "dataset of nothing": lambda _: open_dataset(None),
    "split of no name": lambda out: write_dataset(out.parent / "there", "middlebury", {"train": 1}, 1)
    and open_dataset(out.parent / "there", 3),
    "points of no view": lambda _: FRAME.points("middle"),
    "points of a number": lambda _: FRAME.points(0),
    "points of a view without disparity": lambda _: FRAME.points("right"),
    "score of text": lambda _: score("a.pfm", TRUTH, "kitti"),
    "score of a row": lambda _: score(TRUTH[0], TRUTH, "kitti"),
    "score of ragged rows": lambda _: score([[1], [1, 2]], TRUTH, "kitti"),
    "score by an unknown protocol": lambda _: score(TRUTH, TRUTH, "nuscenes"),
    "score by a number": lambda _: score(TRUTH, TRUTH, 3),
    "score in a mask of text": lambda _: score(TRUTH, TRUTH, "kitti", mask="visible"),
    "score within limits of a number": lambda _: score(TRUTH, TRUTH, "kitti", limits=64),
    "predictions of a number": lambda out: evaluate(3, out),
    "truth of nothing": lambda out: evaluate(out, None),
    "masks of a number": lambda out: evaluate(out, out, masks=3),
    "index that no float counts to": lambda _: render_pair(CONFIG, 10**30),
    "backend as an array": lambda _: render_pair(CONFIG, 0, backend=np.arange(2)),
    "image that no int32 counts": lambda _: StereoCamera.centred(10**400, 48, 40.0, 0.1),
    "side as text": lambda _: StereoCamera.centred("64", 48, 40.0, 0.1),
    "doffs as text": lambda _: StereoCamera.centred(64, 48, 40.0, 0.1, "0"),
    "layer that makes no array": lambda _: scene(layer=Hostile()),
    "mesh without a name": lambda _: make_mesh(Hostile(), [[0, 0, 0]], [[0, 0]], [[0, 0, 0]]),
    "model without a name": lambda _: make_model(None, [[0, 0, 0]], [[0, 0, 0]]),
    "output that is a list": lambda _: Renderer([SQUARE], LAYERS, outputs=[["depth"]]),
    "crop of a frame of a tuple": lambda _: FRAME.cropped((0, 0, 4, 4)),
    "points of an array": lambda _: FRAME.points(np.arange(2)),
    "view of a number": lambda _: View(3),
    "frame of a list": lambda _: Frame.from_arrays(CAMERA, [IMAGE, IMAGE]),
    "pair as text": lambda out: DATASET(out)["0"],
    "pair of a half": lambda out: DATASET(out).pair(np.float32(0.5)),
    "split that is a list": lambda out: open_dataset(DATASET(out).about.address, ["train"]),
    "folder without a name": lambda _: load_config("kitti", {"textures.images": [""]}),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_argument_is_an_error_at_once(case, tmp_path):
    with pytest.raises(InputError) as error:
        WRONG[case](tmp_path / "out")
    assert "got " in str(error.value)
    assert not (tmp_path / "out").exists()


def test_numbers_of_numpy_are_numbers(backend):
    crop = Crop(np.int64(3), np.uint8(2), np.int32(12), np.int16(10))
    camera = StereoCamera.centred(np.int64(40), np.int32(30), np.float32(40), np.float64(0.1))
    assert {type(value) for value in camera.values().values()} == {int, float}
    assert json.loads(json.dumps(camera.values())) == camera.values()
    assert StereoCamera.from_values(camera.values()) == camera
    # Rounded to float32 once, when it is made, and never in what it works out.
    assert camera.disparity_px(np.array([3.0]))[0] == float(np.float32(40)) * 0.1 / 3
    assert {type(getattr(crop, name)) for name in ("x_px", "y_px", "width_px", "height_px")} == {int}
    with Renderer([SQUARE], LAYERS, backend=backend, device_index=np.int64(0)) as renderer:
        image = renderer.render(scene(camera=camera, model=np.uint8([0]), layer=np.float64([0])), crop).left.image
    assert image.shape == (10, 12, 3)
    assert render_pair(CONFIG, np.int64(1), np.uint32(7), backend).left.image.shape == (48, 64, 3)


def test_a_renderer_refuses_what_is_no_scene_and_no_crop(open_renderer):
    renderer = open_renderer([SQUARE], LAYERS)
    for arguments in ((None,), (CONFIG,), (SCENE, (0, 0, 4, 4)), (SCENE, 3), (SCENE, None, 3), (SCENE, None, SCENE)):
        with pytest.raises(InputError, match=r"must be a (Scene|Crop or None|Motion or None), got"):
            renderer.render(*arguments[:2], **dict(zip(["future"], arguments[2:], strict=False)))
    with (
        PairRenderer(CONFIG, 0, renderer.backend) as pairs,
        pytest.raises(InputError, match="must be a Crop or None, got"),
    ):
        pairs.render(0, crop=(0, 0, 4, 4))


def test_a_crop_of_the_whole_image_is_the_image(backend):
    whole = Crop(0, 0, CONFIG.camera.width_px, CONFIG.camera.height_px)
    with PairRenderer(CONFIG, 0, backend) as pairs:
        expected = pairs.render(0).frame
        for checked in (True, False):
            frame = pairs.render(0, crop=whole, checked=checked).frame
            for role, array in frame.arrays().items():
                np.testing.assert_array_equal(array, expected.arrays()[role])


def test_a_released_renderer_says_so(backend):
    renderer = Renderer([SQUARE], LAYERS, backend=backend)
    renderer.render(SCENE)
    renderer.release()
    renderer.release()
    for use in (lambda: renderer.render(SCENE), renderer.count_objects):
        with pytest.raises(BackendError, match="was released: open another"):
            use()
    with PairRenderer(CONFIG, 0, backend) as pairs:
        pass
    with pytest.raises(BackendError, match="was released: open another"):
        pairs.render(0)


def test_another_thread_is_refused(open_renderer):
    renderer = open_renderer([SQUARE], LAYERS)
    before = renderer.render(SCENE).left.image
    with ThreadPoolExecutor(1) as pool, pytest.raises(BackendError, match=r"opened in another thread.*in each"):
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


FORKED = """
import os, sys
sys.path[:0] = ["tests", "tests/inputs"]
from test_arguments import LAYERS, SCENE, SQUARE
from semisynth_gl import Renderer
renderer = Renderer([SQUARE], LAYERS)
renderer.render(SCENE)
child = os.fork()
if child == 0:
    try:
        renderer.render(SCENE)
    except Exception as error:
        print(type(error).__name__, error, flush=True)
    renderer.release()
    del renderer
    os._exit(3)
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 3
renderer.render(SCENE)
print("the parent draws on", flush=True)
"""


def test_a_forked_child_is_told_not_to_draw_with_its_parents_renderer(pytestconfig):
    done = subprocess.run(
        [sys.executable, "-c", FORKED],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
        cwd=pytestconfig.rootpath,
    )
    refused, parent = done.stdout.splitlines()
    assert refused.startswith("BackendError this process was forked from the one that opened")
    assert parent == "the parent draws on"


@pytest.mark.parametrize("refused", ["flow", "right eye"])
def test_a_size_that_is_refused_midway_leaves_the_renderer_as_it_was(open_renderer, monkeypatch, refused):
    outputs = [output for output in DRAWN_OUTPUTS if output not in {"flow_backward", "normals"}]
    renderer = open_renderer([SQUARE], LAYERS, antialias="ssaa2", outputs=outputs)
    draw = lambda scene: renderer.render(scene, future=move(scene))  # noqa: E731
    before = {role: array.tobytes() for role, array in draw(SCENE).arrays().items()}
    objects = renderer.count_objects()
    larger = StereoCamera.centred(60, 50, 40.0, 0.1)
    other = scene(camera=larger, world_from_model=[facing(larger, 0, 0, 60, 50, 2.0)])

    def refuse(*_args, **_options):
        raise BackendError("no room")

    with monkeypatch.context() as patch:
        if refused == "flow":
            patch.setattr("semisynth_gl.render.pair_targets.Targets", refuse)
        else:
            made = count()
            patch.setattr(
                "semisynth_gl.render.pair_targets.EyeTargets",
                lambda *args, **options: refuse() if next(made) else EyeTargets(*args, **options),
            )
        with pytest.raises(BackendError, match="no room"):
            draw(other)
    assert {role: array.tobytes() for role, array in draw(SCENE).arrays().items()} == before
    draw(other)
    draw(SCENE)
    assert renderer.count_objects() == objects
