"""A projector's light and shadows compared with float64 rays; its dots match the true disparity."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scene_table import clutter, models
from scene_table import wall as behind
from scenes import SQUARE, assert_equal, facing, noise_layers, one_model, posed
from scipy.ndimage import map_coordinates, maximum_filter, minimum_filter
from tiny_datasets import cheap

from semisynth_gl.config.rig_sections import ProjectorSection
from semisynth_gl.dataset.generate import generate
from semisynth_gl.frame.camera import EYES, CameraDeviation, Crop, StereoCamera
from semisynth_gl.geometry.mesh import make_mesh
from semisynth_gl.geometry.rotations import rotations_about
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.oracle import normals as normals_of
from semisynth_gl.pairs.pipeline import PairRenderer, render_pair
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.projector import find_pattern, sample_projector
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.scene import Projector, make_scene

CAMERA = StereoCamera(120, 90, 112.0, 0.1, 58.0, 63.0, 43.5)
WHITE = np.full((1, 8, 8, 4), 255, np.uint8)
FULL = np.full((68, 105), 255, np.uint8)
# Ramps of 8 levels per pixel, so that a mirrored, rotated or shifted pattern changes the result.
SLOPES = np.add.outer(*(np.abs(np.arange(size) * 8 % 256 - 128) for size in FULL.shape)).clip(0, 255).astype(np.uint8)


def projector(position_m=(0.05, 0.02, 0.0), turn_rad=(0.0, 0.0, 0.0), **values):
    turn = np.array(turn_rad)
    angle = max(np.linalg.norm(turn), 1e-12)
    rotation = rotations_about(turn[None] / angle, np.array([-angle]))[0]
    return Projector(
        posed(rotation, -rotation @ position_m), **{"focal_px": 68.0, "power": 1.2, "ambient": 0.2} | values
    )


def plane(depth_m=1.5, tilt_rad=0.0, camera=CAMERA, **scene):
    """Make a scene of a wall that fills both views, rotated about the vertical."""
    turn = rotations_about(np.array([[0.0, 1.0, 0.0]]), np.array([tilt_rad]))[0] * 40 * depth_m
    return one_model(camera, [posed(turn, turn @ [-0.5, -0.5, 0] + [0, 0, depth_m])], **scene)


def rendered(scene, pattern=FULL, models=(SQUARE,), layers=WHITE, **options):
    with Renderer(list(models), layers, pattern=pattern, **options) as renderer:
        return renderer.render(scene)


def expected_light(scene, models, eye, pattern=FULL):
    """Cast float64 rays for one eye; return the light, and masks of decided and of lit pixels, each (H, W).

    The light is of a bilinear pattern, and 0 where the eye sees nothing. A pixel is undecided if not all four
    neighbouring texels of the pattern see the pixel's instance.
    """
    camera, own = scene.camera, scene.projector
    y, x = np.mgrid[: camera.height_px, : camera.width_px].astype(float)
    hits = cast_rays(scene, models, eye, x, y)
    missed = hits.instance < 0
    points = camera.rays(eye, x.ravel(), y.ravel()) * np.where(missed, 1.0, hits.depth_m)[:, None]
    points[:, 0] += camera.offset_m(eye)
    turn, shift = own.projector_from_camera[:3, :3], own.projector_from_camera[:3, 3]
    from_there, (height, width) = points @ turn.T + shift, pattern.shape
    u = own.focal_px * from_there[:, 0] / from_there[:, 2] + (width - 1) / 2
    v = own.focal_px * from_there[:, 1] / from_there[:, 2] + (height - 1) / 2
    inside = (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5) & (from_there[:, 2] > 0)
    centred = StereoCamera.centred(width, height, own.focal_px, 1.0)
    pose = own.projector_from_camera @ scene.camera_from_world
    there = replace(scene, camera=centred, camera_from_world=pose, near_m=0.1 * scene.near_m, projector=None)
    u, v = np.where(inside, u, 0), np.where(inside, v, 0)
    seen = cast_rays(there, models, "left", u, v)
    reached = inside & (np.abs(seen.depth_m - from_there[:, 2]) < 1e-6 * from_there[:, 2])
    decided = np.ones(len(u), bool)
    for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)):
        at = np.floor(u) + right, np.floor(v) + down
        around = cast_rays(there, models, "left", *at)
        on_pattern = (at[0] >= 0) & (at[1] >= 0) & (at[0] < width) & (at[1] < height)
        decided &= ~inside | ((around.instance == seen.instance) & on_pattern)
    # Normals in the left camera's frame, towards the eye.
    eye_turn, normals = camera.turn(eye), normals_of(scene, models, eye, hits)
    normals = normals if eye_turn is None else normals @ eye_turn
    way = points + turn.T @ shift
    reached &= (normals * way).sum(1) < 0
    distance = np.linalg.norm(way, axis=1)
    cosine = np.abs((normals * way).sum(1)) / distance
    thrown = own.power * map_coordinates(pattern.astype(float), (v, u), order=1, mode="nearest") / 255
    light = np.where(missed, 0, own.ambient + np.where(reached, thrown * cosine / distance**2, 0))
    return light.reshape(y.shape), decided.reshape(y.shape), reached.reshape(y.shape)


DEVIATING = replace(CAMERA, deviation=CameraDeviation(0.04, -0.03, 2.0, 1.02), fy_over_fx=1.2)


@pytest.mark.parametrize(
    ("tilt_rad", "camera"),
    [(0.0, CAMERA), (0.7, CAMERA), (-1.2, CAMERA), (0.4, DEVIATING)],
    ids=["facing", "tilted", "grazing", "deviating"],
)
@pytest.mark.parametrize("antialias", ["none", "ssaa2"])
def test_a_plane_has_the_light_of_rays(tilt_rad, camera, antialias):
    scene = plane(tilt_rad=tilt_rad, camera=camera, projector=projector(turn_rad=(0.05, -0.1, 0.3), focal_px=98.0))
    frame = rendered(scene, SLOPES, antialias=antialias, rectified=camera.rectified)
    for eye in EYES:
        light, decided, reached = expected_light(scene, [SQUARE], eye, SLOPES)
        assert reached.mean() > 0.3
        assert (~reached).mean() > 0.02
        off = np.abs(frame.view(eye).image[..., 0] - np.clip(255 * light, 0, 255))
        # With several samples, a pixel can be on both sides of the pattern's or the wall's border.
        even = minimum_filter(decided, 3)
        for side in (reached, light > 0):
            even &= minimum_filter(side, 3) == maximum_filter(side, 3)
        assert even.mean() > 0.75
        assert off[even].max() < 3
        assert np.median(off[even & reached]) < 0.4


@pytest.mark.parametrize("seed", range(2))
def test_shadows_of_clutter_are_those_of_rays(seed):
    lit = projector((0.3, -0.15, 0.0), power=5.0, focal_px=83.0)
    scene = replace(clutter(seed, CAMERA, count=12), projector=lit)
    light, decided, reached = expected_light(scene, models(), "left")
    assert 0.2 < reached.mean() < 0.999
    image = rendered(scene, models=models(), layers=WHITE.repeat(4, axis=0)).left.image[..., 0]
    # The rest are folds and steps of one instance that are finer than a texel.
    assert (decided & (np.abs(image - np.clip(255 * light, 0, 255)) >= 2.0)).mean() < 0.01
    assert decided.mean() > 0.6


@pytest.mark.parametrize("distance_m", [0.05, 4000.0])
@pytest.mark.parametrize("tilt_rad", [0.0, 1.5])
def test_no_plane_shades_itself(distance_m, tilt_rad):
    lit = projector((0.03 * distance_m, 0.02 * distance_m, 0.0), power=50 * distance_m**2, ambient=0.0)
    scene = plane(distance_m, tilt_rad, near_m=distance_m / 100, projector=lit)
    light, decided, reached = expected_light(scene, [SQUARE], "left")
    seen = decided & reached & (light > 0.02)
    assert seen.mean() > 0.1
    assert (rendered(scene).left.image[..., 0][seen] > 0).all()


def test_a_shadow_begins_where_a_thing_touches_the_ground():
    """A post on a wall, seen edge-on and lit from the left, touches its shadow."""
    post = posed([[0, 0, 1], [0, 1, 0], [-0.3, 0, 0]], (0.1, -0.5, 2.0))
    lit = projector((-1.0, 0.0, 0.0), power=2.0, ambient=0.0, focal_px=105.0)
    scene = one_model(CAMERA, [behind(CAMERA, 2.0), post], projector=lit)
    image = rendered(scene, np.full((150, 225), 255, np.uint8)).left.image[45, :, 0]
    foot_px = CAMERA.focal_px * 0.1 / 2.0 + CAMERA.cx_left_px
    assert (image[int(foot_px) - 15 : int(foot_px)] > 0).all()
    dark = np.flatnonzero(image[int(foot_px) + 1 :] == 0)
    assert len(dark) > 8
    assert dark.min() <= CAMERA.focal_px / lit.focal_px + 1


def test_truth_does_not_know_of_the_projector_and_light_of_1_changes_nothing():
    scene = plane(tilt_rad=0.3)
    options = {"layers": noise_layers(1, 64), "outputs": ["visibility", "depth", "normals", "instances"]}
    plain = rendered(scene, None, **options)
    assert_equal(rendered(scene, FULL, **options), plain)
    assert_equal(rendered(replace(scene, projector=projector(power=0.0, ambient=1.0)), **options), plain)
    lit = rendered(replace(scene, projector=projector()), **options).arrays()
    for role, array in plain.arrays().items():
        assert np.array_equal(lit[role], array) == (role not in EYES), role


def test_a_sheet_hides_its_lit_side_from_the_eye_beyond_it():
    """The sheet extends away from the left eye; the projector is left or right of it."""
    sheet, images = posed([[0.3, 0, 0], [0, 1, 0], [2, 0, 1]], (0.02, -0.5, 0.8)), []
    for side_m in (-1.0, 1.0):
        lit = projector((side_m, 0.0, 0.0), turn_rad=(0.0, -0.6 * side_m, 0.0), ambient=0.2, power=3.0)
        scene = one_model(CAMERA, [sheet], projector=lit)
        images.append(rendered(scene).left.image[45, :, 0])
        light, decided, _ = expected_light(scene, [SQUARE], "left")
        assert np.abs(images[-1] - np.clip(255 * light[45], 0, 255))[decided[45]].max() < 1.5
    seen = images[0] > 0
    # The eye sees one side of the sheet; only one of the two projectors lights it.
    assert {(image[seen] > 60).mean() > 0.8 for image in images} == {True, False}


def test_the_sky_has_only_ambient_light_and_each_scene_its_own_shadows():
    near, sky = facing(CAMERA, 30, 15, 45, 45, 1.0), behind(CAMERA, 5.0)
    image = rendered(one_model(CAMERA, [near, sky], sky=[False, True], projector=projector())).left.image[..., 0]
    assert image[4, 4] == round(255 * 0.2)
    assert image[38, 52] > 100
    lit, wall, post = projector((-0.6, 0.0, 0.0)), behind(CAMERA, 2.0), facing(CAMERA, 45, 22, 15, 45, 1.0)
    bare, with_post = (one_model(CAMERA, poses, projector=lit) for poses in ([wall], [wall, post]))
    with Renderer([SQUARE], WHITE, pattern=FULL) as renderer:
        in_turn = [renderer.render(scene) for scene in (with_post, bare, with_post)]
    assert_equal(in_turn[1], rendered(bare))
    assert_equal(in_turn[2], in_turn[0])
    shadow = (in_turn[0].left.image < in_turn[1].left.image).all(axis=2)
    assert 280 < shadow.sum() < 1700


def test_crops_grey_images_alone_and_shared_left_views_have_the_same_light():
    scene, crop = plane(tilt_rad=0.4, projector=projector()), Crop(25, 16, 52, 37)
    with Renderer([SQUARE], WHITE, pattern=FULL) as renderer:
        whole = renderer.render(scene)
        assert_equal(renderer.render(scene, crop), whole, crop)
        images = renderer.render_images(scene)
        cameras = [CAMERA, replace(CAMERA, baseline_m=0.2)]
        for camera, frame in zip(cameras, renderer.render_rig(scene, cameras), strict=True):
            assert_equal(frame, renderer.render(replace(scene, camera=camera)))
    for eye, image in images.items():
        np.testing.assert_array_equal(image, whole.view(eye).image)
    np.testing.assert_array_equal(rendered(scene, layers=WHITE[..., 0]).left.image, whole.left.image[..., 0])


@pytest.mark.parametrize("grey", [False, True])
def test_outlines_have_the_light_of_many_samples(grey):
    """An eye at the projector's position sees no shadows, so that only outlines cause errors."""
    layers = WHITE[..., 0] if grey else WHITE
    corners = np.array([[-0.31, -0.22, 0], [0.33, -0.17, 0], [0.12, 0.36, 0]])
    triangle = make_mesh("triangle", corners, corners[:, :2], [[0, 1, 2]])
    turned = posed(rotations_about(np.array([[0.6, 0.8, 0.0]]), np.array([0.9]))[0], (0.02, 0.03, 1.0))
    poses = plane(3.0).world_from_model[0], turned
    for eye in EYES:
        light = projector(position_m=(CAMERA.offset_m(eye), 0, 0), power=1.5, ambient=0.1)
        scene = make_scene(CAMERA, model=[0, 1], world_from_model=poses, layer=[0, 0], projector=light)
        none, edges, many = (
            rendered(scene, FULL, (SQUARE, triangle), layers, antialias=mode).view(eye).image.astype(float)
            for mode in ("none", "edges", "ssaa8")
        )
        assert ((none - many) ** 2).mean() > 5
        assert ((edges - many) ** 2).mean() < 0.005 * ((none - many) ** 2).mean()
        # The exceptions are the triangle's corners.
        assert (np.abs(edges - many).reshape(90, 120, -1).max(axis=2) > 6).sum() <= 3


