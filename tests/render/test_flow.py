"""Optical flow and change of disparity: against formulas, against the oracle, and against what other frames show."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import assert_equal, facing, noise_layers, one_model, posed
from tiny_datasets import lean

from semisynth_gl import oracle
from semisynth_gl.config import Range
from semisynth_gl.config.rig_sections import CameraSection, DisparitySection
from semisynth_gl.config.scene_sections import BackgroundSection
from semisynth_gl.frame.camera import EYES, Crop, StereoCamera
from semisynth_gl.frame.channels import OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.render import listed_steps
from semisynth_gl.scene.background import sample_cuboid, sample_kind, sample_plane
from semisynth_gl.scene.instances import to_scene
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.rig import NO_SWAY, near_depth_m, rotation_about_axis, sample_sway
from semisynth_gl.scene.scene import Motion, move
from semisynth_gl.scene.structures import SURFACE_MODELS

CAMERA = StereoCamera(200, 150, 220.0, 0.2, 95.0, 103.0, 70.0)
WALL, CARD = facing(CAMERA, -400, -400, 1200, 1200, 2.0), facing(CAMERA, 50, 40, 60, 50, 1.0)
FLOWS = ("flow", "flow_backward", "disparity_change")
FAST = {"sway_deg": Range(15.0, 20.0), "sway_s": Range(0.4, 0.6)}
MOVING = {"sequence": {"length": 3, "frame_s": 0.1}, "camera": {"sway_m": [0.02, 0.1], "sway_deg": 2.0}}


def moving(**changes):
    """A small config with much motion: the camera's, and falling, drifting, spinning models."""
    config = lean(**MOVING)
    return config.model_copy(update={"outputs": ("visibility", *FLOWS)} | changes)


def shifted(matrix, x=0.0, y=0.0, z=0.0):
    result = matrix.copy()
    result[:3, 3] += x, y, z
    return result


def pixels(camera):
    y, x = np.mgrid[: camera.height_px, : camera.width_px].astype(float)
    return x, y


@pytest.fixture
def draw(open_renderer, square):
    """Draw squares, and where they and the camera are next."""

    def drawn(now, then, *, then_camera=None, near_m=0.01, instance=None):
        renderer = open_renderer([square], noise_layers(1, 64), outputs=FLOWS)
        current = one_model(CAMERA, now, near_m=near_m)
        motion = move(current, world_from_model=then, camera_from_world=then_camera)
        if instance is not None:
            motion = replace(motion, instance=np.array(instance))
        return renderer.render(current, future=motion, past=motion)

    return drawn


def test_a_plane_that_moves_sideways_and_away_has_the_flow_of_the_formula(draw):
    frame = draw([WALL], [shifted(WALL, 0.1, -0.05, 0.5)])
    for eye in EYES:
        x, y = pixels(CAMERA)
        # (X + 0.1) / 2.5 instead of X / 2, in pixels.
        u = (x - CAMERA.cx_px(eye)) * (2.0 / 2.5 - 1) + CAMERA.focal_px * 0.1 / 2.5
        v = (y - CAMERA.cy_px) * (2.0 / 2.5 - 1) - CAMERA.focal_px * 0.05 / 2.5
        np.testing.assert_allclose(frame.view(eye).flow, np.stack([u, v], 2), atol=3e-5)
        np.testing.assert_array_equal(frame.view(eye).flow, frame.view(eye).flow_backward)
        change = CAMERA.focal_baseline * (1 / 2.5 - 1 / 2.0)
        np.testing.assert_allclose(frame.view(eye).disparity_change, change, atol=5e-6)
        inside = (x + u >= -0.5) & (x + u < 199.5) & (y + v >= -0.5) & (y + v < 149.5)
        expected = np.where(inside, VISIBLE, OUTSIDE)
        border = np.minimum(np.abs(x + u + 0.5), np.abs(x + u - 199.5)) < 1e-3
        np.testing.assert_array_equal(frame.view(eye).flow_visibility[~border], expected[~border])


def test_a_camera_that_turns_sees_the_flow_of_a_homography(draw):
    turn = rotation_about_axis(np.array([[0.0, 1, 0]]), np.array([0.05]))[0]
    frame = draw([WALL], None, then_camera=posed(turn))
    x, y = pixels(CAMERA)
    then = CAMERA.rays("left", x, y) @ turn.T
    u = CAMERA.focal_px * then[..., 0] / then[..., 2] + CAMERA.cx_left_px - x
    v = CAMERA.focal_px * then[..., 1] / then[..., 2] + CAMERA.cy_px - y
    np.testing.assert_allclose(frame.left.flow, np.stack([u, v], 2), atol=3e-5)
    # The right eye stands aside of the axis, and so comes nearer or goes away.
    then = (CAMERA.rays("right", x, y) * 2 + (0.2, 0, 0)) @ turn.T - (0.2, 0, 0)
    u = CAMERA.focal_px * then[..., 0] / then[..., 2] + CAMERA.cx_right_px - x
    np.testing.assert_allclose(frame.right.flow[..., 0], u, atol=3e-5)


