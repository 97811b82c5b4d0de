"""Scenes: cameras, backgrounds, structures, sequences and textures."""

from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest
from samplers import patches, still_rig

from semisynth_gl.config import Config, Range, load_config
from semisynth_gl.config.disparity_section import DisparitySection
from semisynth_gl.config.scene_sections import BackgroundSection, StructuresSection
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.geometry.model_library import build_library
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.scene import sampler as sampler_module
from semisynth_gl.scene.background import sample_plane
from semisynth_gl.scene.catalogue import CURVED_PANEL, SURFACE_MODELS
from semisynth_gl.scene.instances import to_scene
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.rig import sample_cameras
from semisynth_gl.scene.sampler import SceneSampler
from semisynth_gl.scene.scene import Scene, make_scene
from semisynth_gl.scene.static_scene import sample_structures
from semisynth_gl.seeds.seeds import Purpose, generator
from semisynth_gl.seeds.splits import Split

CAMERA = StereoCamera(600, 400, 700.0, 0.2, 280.0, 320.0, 190.0)
DISPARITY = DisparitySection(min_px=5.0, max_px=150.0)
SCENE_ARRAYS = ("model", "world_from_model", "layer", "uv_scale", "uv_offset")


def small(*keys: str) -> Config:
    return load_config("middlebury", ["camera.width_px=150", "camera.height_px=100", "models.variants=1", *keys])


@pytest.fixture(scope="module")
def sampler_of():
    library = build_library(small().models, small().particles, Split(3))
    return lambda *keys, seed=3, atlas_patches=None: SceneSampler(
        small(*keys), seed, library, atlas_patches or patches()
    )


def differing(one, other):
    return [name for name in SCENE_ARRAYS if not np.array_equal(getattr(one, name), getattr(other, name))]


def test_cameras_are_sampled_within_their_ranges():
    section = load_config("middlebury").camera
    cameras = [sample_cameras(section, generator(1, Purpose.CAMERA, i))[0] for i in range(200)]
    for name, low, high in (("focal_px", 1164, 2700), ("baseline_m", 0.16, 0.38), ("doffs_px", 40, 200)):
        values = np.array([getattr(camera, name) for camera in cameras])
        assert low <= values.min() < values.max() <= high
        assert np.ptp(values) > 0.8 * (high - low)
    middle = np.array([(camera.cx_left_px + camera.cx_right_px) / 2 for camera in cameras])
    np.testing.assert_allclose(middle, (1500 - 1) / 2)


def test_a_stated_layer_that_no_depth_has_is_refused(sampler_of):
    camera, rng = StereoCamera.centred(150, 100, 100.0, 0.1, -40.0), np.random.default_rng(0)
    near, far = "[{count: 1, disparity_px: 60}]", "[{count: 1, disparity_px: 30}]"
    for layers, clutter in ((near, far), (far, near), ("null", far)):
        solver = sampler_of(f"particles.layers={layers}", f"particles.clutter={clutter}").disparity_solver
        with pytest.raises(InputError, match=r"^particles: the disparity 30 px of a layer has no depth"):
            solver.sample(0, camera, np.array([60.0]), rng)


@pytest.mark.parametrize("baseline_m", [0.005, 0.06, 0.54, 30.0])
@pytest.mark.parametrize(("sampled_px", "fy_over_fx"), [(7.0, 1.0), (60.0, 1.0), (60.0, 1.2)])
def test_a_ground_has_the_disparity_that_is_asked_for_whatever_the_rig(baseline_m, sampled_px, fy_over_fx):
    camera = replace(CAMERA, baseline_m=baseline_m, fy_over_fx=fy_over_fx)
    structures = StructuresSection(ground=1, ground_tilt_deg=0, ground_disparity_px=Range(sampled_px, sampled_px))
    sections = {"background": BackgroundSection(), "structures": structures, "disparity": DISPARITY}
    config, rig = small().model_copy(update=sections), still_rig(camera, DISPARITY.max_px)
    plane = sample_plane(config, rig, np.random.default_rng(0))
    ground = sample_structures(config, rig, plane["depth_m"][0], np.random.default_rng(0))
    scene = to_scene(np.concatenate([plane, ground]), camera, 0.01)
    hits = cast_rays(scene, SURFACE_MODELS, "left", np.array([299.5, 0, 299.5]), np.array([399.5, 399.5, 0]))
    assert hits.instance.tolist() == [1, 1, 0]
    np.testing.assert_allclose(camera.disparity_px(hits.depth_m[:2]), sampled_px, rtol=1e-5)


