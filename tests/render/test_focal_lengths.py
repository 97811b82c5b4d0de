"""Cameras whose focal lengths differ in x and y: beside formulas, beside float64 rays, and in the files of datasets."""

import json
from dataclasses import replace

import numpy as np
import pytest
from planted_faults import checks
from scenes import noise_layers, on_plane, one_model
from tiny_datasets import cheap, with_lens

from semisynth_gl import oracle
from semisynth_gl.config import load_config
from semisynth_gl.config.dataset_sections import LAYOUTS
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.reader import open_dataset
from semisynth_gl.frame.camera import EYES, Deviation, StereoCamera
from semisynth_gl.frame.channels import OCCLUDED
from semisynth_gl.geometry.mesh import make_mesh
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.scene import make_scene, move

CAMERA = StereoCamera(96, 64, 90.0, 0.2, 46.0, 49.5, 30.0, fy_over_fx=1.25)
RATIO = {"camera": {"fy_over_fx": 1.02}}
PYRAMID = make_mesh(
    "pyramid",
    [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, -1]],
    [[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5]],
    [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]],
)
WALL = np.array([[9, 0.5, 0, -0.3], [0.4, 9, 0, 0.2], [1.5, 0.8, 0.6, 4.0], [0, 0, 0, 1]])
NEAR = np.array([[0.2, 0.08, 0, 0.15], [-0.12, 0.17, 0, -0.1], [0.02, 0, 0.2, 1.6], [0, 0, 0, 1]])
BOARD = np.array([[0.003, 0.15, 0, -0.2], [0.25, 0.001, 0, 0.1], [0, 0.1, 0.2, 1.2], [0, 0, 0, 1]])
# Spokes narrower than a pixel.
SPOKE = np.array([[0.001, 0.03, 0, -0.35], [0, 0.25, 0, 0], [0, 0.02, 0.001, 1], [0, 0, 0, 1]])
FENCE = [SPOKE + np.eye(4)[0, :, None] * np.array([0, 0, 0, 0.06 * k]) for k in range(12)]
POSES = np.stack([WALL, NEAR, BOARD, *FENCE])
CHANNELS = ("visibility", "instances", "depth", "normals", "flow", "flow_backward")


def pyramids(camera, stretch=1.0, poses=POSES):
    """Pyramids that move, and that are ``stretch`` times as high; their patches are finer than pixels."""
    higher, number = np.diag([1, stretch, 1, 1]), len(poses)
    layer = [0] + [1] * (number - 1)
    scene = make_scene(camera, model=[0] * number, world_from_model=higher @ poses, layer=layer, uv_scale=6.0)
    later = poses + np.array([[[0, 0, 0, 0.03], [0.01, 0, 0, -0.02], [0, 0, 0, 0.1], [0, 0, 0, 0]]])
    return scene, move(scene, world_from_model=higher @ later)


@pytest.mark.parametrize("ratio", [0.8, 1.25])
@pytest.mark.parametrize("normal", [(0, 0, 1), (0.5, 0.2, 1), (-0.3, -0.6, 1)])
def test_planes_have_the_disparity_of_fx_and_the_rows_of_fy(open_renderer, square, normal, ratio):
    camera, (a, b, c) = replace(CAMERA, fy_over_fx=ratio), normal
    scene = one_model(camera, [on_plane(normal, 3.0, 10.0)])
    frame = open_renderer([square], noise_layers(1, 16), outputs=("depth", "normals")).render(scene)
    row, column = np.mgrid[:64, :96].astype(float)
    for eye, cx, x_m in (("left", 46.0, 0.0), ("right", 49.5, 0.2)):
        depth = (3 * c - a * x_m) / (a * (column - cx) / 90 + b * (row - 30) / (90 * ratio) + c)
        view = frame.view(eye)
        seen = (depth > 0.5) & (depth < 10) & (np.abs((row - 30) / (90 * ratio) * depth) < 9)
        seen &= np.abs((column - cx) / 90 * depth + x_m) < 9
        assert seen.mean() > 0.5
        expected = 90 * 0.2 / depth - 3.5
        valid = seen & (expected > 1e-3)
        np.testing.assert_allclose(view.disparity[valid], expected[valid], atol=1e-4)
        assert np.isposinf(view.disparity[seen & (expected < -1e-3)]).all()
        np.testing.assert_allclose(view.depth[seen], depth[seen], rtol=1e-5)
        unit = -np.array(normal) / np.linalg.norm(normal)
        np.testing.assert_allclose(view.normals[seen], np.broadcast_to(unit, (seen.sum(), 3)), atol=1e-6)