def test_what_stands_still_has_no_flow_at_all(draw):
    frame = draw([WALL, CARD], None)
    assert (frame.left.flow == 0).all()
    assert (frame.right.disparity_change[np.isfinite(frame.right.disparity)] == 0).all()
    assert (frame.left.flow_visibility == VISIBLE).all()
    assert (frame.right.flow_backward_visibility == VISIBLE).all()


def test_what_is_hidden_gone_or_outside_then_is_marked(draw):
    metre = 1.0 / CAMERA.focal_px
    frame = draw([WALL, CARD], [WALL, shifted(CARD, x=30 * metre, y=15 * metre)])
    expected = np.full((150, 200), VISIBLE)
    expected[55:105, 80:140] = OCCLUDED  # where the card is then,
    expected[40:90, 50:110] = VISIBLE  # but the card itself is seen on
    np.testing.assert_array_equal(frame.left.flow_visibility, expected)

    frame = draw([WALL, CARD], [WALL, shifted(CARD, x=120 * metre)])
    expected = np.full((150, 200), VISIBLE)
    expected[40:90, 170:200] = OCCLUDED
    expected[40:90, 80:110] = OUTSIDE  # the card's own right half leaves the image
    np.testing.assert_array_equal(frame.left.flow_visibility, expected)

    frame = draw([WALL, CARD], None, instance=[0, -1])
    expected = np.full((150, 200), VISIBLE)
    expected[40:90, 50:110] = OCCLUDED
    np.testing.assert_array_equal(frame.left.flow_visibility, expected)
    assert (frame.left.flow == 0).all()


def test_points_behind_the_near_plane_then_have_no_flow(draw):
    for depth in (0.4, -1.0):
        frame = draw([WALL, CARD], [WALL, shifted(CARD, z=depth - 1.0)], near_m=0.5)
        assert np.isposinf(frame.left.flow[40:90, 50:110]).all()
        assert np.isposinf(frame.left.disparity_change[40:90, 50:110]).all()
        assert (frame.left.flow_visibility[40:90, 50:110] == OUTSIDE).all()
        assert (frame.left.flow[:, :50] == 0).all()


def test_where_nothing_is_seen_there_is_no_flow(draw):
    frame = draw([CARD], [shifted(CARD, x=0.05)])
    nothing = np.ones((150, 200), bool)
    nothing[40:90, 50:110] = False
    assert np.isposinf(frame.left.flow[nothing]).all()
    assert np.isposinf(frame.left.disparity_change[nothing]).all()
    assert (frame.left.flow_visibility[nothing] == OUTSIDE).all()
    np.testing.assert_allclose(frame.left.flow[~nothing], [[11.0, 0.0]] * 3000, atol=1e-5)


def test_disparities_that_the_rig_makes_negative_have_no_change(draw):
    # f B = 44 px m and doffs = 8 px: beyond 5.5 m there is no disparity.
    near, far = facing(CAMERA, 0, 0, 100, 150, 5.0), facing(CAMERA, 100, 0, 100, 150, 6.0)
    frame = draw([near, far], [shifted(near, z=1.0), shifted(far, z=-1.0)])
    assert np.isposinf(frame.left.disparity_change).all()
    assert np.isfinite(frame.left.flow).all()


def test_a_model_flattened_by_its_matrix_has_flow(draw):
    wall = WALL.copy()
    wall[2, 2] = 0.0
    assert np.linalg.matrix_rank(wall[:3, :3]) == 2
    turned = wall.copy()
    turned[:3, :3] = rotation_about_axis(np.array([[0.0, 0, 1]]), np.array([0.3]))[0] @ wall[:3, :3]
    frame = draw([wall], [turned])
    x, y = (each.ravel() for each in pixels(CAMERA))
    corner = turned[:3, :3] @ np.linalg.pinv(wall[:3, :3])
    then = (CAMERA.rays("left", x, y) * 2 - wall[:3, 3]) @ corner.T + wall[:3, 3]
    u = CAMERA.focal_px * then[:, 0] / then[:, 2] + CAMERA.cx_left_px - x
    np.testing.assert_allclose(frame.left.flow[..., 0].ravel(), u, atol=2e-4)


