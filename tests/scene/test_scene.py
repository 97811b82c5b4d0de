"""Scenes: what is promised of cameras, backgrounds, particles and layers."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from semisynth_gl.config import Config, Range, load_config
from semisynth_gl.config.rig_sections import DisparitySection
from semisynth_gl.config.scene_sections import BackgroundSection, ParticlesSection, StructuresSection
from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.geometry.model_library import build_library
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.scene.background import OVERLAP, sample_cuboid, sample_plane
from semisynth_gl.scene.instances import to_scene
from semisynth_gl.scene.particles import (
    Batch,
    Sizes,
    particles_at,
    sample_release,
    sample_slots,
    stated_sizes,
)
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.rig import near_depth_m, rotation_about_axis, rotation_from_quaternion, sample_camera
from semisynth_gl.scene.sampler import SceneSampler
from semisynth_gl.scene.scene import make_scene
from semisynth_gl.scene.structures import SURFACE_MODELS, sample_structures
from semisynth_gl.scene.view_volume import height_of_view
from semisynth_gl.seeds.seeds import Purpose, generator
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures.atlas import Patch

CAMERA = StereoCamera(600, 400, 700.0, 0.2, 280.0, 320.0, 190.0)
DISPARITY = DisparitySection(min_px=5.0, max_px=150.0)


def small(*settings: str) -> Config:
    return load_config("middlebury", ["camera.width_px=150", "camera.height_px=100", "models.variants=1", *settings])


def patches(count=5, frames=1):
    return tuple(Patch(f"{i}.png", 0, 0, 256, i * frames, frames, 9.0) for i in range(count))


@pytest.fixture(scope="module")
def library():
    return build_library(small().models, small().particles, Split(3))


def test_cameras_are_drawn_within_their_ranges():
    section = load_config("middlebury").camera
    cameras = [sample_camera(section, generator(1, Purpose.CAMERA, i)) for i in range(200)]
    for name, low, high in (("focal_px", 1164, 2700), ("baseline_m", 0.16, 0.38), ("doffs_px", 40, 200)):
        values = np.array([getattr(camera, name) for camera in cameras])
        assert (values >= low).all()
        assert (values <= high).all()
        assert values.max() - values.min() > 0.8 * (high - low)
    middle = np.array([(camera.cx_left_px + camera.cx_right_px) / 2 for camera in cameras])
    np.testing.assert_allclose(middle, (1500 - 1) / 2)


def test_doffs_beyond_the_largest_disparity_are_refused():
    with pytest.raises(InputError, match=r"disparity\.min_px: 5 px lies beyond infinity"):
        near_depth_m(StereoCamera.centred(100, 100, 100.0, 0.1, -6.0), DISPARITY)


@pytest.mark.parametrize("kind", ["cuboid", "plane"])
def test_disparities_that_no_depth_has_are_refused(library, kind):
    config = small(
        "camera.doffs_px=-40", f"background={{cuboid: {int(kind == 'cuboid')}, plane: {int(kind == 'plane')}}}"
    )
    with pytest.raises(InputError, match="lies beyond infinity"):
        SceneSampler(config, 0, library, patches()).sample(0)


@pytest.mark.parametrize(
    "setting",
    [
        "background.wall_disparity_px=[10, 900]",
        "background={cuboid: 0, plane: 1, plane_disparity_px: 400}",
        "particles.layers=[{disparity_px: [10, 600], count: 3}]",
        "structures.ground_disparity_px=300",
    ],
)
def test_what_would_stand_nearer_than_allowed_is_refused(setting):
    with pytest.raises(InputError, match=r"but disparity\.max_px, the limit, is 290: lower the first"):
        small(setting)


@pytest.mark.parametrize("baseline_m", [0.005, 0.06, 0.54, 30.0])
@pytest.mark.parametrize(("drawn_px", "fy_over_fx"), [(7.0, 1.0), (60.0, 1.0), (60.0, 1.2)])
def test_a_ground_has_the_disparity_that_is_asked_for_whatever_the_rig(baseline_m, drawn_px, fy_over_fx):
    camera = replace(CAMERA, baseline_m=baseline_m, fy_over_fx=fy_over_fx)
    plane = sample_plane(BackgroundSection(), DISPARITY, camera, np.random.default_rng(0))
    section = StructuresSection(ground=1, ground_tilt_deg=0, ground_disparity_px=Range(drawn_px, drawn_px))
    ground = sample_structures(section, DISPARITY, camera, plane["depth_m"][0], np.random.default_rng(0))
    scene = to_scene(np.concatenate([plane, ground]), camera, 0.01)
    hits = cast_rays(scene, SURFACE_MODELS, "left", np.array([299.5, 0, 299.5]), np.array([399.5, 399.5, 0]))
    assert hits.instance.tolist() == [1, 1, 0]
    np.testing.assert_allclose(camera.disparity_px(hits.depth_m[:2]), drawn_px, rtol=1e-5)


def test_every_attempt_draws_everything_anew(library):
    sampler = SceneSampler(small(), 3, library, patches(400))
    first, again, second = sampler.sample(7, 1), sampler.sample(7, 1), sampler.sample(7, 2)
    np.testing.assert_array_equal(first.scene.world_from_model, again.scene.world_from_model)
    for one, two in ((sampler.sample(7), first), (first, second)):
        assert one.scene.camera != two.scene.camera
        assert not np.allclose(one.scene.world_from_model[:6], two.scene.world_from_model[:6])
        assert one.instances["patch"][:6].tolist() != two.instances["patch"][:6].tolist()
        common = min(len(one.scene), len(two.scene))
        assert not np.allclose(one.scene.world_from_model[6:common], two.scene.world_from_model[6:common])
        assert one.scene.model[6:common].tolist() != two.scene.model[6:common].tolist()


def test_walls_show_their_patches_near_one_texel_per_pixel(library):
    sampler = SceneSampler(small("textures.texels_per_pixel=1", "background.wall_turn_deg=0"), 1, library, patches())
    for index in range(5):
        scene = sampler.sample(index).scene
        # The back wall faces the camera: its edges' lengths in pixels are its repeats times the patch's side.
        wall = scene.world_from_model[4]
        pixels = np.linalg.norm(wall[:3, :2], axis=0) * scene.camera.focal_px / wall[2, 3]
        np.testing.assert_allclose(scene.uv_scale[4] * 256, pixels, rtol=0.02)


def planes(walls):
    """The outward unit normals (6, 3) of a cuboid's walls, and their distances (6,) from the camera."""
    normal = walls["pose"][:, :3, 2] * np.tile([1, -1], 3)[:, None]
    return normal, (normal * walls["pose"][:, :3, 3]).sum(axis=1)


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**31),
    st.floats(0, 40),
    st.floats(200, 3000),
    st.floats(-4, 200),
)
def test_no_wall_comes_nearer_than_the_largest_disparity(seed, turn, focal, doffs):
    camera = StereoCamera.centred(600, 400, focal, 0.2, doffs)
    section = BackgroundSection(wall_disparity_px=Range(6, 40), wall_turn_deg=turn)
    normal, offset_m = planes(sample_cuboid(section, DISPARITY, camera, np.random.default_rng(seed))[0])
    y, x = np.mgrid[-0.5:399.6:40, -0.5:599.6:60]
    for eye in EYES:
        origin = offset_m - normal[:, 0] * camera.offset_m(eye)
        assert (origin > 0).all()  # the camera is inside
        along = camera.rays(eye, x, y) @ normal.T
        depth = np.where(along > 0, origin / np.where(along > 0, along, 1), np.inf).min(axis=-1)
        assert np.isfinite(depth).all()
        assert camera.disparity_px(depth).max() <= DISPARITY.max_px


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31))
def test_faces_lie_in_their_planes_and_close_the_cuboid(seed):
    section = BackgroundSection(wall_disparity_px=Range(6, 40))
    walls, _ = sample_cuboid(section, DISPARITY, CAMERA, np.random.default_rng(seed))
    low, high = OVERLAP / (1 + 2 * OVERLAP), (1 + OVERLAP) / (1 + 2 * OVERLAP)
    corners = np.array([[low, low, 0, 1], [high, low, 0, 1], [high, high, 0, 1], [low, high, 0, 1]])
    points = walls["pose"] @ corners.T
    # Each corner of the cuboid belongs to exactly three faces, which go on a little behind each other.
    every = np.round(points[:, :3].transpose(0, 2, 1).reshape(-1, 3), 6)
    _, counts = np.unique(every, axis=0, return_counts=True)
    assert counts.tolist() == [3] * 8