def test_panels_are_slanted_curved_and_beyond_the_near_plane(sampler_of):
    keys = "structures={panels: 40, panel_slant_deg: [30, 60], panel_curved: 0.5, panel_disparity_px: [10, 289]}"
    sampled = sampler_of(keys).sample(0)
    scene, panels = sampled.scene, range(6, 46)
    assert [row["still"] for row in sampled.instance_table()] == [True] * 46 + [False] * (len(scene) - 46)
    assert 10 <= sum(SURFACE_MODELS[scene.model[k]] is CURVED_PANEL for k in panels) <= 30
    for k in panels:
        pose = scene.world_from_model[k]
        normal = pose[:3, 2] / np.linalg.norm(pose[:3, 2])
        assert 30 - 1e-6 <= np.rad2deg(np.arccos(abs(normal[2]))) <= 60 + 1e-6
        depth = SURFACE_MODELS[scene.model[k]].positions.astype(float) @ pose[2, :3] + pose[2, 3]
        assert depth.min() > scene.near_m


def test_scenes_depend_on_config_seed_index_and_attempt_alone(sampler_of):
    sampler, other = sampler_of(atlas_patches=patches(400)), sampler_of(atlas_patches=patches(400))
    for index in (17, 0, 5):
        other.sample(index)
    one = sampler.sample(17, 1).scene
    assert differing(one, other.sample(17, 1).scene) == []
    assert one.camera == other.sample(17, 1).scene.camera
    for changed in (sampler.sample(17), sampler.sample(17, 2), sampler.sample(18, 1), sampler_of(seed=4).sample(17, 1)):
        assert changed.scene.camera != one.camera
        assert set(differing(changed.scene, one)) == set(SCENE_ARRAYS)


@pytest.mark.parametrize(
    ("names", "factor"),
    [
        (("ablation-geometry-simple", "ablation-geometry-complex"), "model"),
        (("ablation-textures-procedural", "ablation-textures-photos", "ablation-textures-target"), "layer"),
    ],
)
def test_scenes_of_an_ablation_differ_only_in_their_factor(names, factor):
    sampled = []
    for number, name in enumerate(names):
        config = load_config(name, ["models.variants=1"])
        library = build_library(config.models, config.particles, Split(3))
        sampler = SceneSampler(config, 3, library, patches(7 + 50 * number * (factor == "layer")))
        sampled.append([sampler.sample(index).scene for index in range(3)])
    for scenes in zip(*sampled, strict=True):
        for other in scenes[1:]:
            assert (other.camera, other.near_m) == (scenes[0].camera, scenes[0].near_m)
            assert differing(other, scenes[0]) == [factor]