@pytest.mark.parametrize(
    "values",
    [
        {"power": -1.0},
        {"focal_px": 0.0},
        *({"projector_from_camera": pose} for pose in (2 * np.eye(4), np.diag([-1.0, 1, 1, 1]), np.eye(3))),
    ],
)
def test_what_cannot_be_lit_is_refused(values):
    with pytest.raises(InputError, match="projector"):
        Projector(**{"projector_from_camera": np.eye(4), "focal_px": 90.0, "power": 1.0} | values)
    for pattern, said in ((None, "its projector has a pattern"), (np.zeros((4, 4)), r"must be \(H, W\) uint8")):
        with pytest.raises(InputError, match=said):
            rendered(plane(projector=projector()), pattern)


# --- configs ---


@pytest.mark.parametrize("pattern", ["dots", "stripes"])
@pytest.mark.parametrize("density", [0.02, 0.1])
def test_a_pattern_is_as_dense_as_asked_for(pattern, density):
    section = ProjectorSection(power=1, pattern=pattern, density=density, size_px=4)
    light = find_pattern(section)
    assert (light.shape, light.max()) == ((800, 1280), 255)
    assert light.mean() / 255 == pytest.approx(density, rel=0.15)
    np.testing.assert_array_equal(light, find_pattern(section))
    assert (light == light[0]).all() == (pattern == "stripes")


