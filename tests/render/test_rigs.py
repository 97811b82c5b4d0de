"""Scenes and pairs of deviating cameras, several baselines, non-square pixels and signed disparities."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from recorder import Recorder
from scene_table import CAMERA
from scenes import SQUARE, assert_equal, facing, noise_layers, one_model
from test_exactness import project
from tiny_datasets import cheap

from semisynth_gl.config import Config, Range, load_config
from semisynth_gl.config.rig_sections import CameraSection
from semisynth_gl.config.scene_sections import ParticlesSection
from semisynth_gl.frame.camera import CameraDeviation, Crop, StereoCamera
from semisynth_gl.frame.channels import OCCLUDED, RENDERED_OUTPUTS
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.mix import RecipeMixSampler
from semisynth_gl.scene.particles import ParticleSlots, sample_generation
from semisynth_gl.scene.rig import SequenceRig, near_depth_m, sample_cameras
from semisynth_gl.scene.sources import prepare_sources
from semisynth_gl.scene.view_volume import vertical_view_limits
from semisynth_gl.seeds.seeds import Purpose, generator
from semisynth_gl.seeds.splits import Split

ROOT = Path(__file__).resolve().parents[2]
SEVERAL, SEED = [0.4, 1.0, 0.7], 3
SMALL = (
    *("scenes=[]", "camera.cx_left_px=null", "camera.cx_right_px=null", "camera.cy_px=null", "models.variants=1"),
    *("camera.width_px=120", "camera.height_px=80", "camera.focal_px=110", "camera.baseline_m=0.4", "models.complex=0"),
    *("textures.max_patches=16", "textures.source=procedural", "textures.large_px=0", "background.cuboid=0"),
    *("background.room=0", "checks.min_valid=0", "disparity.target={form: uniform}"),
)


def several(baselines=SEVERAL, camera=None, **changes):
    """Make a config like `cheap` with several baselines and a swaying camera."""
    values = cheap().model_dump(mode="json")
    values["camera"] |= {"sway_m": 0.02, "sway_deg": 1.0, "baselines": baselines} | (camera or {})
    if isinstance(baselines, list):
        del values["camera"]["baseline_m"]
    return Config.model_validate(values | changes)


def open_scenes(doffs_px=0.0, sky=0.0, *, signed=True, outputs=(), more=None):
    """Make a config of open scenes with few models, where points at infinity have the disparity -doffs."""
    lowest = 3 - doffs_px if signed else max(2.0, 3 - doffs_px)
    keys = {
        "camera.doffs_px": doffs_px,
        "disparity.signed": signed,
        "disparity.min_px": lowest,
        "disparity.max_px": lowest + 37,
        "background.plane": 1.0,
        "background.street": 0.0,
        "background.plane_disparity_px": lowest - 1.5,
        "background.sky": sky,
        "particles.size_px": [8, 24],
        "particles.layers": [{"count": 16, "disparity_px": [lowest, lowest + 20]}],
    }
    return load_config("kitti", [*SMALL, *(keys | (more or {})).items()]).model_copy(update={"outputs": outputs})


# Cameras

ANGLES = st.floats(-0.1, 0.1)


@settings(max_examples=60)
@example(0.0, -0.099609375, 0.0, 0.90234375, 0.0, 1.0, 320)
@given(
    ANGLES, ANGLES, st.floats(-20, 20), st.floats(0.9, 1.1), st.floats(-30, 30), st.floats(0.5, 2),
    st.integers(0, 2**31),
)  # fmt: skip
def test_correspondence_and_depth_are_inverse_and_limits_hold(roll, pitch, down, ratio, doffs, aspect, seed):
    camera = StereoCamera(
        640, 480, 700.0, 0.3, 310.0, 310.0 + doffs, 250.0, CameraDeviation(roll, pitch, down, ratio), aspect
    )
    rng = np.random.default_rng(seed)
    x, y, depth = rng.uniform(0, 639, 50), rng.uniform(0, 479, 50), rng.uniform(0.5, 50, 50)
    way = camera.correspondence("left", x, y, depth)
    there, depth_there = project(camera, "right", camera.rays("left", x, y) * depth[:, None])
    np.testing.assert_allclose(np.stack([x, y], axis=1) + way, there, atol=1e-8)
    np.testing.assert_allclose(camera.depth_at("left", x, y, -way[:, 0]), depth, rtol=1e-8)
    back = camera.correspondence("right", *there.T, depth_there)
    np.testing.assert_allclose(back, -way, atol=1e-8)
    np.testing.assert_allclose(camera.depth_at("right", *there.T, back[:, 0]), depth_there, rtol=1e-8)
    far = camera.correspondence("left", x, y, np.full(50, np.inf))
    beyond = project(camera, "right", camera.rays("left", x, y) * 1e12)[0]
    np.testing.assert_allclose(np.stack([x, y], axis=1) + far, beyond, atol=1e-6)
    assert StereoCamera.from_values(camera.values()) == camera
    # At the near plane, the left view, the right view and the rectified twin have at most 300 px, and one reaches it.
    section = load_config("middlebury").disparity.model_copy(update={"min_px": 150.0, "max_px": 300.0})
    near_m = near_depth_m(camera, section)
    x, y = (each.ravel() for each in np.meshgrid(np.linspace(-0.5, 639.5, 33), np.linspace(-0.5, 479.5, 33)))
    left = (-camera.correspondence("left", x, y, np.full(len(x), near_m))[:, 0]).max()
    right = camera.correspondence("right", x, y, near_m / camera.rays("right", x, y)[:, 2])[:, 0].max()
    assert 300 - 1e-1 <= max(left, right, camera.disparity_px(near_m).item()) <= 300 + 1e-3


@pytest.mark.parametrize(
    ("focal_px", "said"),
    [(100.0, r"max_px: 30 px .* up to \d+\.\d+ px: raise"), (30.0, "leaves no depth .* up to nan px: raise")],
)
def test_a_deviation_that_takes_the_largest_disparity_is_refused(focal_px, said):
    camera = StereoCamera(640, 480, focal_px, 0.1, 320, 320, 240, CameraDeviation(0.1, 0.17))
    section = load_config("middlebury").disparity.model_copy(update={"min_px": 5.0, "max_px": 30.0})
    with pytest.raises(InputError, match=said):
        near_depth_m(camera, section)


@pytest.mark.parametrize(
    "make",
    [
        lambda: CameraDeviation(roll_rad=0.2),
        lambda: CameraDeviation(pitch_rad=-1),
        lambda: CameraDeviation(focal_ratio=1.3),
        lambda: replace(CAMERA, fy_over_fx=0),
        lambda: replace(CAMERA, focal_px=9e5, fy_over_fx=2),
        lambda: one_model(CAMERA, [np.eye(4)], sky=[True, False]),
        lambda: load_config("kitti", ["camera.fy_over_fx=0.4"]),
        lambda: load_config("kitti", ["camera.fy_over_fx=2.1"]),
        lambda: load_config("kitti", ["camera.fy_over_fx=[1, 1.1]"]),
        lambda: load_config("middlebury", ["rig.twin=true"]),
        lambda: load_config("sceneflow", ["rig.right_y_px=1", "outputs=[disparity_change]", "sequence.length=2"]),
        lambda: Renderer([SQUARE], noise_layers(1, 16), outputs=["disparity_change"], rectified=False),
    ],
)
def test_impossible_rigs_are_refused(make):
    with pytest.raises(InputError):
        make()


def test_a_ratio_of_1_is_the_config_without_it():
    plain, wide = load_config("kitti"), load_config("kitti", ["camera.fy_over_fx=1.02", "scale=0.5"])
    assert load_config("kitti", ["camera.fy_over_fx=1"]).digest() == plain.digest()
    assert "fy_over_fx" not in plain.model_dump(mode="json")["camera"]
    assert {recipe.config.camera.fy_over_fx for recipe in wide.recipes()} == {1.02}


# Rendering


@pytest.mark.one_backend
def test_the_right_near_plane_cuts_off_nothing_that_the_left_view_shows(open_renderer):
    camera = replace(CAMERA, deviation=CameraDeviation(pitch_rad=0.1))
    scene = one_model(camera, [facing(camera, -100, -100, 300, 300, 2.01)], near_m=2.0)
    outputs = "depth", "instances", "visibility"
    frame = open_renderer([SQUARE], noise_layers(1, 16), outputs=outputs, rectified=False).render(scene)
    assert frame.right.depth.min() < 1.99
    assert (frame.right.instances == 1).all()
    assert OCCLUDED not in frame.left.visibility
    with pytest.raises(InputError, match="rectified=False"):
        open_renderer([SQUARE], noise_layers(1, 16)).render(scene)


# Shared left views


@pytest.mark.one_backend
@pytest.mark.parametrize(
    "changes",
    [{}, {"antialias": "edges"}, {"antialias": "ssaa2", "truth": "left"}, {"rig": {"right_roll_deg": 2.0}}],
    ids=["rectified", "outlines", "samples-left", "deviating"],
)
def test_each_pair_is_that_of_a_rig_of_its_baseline_alone_bit_for_bit(backend, changes):
    """Request all outputs of both views, whole and cropped, in any order."""
    outputs = [output for output in RENDERED_OUTPUTS if output != "disparity_change" or "rig" not in changes]
    config, crop = several(sequence={"length": 2}, outputs=outputs, **changes), Crop(9, 7, 30, 21)
    options = {"truth": config.truth, "antialias": config.antialias, "rectified": config.rig.is_rectified()}
    with PairRenderer(config, SEED, backend) as pairs:
        atlas = pairs.sources.atlas.layers
        with Renderer(pairs.sampler.models, atlas, outputs=outputs, backend=backend, **options) as alone:
            for index, part in ((4, None), (3, None), (0, None), (5, crop), (3, crop), (2, None)):
                frame, sampled = pairs.render(index, crop=part).frame, pairs.sampler.sample(index)
                motions = {"future": sampled.motion(1), "past": sampled.motion(-1)}
                assert sampled.scene.camera.baseline_m == SEVERAL[index % 3]
                assert_equal(frame, alone.render(sampled.scene, part, **motions), message=f"of pair {index}")


@pytest.mark.one_backend
def test_a_left_view_is_drawn_and_read_once_for_all_its_pairs(backend):
    recorder = Recorder()
    with PairRenderer(several(outputs=["visibility", "depth"]), SEED, backend) as pairs:
        pairs.renderer.listener = recorder
        made = [pairs.render(index).frame for index in range(3)]
        assert (recorder.stages.count("sample"), recorder.stages.count("draw")) == (1, 3)
    for frame in made[1:]:
        for name in ("image", "depth"):
            assert frame.left[name] is made[0].left[name]
        assert not np.array_equal(frame.left.disparity, made[0].left.disparity)
    with pytest.raises(ValueError, match="read-only"):
        made[0].left.image[0, 0] = 0


@pytest.mark.one_backend
def test_imperfections_of_the_left_eye_belong_to_the_scene_and_of_the_right_one_to_the_pair(backend):
    imperfections = {"exposure_stops": [-0.5, 0.5], "noise": [2.0, 4.0], "blur_px": [0.0, 1.0]}
    config = several(imperfections=imperfections | {"motion_blur": [0.3, 0.6], "jpeg_quality": [60, 95]})
    with PairRenderer(config, SEED, backend) as pairs, PairRenderer(config, SEED, backend) as others:
        made = [pairs.render(index) for index in range(3)]
        assert_equal(others.render(2, checked=False).frame, made[2].frame)
        assert_equal(others.render(1, crop=Crop(3, 2, 20, 10)).frame, made[1].frame, Crop(3, 2, 20, 10))
    for pair in made:
        np.testing.assert_array_equal(pair.frame.left.image, made[0].frame.left.image)
    for eye, number in (("left", 1), ("right", 3)):
        assert len({json.dumps(pair.provenance["imperfections"][eye]) for pair in made}) == number


@pytest.mark.one_backend
def test_cameras_that_differ_in_the_left_eye_share_no_view(open_renderer):
    camera = StereoCamera.centred(32, 24, 30.0, 0.1)
    renderer, scene = open_renderer([SQUARE], noise_layers(1, 16)), one_model(camera, [np.eye(4)])
    for changed in ({"focal_px": 31.0}, {"cx_left_px": 3.0}, {"cy_px": 1.0}, {"width_px": 31}):
        with pytest.raises(InputError, match="differ from the scene's only in the right eye"):
            renderer.render_rig(scene, [camera, replace(camera, **changed)])
    with pytest.raises(InputError, match="expected at least one, got none"):
        renderer.render_rig(scene, [])


# Scenes of several baselines


def test_scenes_are_made_for_their_longest_baseline():
    section = CameraSection(width_px=64, height_px=48, focal_px=Range(60, 80), baseline_m=Range(0.1, 0.5), baselines=4)
    plain = section.model_copy(update={"baselines": 1})
    for number in range(20):
        views, (alone,) = (sample_cameras(each, generator(0, Purpose.CAMERA, number)) for each in (section, plain))
        assert views[0] == alone
        assert len({view.baseline_m for view in views}) == 4
        assert all(0.1 <= view.baseline_m <= 0.5 and view.left_view_key == alone.left_view_key for view in views)


def test_doffs_is_the_longest_baselines_unless_the_right_principal_point_is_stated():
    base = {"width_px": 64, "height_px": 48, "focal_px": 60, "cx_left_px": 30, "baselines": [0.1, 0.4, 0.2]}
    for keys, expected in (({"doffs_px": 8}, [2, 8, 4]), ({"cx_right_px": 38}, [8, 8, 8])):
        section, rng = CameraSection.model_validate({**base, **keys}), np.random.default_rng(0)
        views = sample_cameras(section, rng)
        assert [view.doffs_px for view in views] == pytest.approx(expected)


@pytest.mark.parametrize("baselines", [[0.1, 0.4, 0.3], 3])
def test_pairs_are_expected_to_show_what_their_baselines_make_of_the_target(baselines):
    """Compare the histogram with random disparities of the longest baseline, scaled to the scene's other baselines."""
    config = several(baselines, {"baseline_m": [0.1, 0.4], "cx_left_px": 30, "cx_right_px": 31.5})
    rng, shown, wanted = np.random.default_rng(0), [], config.wanted_histogram()
    for _ in range(4_000):
        sampled_m = np.array([each.sample(rng) for each in config.camera.baseline_ranges_m])
        shown.append(sampled_m / sampled_m.max() * (wanted.quantile(rng.random()) + 1.5) - 1.5)
    shown, expected = np.concatenate(shown), config.shown_histogram()
    assert expected.shares.sum() == pytest.approx(1)
    below = [(shown[shown > 0] < px).mean() for px in expected.edges_px]
    np.testing.assert_allclose(expected.cumulative(expected.edges_px), below, atol=0.02)