@pytest.mark.one_backend
def test_flow_is_the_oracles_at_a_hundred_pixels_of_motion(backend):
    config = moving()
    config = config.model_copy(update={"camera": config.camera.model_copy(update=FAST)})
    errors, motion, alike = [], [], []
    with PairRenderer(config, 2, backend) as renderer:
        models = renderer.sampler.models
        for index in (0, 4):
            pair = renderer.render(index)
            sampled = renderer.sampler.sample(index)
            row, column = np.random.default_rng(index).integers(0, (pair.frame.left.image.shape[:2]), (4000, 2)).T
            x, y = column.astype(float), row.astype(float)
            for eye in EYES:
                hits = cast_rays(sampled.scene, models, eye, x, y)
                # Where an edge passes the pixel's centre, either surface may be seen.
                rendered = pair.frame.view(eye).disparity[row, column]
                same = np.abs(rendered - oracle.disparity_px(sampled.scene.camera, hits)) < 1e-3
                assert same.mean() > 0.995
                for name, step in (("flow", 1), ("flow_backward", -1)):
                    expected = oracle.flow(sampled.scene, models, sampled.motion(step), eye, x, y, hits)
                    flow = pair.frame.view(eye)[name][row, column]
                    seen = np.isfinite(expected.flow_px).all(axis=1) & same
                    assert np.array_equal(np.isfinite(flow).all(axis=1)[same], seen[same])
                    errors.append(np.abs(flow[seen] - expected.flow_px[seen]).max(axis=1))
                    motion.append(np.linalg.norm(expected.flow_px[seen], axis=1))
                    visibility = pair.frame.view(eye)[f"{name}_visibility"][row, column]
                    alike.append((visibility == expected.visibility)[same])
                    if name == "flow":
                        change = pair.frame.view(eye).disparity_change[row, column]
                        both = np.isfinite(expected.disparity_change_px) & same
                        assert np.array_equal(np.isfinite(change)[same], both[same])
                        assert np.abs(change[both] - expected.disparity_change_px[both]).max() < 2e-4
    # A tenth of the image's width would be 19 px: motion here is of the order of a hundred.
    assert np.median(np.concatenate(motion)) > 30
    assert np.percentile(np.concatenate(motion), 95) > 80
    assert np.percentile(np.concatenate(errors), 99.9) < 2e-4
    # Models have parts of a fraction of a pixel here; what passes between four pixels and none of them shows is missed.
    assert np.concatenate(alike).mean() > 0.995


@pytest.mark.one_backend
def test_flow_to_the_next_frame_is_undone_by_its_flow_back(backend):
    with PairRenderer(moving(), 1, backend) as renderer:
        now, then = renderer.render(0).frame, renderer.render(1).frame
    x, y = pixels(now.camera)
    for eye in EYES:
        flow, back = now.view(eye).flow, then.view(eye).flow_backward
        visible = now.view(eye).flow_visibility == VISIBLE
        assert 0.5 < visible.mean() < 0.99
        column = np.rint(x + np.where(visible, flow[..., 0], 0)).astype(int)
        row = np.rint(y + np.where(visible, flow[..., 1], 0)).astype(int)
        there = back[row.clip(0, y.shape[0] - 1), column.clip(0, x.shape[1] - 1)]
        apart = np.abs(flow + there).max(axis=2)[visible]
        # The nearest pixel is up to half a pixel away, where flow differs by what changes within that.
        assert np.median(apart) < 0.1
        assert np.percentile(apart, 80) < 0.3
        change = now.view(eye).disparity_change
        d_now, d_then = now.view(eye).disparity, then.view(eye).disparity
        difference = d_then[row.clip(0, y.shape[0] - 1), column.clip(0, x.shape[1] - 1)] - d_now - change
        assert np.median(np.abs(difference[visible])) < 0.05


@pytest.mark.one_backend
def test_crops_and_bands_of_flow_are_those_of_the_whole_image(backend, monkeypatch):
    with PairRenderer(moving(), 1, backend) as renderer:
        whole = renderer.render(1).frame
        crop = Crop(40, 30, 61, 47)
        assert_equal(renderer.render(1, crop=crop).frame, whole, crop)
        assert_equal(renderer.render(1, crop=crop, checked=False).frame, whole, crop)
        monkeypatch.setattr(listed_steps, "_MOST_PIXELS", 1000)
        assert_equal(renderer.render(1, crop=crop, checked=False).frame, whole, crop)