@pytest.mark.parametrize("ratio", [0.6, 1.8])
@pytest.mark.parametrize("antialias", ["none", "edges", "ssaa2"])
@pytest.mark.parametrize("deviation", [Deviation(), Deviation(y_px=2.3, focal_ratio=1.02)], ids=["rectified", "other"])
def test_a_scene_stretched_as_much_is_the_same_through_square_pixels(open_renderer, ratio, antialias, deviation):
    outputs = (*CHANNELS, "correspondence")
    rectified = deviation == Deviation()
    renderer = open_renderer([PYRAMID], noise_layers(2, 32), outputs=outputs, antialias=antialias, rectified=rectified)
    frames = []
    for fy_over_fx, stretch in ((ratio, 1.0), (1.0, ratio)):
        scene, motion = pyramids(replace(CAMERA, fy_over_fx=fy_over_fx, deviation=deviation), stretch)
        frames.append(renderer.render(scene, future=motion, past=motion))
    found, expected = frames
    few = 4  # pixels in which rounding decides
    for eye in EYES:
        own, other = found.view(eye), expected.view(eye)
        assert len(np.unique(own.instances)) > 6
        assert (own.visibility == OCCLUDED).sum() > 100
        same = own.instances == other.instances
        assert (~same).sum() <= few
        for name in ("disparity", "depth", "flow", "flow_backward", "correspondence"):
            assert (np.isfinite(own[name]) != np.isfinite(other[name])).sum() <= few
            both = np.isfinite(own[name]) & np.isfinite(other[name])
            both &= same if both.ndim == 2 else same[..., None]
            np.testing.assert_allclose(own[name][both], other[name][both], rtol=2e-5, atol=2e-4, err_msg=name)
        for name in ("visibility", "flow_visibility", "flow_backward_visibility"):
            assert (own[name] != other[name]).sum() <= few, name
        assert (np.abs(own.image.astype(int) - other.image).max(axis=2) > 2).sum() <= few


@pytest.mark.parametrize("deviation", [Deviation(), Deviation(0.03, -0.02, 1.7, 0.98)], ids=["rectified", "deviating"])
def test_truth_is_what_rays_say(open_renderer, deviation):
    rectified = deviation == Deviation()
    outputs = ("visibility", "instances", "normals", "flow", *(() if rectified else ("correspondence",)))
    scene, motion = pyramids(replace(CAMERA, deviation=deviation), poses=POSES[:3])
    frame = open_renderer([PYRAMID], noise_layers(2, 16), outputs=outputs, rectified=rectified).render(
        scene, future=motion
    )
    y, x = (each.ravel().astype(float) for each in np.mgrid[:64, :96])
    for eye in EYES:
        view = frame.view(eye)
        hits = cast_rays(scene, [PYRAMID], eye, x, y)
        same = view.instances.ravel() == hits.instance + 1
        assert same.mean() > 0.995
        normals = oracle.normals(scene, [PYRAMID], eye, hits)
        same &= np.abs(view.normals.reshape(-1, 3) - normals).max(axis=1) < 1e-4  # the same triangle, too
        assert same.mean() > 0.99
        way = oracle.correspondence_px(scene.camera, eye, x, y, hits)
        disparity = oracle.disparity_of(eye, way)
        np.testing.assert_allclose(view.disparity.ravel()[same], disparity[same], atol=2e-4)
        if not rectified:
            np.testing.assert_allclose(view.correspondence.reshape(-1, 2)[same], way[same], atol=2e-4)
        mask = oracle.visibility(scene, [PYRAMID], eye, x, y, hits)
        assert (mask == view.visibility.ravel())[same].mean() > 0.995
        flows = oracle.flow(scene, [PYRAMID], motion, eye, x, y, hits)
        np.testing.assert_allclose(view.flow.reshape(-1, 2)[same], flows.flow_px[same], atol=5e-4)
        assert (flows.visibility == view.flow_visibility.ravel())[same].mean() > 0.995


@pytest.mark.parametrize("kind", ["plane", "street", "cuboid", "room"])
@pytest.mark.parametrize(
    ("ratio", "rig"),
    [
        (0.6, {}),
        (1.7, {}),
        (1.0, {"focal_ratio": 1.2, "twin": True}),
        (1.0, {"right_pitch_deg": 5, "right_roll_deg": 5}),
        (1.0, {"right_pitch_deg": -5}),
    ],
    ids=["wide", "high", "twin", "up", "down"],
)
def test_backgrounds_close_what_the_views_show(kind, ratio, rig):
    shares = {name: float(name == kind) for name in ("plane", "street", "cuboid", "room")}
    config = cheap(
        rig=rig,
        camera={"focal_px": 45, "fy_over_fx": ratio},
        outputs=["depth"],
        disparity={"min_px": 2, "max_px": 20, "target": {"form": "uniform"}},
        particles={"layers": []},
        background={**shares, "plane_disparity_px": 4, "wall_disparity_px": [8, 14]},
        checks={"min_valid": 0},
    )
    with PairRenderer(config, 1) as pairs:
        for index in range(6):
            frame = pairs.render(index).frame
            for eye in EYES:
                assert np.isfinite(frame.view(eye).depth).all(), (index, eye)
                disparity = frame.view(eye).disparity
                assert disparity[np.isfinite(disparity)].max() <= 20 * (1 + 1e-5)