def test_signed_disparities_of_shorter_baselines_are_counted_below_0():
    signed = {"signed": True, "min_px": -8, "max_px": 10, "target": {"form": "uniform"}}
    others = {"disparity": signed, "background": {"wall_disparity_px": -8}, "particles": {}}
    shown = several([0.4, 0.1], {"cx_left_px": 30, "cx_right_px": 40}, **others).shown_histogram()
    # With a quarter of the baseline, d from -8 to 10 becomes (d + 10) / 4 - 10, from -9.5 to -5.
    assert shown.edges_px[0] == pytest.approx(-9.5, abs=0.5)
    assert shown.cumulative(-8) == pytest.approx(1 / 6, abs=0.02)
    assert shown.cumulative(-5) == pytest.approx(1 / 2 + 1 / 12, abs=0.02)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"baselines": 2, "baseline_m": 0.2}, "expected a range for 2 baselines, got only 0.2 m"),
        ({"baselines": 3}, "give either baseline_m"),
        ({"baselines": [0.1, 0.2], "baseline_m": 0.2}, "give either baseline_m"),
        *(({"baselines": number, "baseline_m": [1, 2]}, "baselines") for number in (0, 65, True)),
        *(({"baselines": metres}, "baselines") for metres in ([], [0.1, "0.2"], [0.1, 0])),
    ],
)
def test_baselines_that_cannot_be_are_refused(keys, said):
    with pytest.raises(ValueError, match=said):
        CameraSection.model_validate({"width_px": 64, "height_px": 48, "focal_px": 60, **keys})