@pytest.mark.one_backend
def test_flow_alone_needs_no_other_output_and_changes_none(backend):
    with PairRenderer(moving(), 1, backend) as renderer:
        every = renderer.render(0).frame
    for output in FLOWS:
        with PairRenderer(moving(outputs=(output,), truth="left"), 1, backend) as renderer:
            frame = renderer.render(0).frame
        np.testing.assert_array_equal(frame.left.image, every.left.image)
        np.testing.assert_array_equal(frame.left.disparity, every.left.disparity)
        assert not {"visibility", "depth"} & set(frame.left)
        assert set(FLOWS) & set(frame.left) == {output}
        np.testing.assert_array_equal(frame.left[output], every.left[output])
        assert set(frame.right) == {"image"}


@pytest.mark.one_backend
def test_renderers_and_motions_that_do_not_fit_are_refused(open_renderer, square):
    wall = facing(CAMERA, 0, 0, 100, 100, 2.0)
    scene = one_model(CAMERA, [wall])
    for output, name in (("flow", "future"), ("disparity_change", "future"), ("flow_backward", "past")):
        renderer = open_renderer([square], noise_layers(1, 64), outputs=(output,))
        with pytest.raises(InputError, match=rf"the output {output} needs the scene's motion.*{name}="):
            renderer.render(scene)
        two = one_model(CAMERA, [wall, wall])
        with pytest.raises(InputError, match="expected 1 instance, those of the scene, got 2"):
            renderer.render(scene, **{name: move(two)})
        other = replace(scene, camera=StereoCamera(200, 150, 221.0, 0.2, 95.0, 103.0, 70.0))
        with pytest.raises(InputError, match="expected the scene's camera"):
            renderer.render(scene, **{name: move(other)})
        missing = replace(scene, model=np.array([3]))
        with pytest.raises(InputError, match="model must be 0 to 0, got 3"):
            renderer.render(scene, **{name: move(missing)})
    with pytest.raises(InputError, match="instance must be -1 to 0, got 1 to 1"):
        Motion(scene, scene.world_from_model, np.array([1]))
    with pytest.raises(InputError, match=r"expected instance \(N,\)"):
        Motion(scene, scene.world_from_model, np.array([0, 0]))
    with pytest.raises(InputError, match="not finite"):
        Motion(scene, scene.world_from_model * np.nan, np.array([0]))


def test_a_motion_leads_to_the_frame_that_is_rendered_next():
    config = moving()
    with PairRenderer(config, 4) as renderer:
        sampler = renderer.sampler
    for index, step in ((0, 1), (1, 1), (1, -1), (2, -1), (300, 1)):
        sampled, then = sampler.sample(index), sampler.sample(index + step)
        motion = sampled.motion(step)
        np.testing.assert_array_equal(motion.scene.world_from_model, then.scene.world_from_model)
        np.testing.assert_array_equal(motion.scene.camera_from_world, then.scene.camera_from_world)
        there = motion.instance >= 0
        assert there.mean() > 0.5
        np.testing.assert_allclose(
            motion.world_from_model[there], then.scene.world_from_model[motion.instance[there]], atol=1e-12
        )
        # The same model in the same texture, at the same place of it: nothing slides over a surface.
        for name in ("model", "layer", "uv_scale", "uv_offset"):
            one, other = getattr(sampled.scene, name)[there], getattr(then.scene, name)[motion.instance[there]]
            np.testing.assert_allclose(one, other, rtol=1e-12, err_msg=name)