def test_frames_of_a_sequence_share_camera_and_background_and_move(sampler_of):
    sampler = sampler_of("sequence.length=4", "sequence.frame_s=0.02", atlas_patches=patches(2, frames=7))
    frames = [sampler.sample(index) for index in range(4, 8)]
    assert [(each.sequence.number, each.frame) for each in frames] == [(1, 0), (1, 1), (1, 2), (1, 3)]
    for first, second in pairwise(frames):
        assert first.scene.camera == second.scene.camera
        np.testing.assert_array_equal(first.scene.world_from_model[:6], second.scene.world_from_model[:6])
        # Each frame shows the next layer of its image sequence.
        first_layer = first.instances["patch"][:6] * 7
        np.testing.assert_array_equal(
            second.scene.layer[:6] - first_layer, (first.scene.layer[:6] - first_layer + 1) % 7
        )
    starts = np.array([sampler.patch_assignment.layers(np.arange(2), number, 0) for number in range(7)])
    assert [len(set(of_patch)) for of_patch in starts.T.tolist()] == [7, 7]
    moved = frames[1].scene.world_from_model[6:, 1, 3] - frames[0].scene.world_from_model[6:, 1, 3]
    assert np.median(moved) > 0.005  # downwards, at 0.5 to 2 m/s


def test_each_generation_of_particles_has_random_numbers_of_its_own(sampler_of, monkeypatch):
    sequence, keys = sampler_of().sample(0).sequence, {(3, Purpose.PARTICLES, 0, 0)}  # the key of the slots
    monkeypatch.setattr(sampler_module, "generator", lambda *key: keys.add(key) or generator(*key))
    for generation in range(-3, 4):
        sequence.particle_poses(0.0, np.full(len(sequence.slots), generation))
    assert len(keys) == 8


def test_of_a_street_only_what_is_behind_it_is_sky(sampler_of):
    street = "background.cuboid=0", "background.street=1", "disparity.signed=true"
    for sky in (0, 1):
        scene = sampler_of(*street, f"background.sky={sky}").sample(0).scene
        assert scene.sky.tolist() == [bool(sky), *[False] * (len(scene) - 1)]


def test_patches_have_near_one_texel_a_pixel(sampler_of):
    # The sampler scales a texture for the middle of the path; without drift the whole path has that depth.
    sampler = sampler_of("textures.texels_per_pixel=1", "background.wall_turn_deg=0", "particles.drift=0")
    scene = sampler.sample(0).scene
    # The back wall faces the camera: an edge's length in pixels is its repeats times the patch's side.
    wall = scene.world_from_model[4]
    pixels = np.linalg.norm(wall[:3, :2], axis=0) * scene.camera.focal_px / wall[2, 3]
    np.testing.assert_allclose(scene.uv_scale[4] * 256, pixels, rtol=0.02)
    # A model's UV unit is one model unit; facing the camera it covers scale * f / Z pixels and uv_scale * P texels.
    scale = np.linalg.norm(scene.world_from_model[6:, :3, :3], axis=1).mean(axis=1)
    pixels = scale * scene.camera.focal_px / scene.world_from_model[6:, 2, 3]
    np.testing.assert_allclose(scene.uv_scale[6:, 0] * 256 / pixels, 1)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"near_m": 0.0}, "near_m: must be"),
        ({"layer": [0, 1]}, r"layer must have shape \(1,\)"),
        ({"world_from_model": [np.full((4, 4), np.nan)]}, "got nan"),
        ({"world_from_model": np.eye(3)}, "world_from_model must have shape"),
        ({"uv_scale": [1, 1, 1]}, "uv_scale must have shape"),
    ],
)
def test_impossible_scenes_are_refused(change, word):
    arguments = {"model": [0], "world_from_model": [np.eye(4)], "layer": [0]} | change
    with pytest.raises(InputError, match=word):
        make_scene(CAMERA, **arguments)


def test_scenes_of_arrays_have_no_sky_unless_they_say_so():
    made = make_scene(CAMERA, model=[0, 0], world_from_model=[np.eye(4)] * 2, layer=[0, 0])
    arrays = {each.name: getattr(made, each.name) for each in fields(made) if each.name != "sky"}
    for scene in (Scene(**arrays), replace(made, sky=np.zeros(0, bool))):
        np.testing.assert_array_equal(scene.sky, [False, False])
    with pytest.raises(InputError, match="sky must be bool, got int64"):
        Scene(**arrays, sky=np.array([1, 0]))