# Scenes of signed disparities, and of other pixels


BAD = [
    (False, {"disparity.min_px": 0}, "disparity.min_px goes down to 0 px: .*signed is false"),
    (False, {"background.plane_disparity_px": 0}, "plane_disparity_px goes down to 0 px"),
    (False, {"particles.clutter": [{"count": 3, "disparity_px": -2}]}, "clutter.0.disparity_px goes down to -2 px"),
    (False, {"scenes": [{"recipe": "a", "disparity": {"signed": True}}]}, "a recipe cannot change this key"),
    (True, {"disparity.min_px": -10}, "disparity.min_px goes down to -10 px: .* doffs = 10 px"),
    (True, {"camera.doffs_px": [3, 10]}, "disparity.min_px goes down to -7 px: .* doffs = 3 px"),
    (True, {"background.plane_disparity_px": [-12, -5]}, "background.plane_disparity_px goes down to -12 px"),
    (True, {"disparity.target": {"form": "uniform", "low_px": -30}}, "of the pixels below disparity.min_px"),
]


@pytest.mark.parametrize(("signed", "keys", "message"), BAD)
def test_disparities_that_no_rig_has_are_refused_by_their_key(signed, keys, message):
    values = open_scenes(10.0 if signed else 0.0, signed=signed).model_dump(mode="json").items()
    with pytest.raises(InputError, match=message):
        load_config("kitti", [*values, *keys.items()])