# --- configs and files ---


def test_a_ratio_of_1_is_the_config_without_it():
    plain = load_config("kitti")
    assert load_config("kitti", ["camera.fy_over_fx=1"]).digest() == plain.digest()
    assert "fy_over_fx" not in plain.model_dump(mode="json")["camera"]
    wide = load_config("kitti", ["camera.fy_over_fx=1.02"])
    assert wide.digest() != plain.digest()
    assert {recipe.config.camera.fy_over_fx for recipe in wide.recipes()} == {1.02}
    assert load_config("kitti", ["camera.fy_over_fx=1.02", "scale=0.5"]).camera.fy_over_fx == 1.02


@pytest.mark.parametrize("ratio", ["0.4", "2.1", "[1, 1.1]"])
def test_impossible_ratios_are_refused(ratio):
    with pytest.raises(InputError, match="fy_over_fx"):
        load_config("kitti", [f"camera.fy_over_fx={ratio}"])


@pytest.mark.parametrize("values", [{"fy_over_fx": 0}, {"focal_px": 9e5, "fy_over_fx": 1.5}])
def test_impossible_cameras_are_refused(values):
    with pytest.raises(InputError, match=r"fy_over_fx|focal_y_px"):
        replace(CAMERA, **values)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_datasets_tell_both_focal_lengths_and_nothing_is_found(tmp_path, layout):
    generate(cheap(**RATIO), tmp_path / "out", 2, 1, layout=layout)
    assert checks(tmp_path / "out", rays=200) == set()
    for pair in open_dataset(tmp_path / "out"):
        assert pair.provenance["camera"]["fy_over_fx"] == 1.02
        assert pair.camera.focal_px == 131.25
        assert pair.camera.focal_y_px == pytest.approx(1.02 * 131.25, rel=1e-15)
        points = pair.points("left")
        np.testing.assert_allclose(points[40, 30, 1] / points[40, 30, 2], (40 - pair.camera.cy_px) / 133.875, rtol=1e-6)


@pytest.mark.parametrize("key", ["rig", "lens"])
def test_nothing_is_found_in_pairs_that_deviate_or_went_through_a_lens(tmp_path, key):
    if key == "lens":
        pytest.importorskip("cv2", reason="OpenCV, the extra opencv, is not installed")
        config = with_lens(**RATIO, outputs=["visibility", "valid", "raw", "raw_map"])
    else:
        rig = {"right_roll_deg": [-1, 1], "right_y_px": [-2, 2], "focal_ratio": [0.99, 1.01]}
        config = cheap(**RATIO, rig=rig, outputs=["visibility", "correspondence", "normals", "flow"],
                       sequence={"length": 2})  # fmt: skip
    generate(config, tmp_path / "out", 4, 1)
    assert checks(tmp_path / "out", rays=200) == set()


def test_a_wrong_fy_is_found(tmp_path):
    generate(cheap(**RATIO), tmp_path / "out", 1, 1)
    (calib,), (record,) = (list((tmp_path / "out").rglob(name)) for name in ("calib.txt", "pair.json"))
    text, values = calib.read_text(), json.loads(record.read_text("utf-8"))
    fy = repr(131.25 * 1.02)
    assert text.count(fy) == 2
    for ratio in (1.0, 1.021):
        calib.write_text(text.replace(fy, repr(131.25 * ratio)))
        assert checks(tmp_path / "out") == {"calib"}
        # Where both are wrong, the config's scene has another camera.
        values["camera"] |= {"fy_over_fx": ratio}
        record.write_text(json.dumps(values), "utf-8")
        assert checks(tmp_path / "out") == set()
        assert checks(tmp_path / "out", rays=50) == {"oracle"}
    del values["camera"]["fy_over_fx"]
    record.write_text(json.dumps(values), "utf-8")
    calib.write_text(text.replace(fy, "131.25"))
    assert checks(tmp_path / "out", rays=50) == {"oracle"}


def test_pixels_of_another_shape_do_not_change_how_much_is_seen():
    """The same field of view down, in more or fewer rows, shows as many particles."""
    covered = []
    for ratio, rows in ((1.0, 48), (2.0, 95)):
        config = cheap(camera={"fy_over_fx": ratio, "height_px": rows, "cy_px": (rows - 1) / 2})
        with (
            PairRenderer(config, 3) as pairs,
            Renderer(pairs.sampler.models, pairs.sources.atlas.layers, outputs=("instances",)) as renderer,
        ):
            frames = [renderer.render(pairs.sampler.sample(index).scene) for index in range(40)]
        covered.append(np.mean([(frame.left.instances > 6).mean() for frame in frames]))
    assert covered[1] == pytest.approx(covered[0], rel=0.15)