def test_the_place_of_a_projector_is_the_configs_in_a_share_of_the_sequences():
    turned = {"position_m": (0.1, -0.2, 0.05), "turn_deg": (0, 90, 0), "field_of_view_deg": 90}
    section, rng = ProjectorSection(power=2, ambient=0.5, share=0.5, **turned), np.random.default_rng(0)
    found = [sample_projector(section, rng) for _ in range(40)]
    assert 10 < sum(each is not None for each in found) < 30
    sampled = next(filter(None, found))
    pose = sampled.projector_from_camera
    np.testing.assert_allclose(pose @ [0.1, -0.2, 0.05, 1], [0, 0, 0, 1], atol=1e-12)
    # A rotation by 90 degrees about y (down) turns the projector to the right.
    np.testing.assert_allclose(pose[:3, :3] @ [1, 0, 0], [0, 0, 1], atol=1e-12)
    assert (sampled.focal_px, sampled.power, sampled.ambient) == (pytest.approx(640), 2, 0.5)
    plain, config = (
        cheap(),
        cheap(projector={"power": [1, 2], "ambient": 0.4, "pattern_width_px": 160, "pattern_height_px": 100}),
    )
    dark, lit = (render_pair(each, 0, 1) for each in (plain, config))
    for eye in EYES:
        assert not np.array_equal(dark.view(eye).image, lit.view(eye).image)
        np.testing.assert_array_equal(dark.view(eye).disparity, lit.view(eye).disparity)
    assert plain.digest() != config.digest()


def test_a_picture_is_thrown_as_it_is_and_a_dataset_goes_on_with_no_other(tmp_path):
    path, levels = tmp_path / "own.png", np.random.default_rng(4).integers(0, 256, (90, 140), np.uint8)
    Image.fromarray(levels).save(path)
    config = cheap(projector={"power": 1, "pattern": str(path), "pattern_width_px": 140, "pattern_height_px": 90})
    np.testing.assert_array_equal(find_pattern(config.projector), levels)
    with PairRenderer(config, 1) as renderer:
        np.testing.assert_array_equal(renderer.sources.pattern, levels)
    generate(config, tmp_path / "set", 1)
    Image.fromarray(levels + 1).save(path)
    with pytest.raises(InputError, match="pattern"):
        generate(config, tmp_path / "set", 2)
    section = ProjectorSection(power=1, pattern=str(path))
    with pytest.raises(InputError, match=r"expected 1280 x 800 px, got 140 x 90 px .*: set pattern_width_px"):
        find_pattern(section)
    path.unlink()
    with pytest.raises(InputError, match=r"projector.pattern: .*own\.png: cannot be read: No such file"):
        find_pattern(section)