def test_scenes_are_as_many_below_0_as_above():
    """A doffs of 20 px shifts the distribution of disparities by -20 px and changes nothing else."""
    expected, solved = [], {"particles.layers": None, "particles.size_px": [20, 80]}
    for doffs_px in (0.0, 20.0):
        with PairRenderer(open_scenes(doffs_px, more=solved), SEED) as renderer:
            expected.append(renderer.sampler.expected())
    np.testing.assert_allclose(expected[1].edges_px + 20, expected[0].edges_px, atol=1e-9)
    np.testing.assert_allclose(expected[1].shares, expected[0].shares, atol=0.02)


def test_particles_come_into_both_views_at_any_disparity():
    camera = StereoCamera.centred(100, 60, 50.0, 0.1, doffs_px=40.0)
    values = (np.full(4000, value) for value in (1.0, -30.0, 5.0, 1.0, 1.0, 0.5, 1.0, 1.0))
    slots = ParticleSlots(*values, vertical_view_limits(SequenceRig((camera,))))
    start = sample_generation(camera, ParticlesSection(), slots, np.random.default_rng(0)).middle_px
    # With a negative disparity, points at the right view's left border are left of the left view.
    assert start.min() == pytest.approx(-30 - 5 - 0.5, abs=0.3)
    assert start.max() == pytest.approx(100 + 5 - 0.5, abs=0.3)