def test_far_planes_cover_both_views_and_are_valid():
    section = BackgroundSection(cuboid=0.0, plane=1.0, plane_disparity_px=Range(0.2, 0.2))
    camera = StereoCamera.centred(600, 400, 700.0, 0.2)
    [plane] = sample_plane(section, DISPARITY, camera, np.random.default_rng(0))
    assert camera.disparity_px(plane["depth_m"]) == pytest.approx(0.2)
    low = plane["pose"][:2, 3]
    high = low + plane["unit_m"]
    for eye in EYES:
        corner = camera.rays(eye, np.array([-0.5, 599.5]), np.array([-0.5, 399.5])) * plane["depth_m"]
        corner[:, 0] += camera.offset_m(eye)
        assert (corner[0, :2] > low).all()
        assert (corner[1, :2] < high).all()


def test_rotations_are_rotations():
    rng = np.random.default_rng(0)
    quaternion = rng.normal(size=(50, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    matrices = rotation_from_quaternion(quaternion)
    np.testing.assert_allclose(matrices @ matrices.transpose(0, 2, 1), np.tile(np.eye(3), (50, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(matrices), 1)
    quarter = rotation_about_axis(np.array([[0.0, 0, 1]]), np.array([np.pi / 2]))[0]
    np.testing.assert_allclose(quarter @ [1, 0, 0], [0, 1, 0], atol=1e-12)


def stream(count=40, **options):
    section = ParticlesSection(**options)
    batches = [Batch(low, high, count, stated_sizes(section)) for low, high in ((20.0, 30.0), (60.0, 90.0))]
    slots = sample_slots(CAMERA, section, batches, np.random.default_rng(2))
    return section, slots, lambda g: sample_release(CAMERA, section, slots, np.random.default_rng([3, g]))


def test_particles_fall_at_constant_speed_and_are_released_anew():
    section, slots, release = stream(fall_m_s=Range(1, 1), drift=Range(0, 0), spin_deg_s=Range(90, 90))
    del section
    times = np.linspace(0, 3 * slots.period_s.max(), 400)
    states = [particles_at(CAMERA, slots, release, t) for t in times]
    y = np.array([state.world_from_model[:, 1, 3] for state in states])
    generation = np.array([state.generation for state in states])
    same = np.diff(generation, axis=0) == 0
    np.testing.assert_allclose(
        np.diff(y, axis=0)[same], np.broadcast_to(np.diff(times)[:, None], same.shape)[same], rtol=1e-9
    )
    assert (np.diff(generation, axis=0) >= 0).all()
    assert generation.max() >= 3
    # From just above the view to just below it, whatever the depth: the sphere touches the view's side there.
    row = CAMERA.focal_px * y / slots.depth_m + CAMERA.cy_px
    (above, below), height = height_of_view(CAMERA).secants, CAMERA.height_px
    assert 1 < above == pytest.approx(np.hypot(1, (CAMERA.cy_px + 0.5) / CAMERA.focal_px))
    assert (row >= -0.5 - above * slots.radius_px - 1e-6).all()
    assert (row <= height - 0.5 + below * slots.radius_px + 1e-6).all()
    assert row.min() < -0.5 - slots.radius_px.max()


def test_rotation_at_a_time_needs_no_steps():
    _, slots, release = stream(count=5, spin_deg_s=Range(90, 90), stretch=Range(1, 1), drift=Range(0, 0))
    first = particles_at(CAMERA, slots, release, 0.0)
    later = particles_at(CAMERA, slots, release, 1e-3)
    same = first.generation == later.generation
    turn = later.world_from_model[same, :3, :3] @ np.linalg.inv(first.world_from_model[same, :3, :3])
    angle = np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1))
    np.testing.assert_allclose(np.rad2deg(angle), 0.09, rtol=1e-3)


def test_layers_hold_their_numbers_at_their_depths():
    _, slots, release = stream(drift=Range(0, 0))
    for time_s in (0.0, 1.7, 100.0):
        disparity = CAMERA.disparity_px(particles_at(CAMERA, slots, release, time_s).world_from_model[:, 2, 3])
        assert ((disparity >= 20) & (disparity <= 30)).sum() == 40
        assert ((disparity >= 60) & (disparity <= 90)).sum() == 40


def test_stretch_never_exceeds_the_bounding_sphere():
    _, slots, release = stream(stretch=Range(0.2, 1))
    state = particles_at(CAMERA, slots, release, 0.3)
    largest = np.linalg.norm(state.world_from_model[:, :3, :3], axis=1).max(axis=1)
    np.testing.assert_allclose(largest, state.radius_m)


def test_the_number_of_particles_has_a_limit():
    section = ParticlesSection(most=50)
    sizes = Sizes(40.0, 300.0)
    batches = [Batch(20.0, 30.0, 400, sizes), Batch(60.0, 90.0, 100, sizes)]
    slots = sample_slots(CAMERA, section, batches, np.random.default_rng(2))
    assert 48 <= len(slots) <= 50
    assert (slots.disparity_px < 31).sum() == 40


def test_scenes_depend_on_config_seed_and_index_alone(library):
    sampler = SceneSampler(small(), 3, library, patches())
    other = SceneSampler(small(), 3, library, patches())
    for index in (17, 0, 5):
        other.sample(index)
    one, two = sampler.sample(17).scene, other.sample(17).scene
    for name in ("model", "world_from_model", "layer", "uv_scale", "uv_offset"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    assert one.camera == two.camera
    different = SceneSampler(small(), 4, library, patches()).sample(17).scene
    assert different.camera != one.camera
    assert sampler.sample(18).scene.camera != one.camera


SCENE_ARRAYS = ("model", "world_from_model", "layer", "uv_scale", "uv_offset")


@pytest.mark.parametrize(
    ("names", "factor"),
    [
        (("ablation-geometry-simple", "ablation-geometry-complex"), "model"),
        (("ablation-textures-procedural", "ablation-textures-photos", "ablation-textures-target"), "layer"),
    ],
)
def test_scenes_of_an_ablation_differ_only_in_their_factor(names, factor):
    """Same cameras, same numbers, same poses; other models, or other patches."""
    sampled = []
    for number, name in enumerate(names):
        config = load_config(name)
        library = build_library(config.models, config.particles, Split(3))
        sampler = SceneSampler(config, 3, library, patches(7 + 50 * number * (factor == "layer")))
        sampled.append([sampler.sample(index).scene for index in range(5)])
    for scenes in zip(*sampled, strict=True):
        for other in scenes[1:]:
            assert other.camera == scenes[0].camera
            assert other.near_m == scenes[0].near_m
            for array in SCENE_ARRAYS:
                same = np.array_equal(getattr(other, array), getattr(scenes[0], array))
                assert same == (array != factor), array


def test_frames_of_a_sequence_share_camera_and_background_and_move(library):
    sampler = SceneSampler(small("sequence.length=4", "sequence.frame_s=0.02"), 3, library, patches())
    first, second, next_sequence = (sampler.sample(index) for index in (4, 5, 8))
    assert (first.sequence.number, first.frame, second.frame, next_sequence.sequence.number) == (1, 0, 1, 2)
    assert first.scene.camera == second.scene.camera != next_sequence.scene.camera
    assert first.sequence.static.background == "cuboid"
    np.testing.assert_array_equal(first.scene.world_from_model[:6], second.scene.world_from_model[:6])
    assert len(first.scene) == len(second.scene) > 6
    moved = second.scene.world_from_model[6:, :3, 3] - first.scene.world_from_model[6:, :3, 3]
    assert np.median(moved[:, 1]) > 0.005  # downwards, at 0.5 to 2 m/s


def test_image_sequences_advance_by_a_layer_a_frame(library):
    sampler = SceneSampler(small("sequence.length=3"), 3, library, patches(2, frames=7))
    layers = [sampler.sample(index).scene.layer[:6] for index in range(3)]
    patch = sampler.sample(0).instances["patch"][:6]
    for before, after in pairwise(layers):
        np.testing.assert_array_equal((after - patch * 7), (before - patch * 7 + 1) % 7)


def test_no_model_crosses_the_near_plane(library):
    sampler = SceneSampler(small("particles.size_px=[100, 400]"), 1, library, patches())
    radius = np.array([mesh.radius for mesh in sampler.models])
    count = 0
    for index in range(30):
        scene = sampler.sample(index).scene
        matrices = scene.world_from_model[6:]
        reach = radius[scene.model[6:]] * np.linalg.norm(matrices[:, :3, :3], axis=1).max(axis=1)
        assert (matrices[:, 2, 3] - reach > scene.near_m - 1e-9).all()
        count += len(matrices)
    assert count > 100


def test_texels_come_out_near_one_pixel(library):
    # Texture is laid out for the middle of a model's path; without drift all of it is at that depth.
    config = small("textures.texels_per_pixel=1", "background.wall_turn_deg=0", "particles.drift=0")
    scene = SceneSampler(config, 1, library, patches()).sample(0).scene
    model = scene.model[6:]
    assert (model > 0).all()
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
        ({"camera_from_world": np.eye(3)}, "camera_from_world must have shape"),
    ],
)
def test_impossible_scenes_are_refused(change, word):
    arguments = {"model": [0], "world_from_model": [np.eye(4)], "layer": [0]} | change
    with pytest.raises(InputError, match=word):
        make_scene(CAMERA, **arguments)