def test_motion_goes_on_beyond_both_ends_of_a_sequence():
    with PairRenderer(moving(), 4) as renderer:
        sampler = renderer.sampler
    first, last = sampler.sample(0), sampler.sample(2)
    before, after = first.motion(-1), last.motion(+1)
    far = [first.motion(-step) for step in (400, 900)]
    for sampled, motion in ((first, before), (last, after)):
        still = sampled.instances["slot"] < 0
        np.testing.assert_array_equal(motion.world_from_model[still], sampled.scene.world_from_model[still])
        # Models fall: a moment earlier they were higher, though they may not have been released.
        lower = motion.world_from_model[~still, 1, 3] - sampled.scene.world_from_model[~still, 1, 3]
        assert ((lower < 0) if motion is before else (lower > 0)).all()
    # Long before time 0 other models were there, as many, and not the same every time.
    assert (far[0].instance[first.instances["slot"] >= 0] == -1).all()
    assert len(far[0].scene) > 0.5 * len(first.scene)
    # A slot's models of different generations have nothing to do with each other.
    one, other = (motion.scene.model[int((first.instances["slot"] < 0).sum()) :] for motion in far)
    common = min(len(one), len(other))
    assert (one[:common] == other[:common]).mean() < 0.5


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**31), st.floats(0, 0.3), st.floats(0, 15), st.floats(0, 1), st.floats(0, 40))
def test_walls_keep_clear_of_a_camera_that_sways(seed, shift, turn, plane, doffs):
    camera = StereoCamera.centred(60, 40, 60.0, 0.2, doffs)
    disparity = DisparitySection(min_px=1.0, max_px=40.0)
    section = BackgroundSection(cuboid=1.0 - plane, plane=plane, wall_disparity_px=Range(2, 20))
    section_camera = CameraSection(width_px=60, height_px=40, focal_px=Range(60, 60), baseline_m=Range(0.2, 0.2))
    section_camera = section_camera.model_copy(update={"sway_m": Range(0, shift), "sway_deg": Range(0, turn)})
    rng = np.random.default_rng(seed)
    sway = sample_sway(section_camera, rng)
    if sample_kind(section, rng) == "plane":
        table = sample_plane(section, disparity, camera, rng, sway)
    else:
        table, _ = sample_cuboid(section, disparity, camera, rng, sway)
    x, y = (each.ravel() for each in np.meshgrid(np.linspace(-0.49, 59.47, 9), np.linspace(-0.48, 39.49, 7)))
    for time_s in (0.0, 0.31, 7.9):
        scene = to_scene(table, camera, 1e-3, sway.camera_from_world(time_s))
        for eye in EYES:
            hits = cast_rays(scene, SURFACE_MODELS, eye, x, y)
            assert np.isfinite(hits.depth_m).all()
            assert hits.depth_m.min() >= near_depth_m(camera, disparity)


def test_a_sway_is_smooth_bounded_and_comes_back():
    section = CameraSection(
        width_px=8,
        height_px=8,
        focal_px=Range(8, 8),
        baseline_m=Range(0.1, 0.1),
        sway_m=Range(0.1, 0.2),
        sway_deg=Range(1, 5),
        sway_s=Range(2.0, 2.0),
    )
    sway = sample_sway(section, np.random.default_rng(0))
    times = np.linspace(0, 4, 400)
    poses = np.array([sway.camera_from_world(time) for time in times])
    np.testing.assert_allclose(poses[0], sway.camera_from_world(2.0), atol=1e-12)
    np.testing.assert_allclose(
        poses[:, :3, :3] @ poses[:, :3, :3].transpose(0, 2, 1), np.tile(np.eye(3), (400, 1, 1)), atol=1e-12
    )
    place = np.linalg.inv(poses)[:, :3, 3]
    assert 0.1 < np.linalg.norm(place, axis=1).max() <= sway.reach_m + 1e-12
    assert np.abs(place).max(axis=0) == pytest.approx(sway.shift_m, rel=1e-3)
    angle = np.arccos(np.clip((np.trace(poses[:, :3, :3], axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert np.deg2rad(1) < angle.max() <= sway.angle_rad + 1e-9
    # Speeds are those of a sine of that amplitude and period.
    assert np.abs(np.diff(place, axis=0)).max() <= 1.001 * np.pi * sway.shift_m.max() * (times[1] - times[0])
    np.testing.assert_array_equal(NO_SWAY.camera_from_world(3.3), np.eye(4))


def test_a_sway_too_wide_for_a_far_plane_is_refused():
    camera = StereoCamera.centred(600, 400, 300.0, 0.2)
    section = CameraSection(
        width_px=600, height_px=400, focal_px=Range(300, 300), baseline_m=Range(0.2, 0.2), sway_deg=Range(40, 40)
    )
    background = BackgroundSection(cuboid=0.0, plane=1.0)
    rng = np.random.default_rng(0)
    sway = sample_sway(section, rng)
    with pytest.raises(InputError, match=r"camera\.sway_deg turns views by up to 69 degrees"):
        sample_plane(background, DisparitySection(min_px=1.0, max_px=64.0), camera, rng, sway)


@pytest.mark.one_backend
def test_flow_of_many_sizes_leaves_nothing_behind(open_renderer, square):
    renderer = open_renderer([square], noise_layers(1, 64), outputs=("visibility", *FLOWS))

    def counted():
        for width in (200, 120, 61):
            camera = StereoCamera.centred(width, 40, 100.0, 0.1)
            wall = facing(camera, -50, -50, width + 100, 140, 2.0)
            # More instances than there is room for at first.
            count = 700 if width == 61 else 2
            scene = one_model(camera, [wall] * count)
            motion = move(scene, world_from_model=[shifted(wall, 0.02)] * count)
            frame = renderer.render(scene, future=motion, past=motion)
            np.testing.assert_allclose(frame.left.flow[..., 0], 1.0, atol=1e-5)
        return renderer.count_objects()

    assert counted() == counted()