def test_a_share_of_the_open_scenes_has_a_sky_and_nothing_else_changes():
    scenes = []
    for sky in (0.5, 0.0):
        with PairRenderer(open_scenes(0.0, sky, more={"structures.panels": 2}), SEED) as renderer:
            sampled = [renderer.sampler.sample(index) for index in range(20)]
        scenes.append([one.scene for one in sampled])
        assert [one.provenance().get("sky") for one in sampled] == [one.scene.sky.any() or None for one in sampled]
    some, none = scenes
    assert 4 < sum(scene.sky.any() for scene in some) < 16
    assert not any(scene.sky[1:].any() for scene in some)
    assert not any(scene.sky.any() for scene in none)
    for scene, plain in zip(some, none, strict=True):
        np.testing.assert_array_equal(scene.world_from_model[1:], plain.world_from_model[1:])


@pytest.mark.parametrize("kind", ["plane", "street", "cuboid", "room"])
@pytest.mark.parametrize(
    ("ratio", "rig"),
    [(0.6, {"right_pitch_deg": -5}), (1.7, {}), (1.0, {"right_pitch_deg": 5, "right_roll_deg": 5})],
    ids=["wide", "high", "up"],
)
def test_backgrounds_close_what_the_views_show(kind, ratio, rig):
    background = {name: float(name == kind) for name in ("plane", "street", "cuboid", "room")}
    config = cheap(
        rig=rig,
        camera={"focal_px": 45, "fy_over_fx": ratio},
        outputs=["depth"],
        disparity={"min_px": 2, "max_px": 20, "target": {"form": "uniform"}},
        particles={"layers": []},
        background=background | {"plane_disparity_px": 4, "wall_disparity_px": [8, 14]},
        checks={"min_valid": 0},
    )
    with PairRenderer(config, 1) as pairs:
        for frame in (pairs.render(index).frame for index in range(4)):
            for view in (frame.left, frame.right):
                assert np.isfinite(view.depth).all()
                assert view.disparity[np.isfinite(view.disparity)].max() <= 20 * (1 + 1e-5)


@pytest.mark.parametrize("name", ["real-rig", "small-rooms"])
def test_examples_make_scenes_at_their_full_size(name):
    few = ["textures.source=procedural", "textures.max_patches=8", "models.complex=0", "models.variants=1"]
    config = load_config(ROOT / "examples" / f"{name}.yaml", few)
    sources = prepare_sources(config, Split(0))
    sampler = RecipeMixSampler(config, 0, sources.libraries, sources.atlas.patches)
    assert len(sampler.sample(0).scene.model) > 10
    assert sampler.expected().shares.sum() == pytest.approx(1)
