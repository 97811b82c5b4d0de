"""Optical flow and change of disparity where points are hidden or gone, and the motion of sequences."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import SQUARE, facing, noise_layers, one_model
from tiny_datasets import lean

from semisynth_gl.config import Range, load_config
from semisynth_gl.config.rig_sections import CameraSection
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.frame.channels import MOTION_OUTPUTS, OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.scene.background import sample_plane
from semisynth_gl.scene.rig import NO_SWAY, SequenceRig, sample_sway
from semisynth_gl.scene.scene import SceneMotion, move

CAMERA = StereoCamera(200, 150, 220.0, 0.2, 95.0, 103.0, 70.0)
WALL, CARD = facing(CAMERA, -400, -400, 1200, 1200, 2.0), facing(CAMERA, 50, 40, 60, 50, 1.0)
ON_CARD = np.s_[40:90, 50:110]
METRE = 1.0 / CAMERA.focal_px


def moving():
    """Make a small config with a moving camera, and falling, drifting and spinning models."""
    config = lean(sequence={"length": 3, "frame_s": 0.1}, camera={"sway_m": [0.02, 0.1], "sway_deg": 2.0})
    return config.model_copy(update={"outputs": ("visibility", *MOTION_OUTPUTS)})


def shifted(matrix, x=0.0, y=0.0, z=0.0):
    result = matrix.copy()
    result[:3, 3] += x, y, z
    return result


@pytest.fixture
def render(open_renderer):
    """Return a function that renders squares with their flow to the next poses."""
    renderer = open_renderer([SQUARE], noise_layers(1, 64), outputs=MOTION_OUTPUTS)

    def rendered(now, then, *, near_m=0.01, instance=None):
        current = one_model(CAMERA, now, near_m=near_m)
        motion = move(current, world_from_model=then)
        if instance is not None:
            motion = replace(motion, instance=np.array(instance))
        return renderer.render(current, future=motion, past=motion)

    return rendered


@pytest.mark.one_backend
def test_what_is_hidden_gone_or_outside_then_is_marked(render):
    where = np.s_
    for then, instance, marks in (
        # The card stays visible and hides part of the wall.
        (shifted(CARD, 30 * METRE, 15 * METRE), None, [(where[55:105, 80:140], OCCLUDED), (ON_CARD, VISIBLE)]),
        # The card's right half leaves the image.
        (shifted(CARD, 120 * METRE), None, [(where[40:90, 170:], OCCLUDED), (where[40:90, 80:110], OUTSIDE)]),
        (CARD, [0, -1], [(ON_CARD, OCCLUDED)]),
    ):
        expected = np.full((150, 200), VISIBLE)
        for place, mark in marks:
            expected[place] = mark
        frame = render([WALL, CARD], [WALL, then], instance=instance)
        np.testing.assert_array_equal(frame.left.flow_visibility, expected)
        np.testing.assert_array_equal(frame.left.flow_backward_visibility, expected)


@pytest.mark.one_backend
def test_points_that_are_behind_or_nowhere_have_no_flow(render):
    nothing = np.ones((150, 200), bool)
    nothing[ON_CARD] = False
    alone = render([CARD], [shifted(CARD, x=0.05)])
    np.testing.assert_allclose(alone.left.flow[~nothing], [[11.0, 0.0]] * 3000, atol=1e-5)
    behind = [render([WALL, CARD], [WALL, shifted(CARD, z=depth - 1.0)], near_m=0.5) for depth in (0.4, -1.0)]
    for frame, invalid in ((alone, nothing), *((each, ~nothing) for each in behind)):
        assert np.isposinf(frame.left.flow[invalid]).all()
        assert np.isposinf(frame.left.disparity_change[invalid]).all()
        assert (frame.left.flow_visibility[invalid] == OUTSIDE).all()
        assert np.isfinite(frame.left.flow[~invalid]).all()
    # f B = 44 px m and doffs = 8 px, so points beyond 5.5 m have no disparity.
    near, far = facing(CAMERA, 0, 0, 100, 150, 5.0), facing(CAMERA, 100, 0, 100, 150, 6.0)
    frame = render([near, far], [shifted(near, z=1.0), shifted(far, z=-1.0)])
    assert np.isposinf(frame.left.disparity_change).all()
    assert np.isfinite(frame.left.flow).all()


@pytest.mark.one_backend
def test_motions_that_do_not_fit_are_refused(open_renderer):
    scene = one_model(CAMERA, [WALL])
    for output, name in (("disparity_change", "future"), ("flow_backward", "past")):
        renderer = open_renderer([SQUARE], noise_layers(1, 64), outputs=(output,))
        for motions, said in (
            ({}, rf"the output {output} needs the scene's motion.*{name}="),
            ({name: move(one_model(CAMERA, [WALL, WALL]))}, "expected 1 instance, those of the scene, got 2"),
            ({name: move(replace(scene, camera=replace(CAMERA, focal_px=221.0)))}, "expected the scene's camera"),
            ({name: move(replace(scene, model=np.array([3])))}, "model must be 0 to 0, got 3"),
        ):
            with pytest.raises(InputError, match=said):
                renderer.render(scene, **motions)
    for poses, instance, said in (
        (scene.world_from_model, [1], "instance must be -1 to 0, got 1 to 1"),
        (scene.world_from_model, [0, 0], r"expected instance \(N,\)"),
        (scene.world_from_model * np.nan, [0], "got nan"),
    ):
        with pytest.raises(InputError, match=said):
            SceneMotion(scene, poses, np.array(instance))


# Sequences


def test_a_motion_leads_to_the_frame_that_is_rendered_next():
    with PairRenderer(moving(), 4) as renderer:
        sampler = renderer.sampler
    for index, step in ((0, 1), (1, -1), (2, -1), (300, 1)):
        sampled, then = sampler.sample(index), sampler.sample(index + step)
        motion = sampled.motion(step)
        np.testing.assert_array_equal(motion.scene.world_from_model, then.scene.world_from_model)
        np.testing.assert_array_equal(motion.scene.camera_from_world, then.scene.camera_from_world)
        there = motion.instance >= 0
        assert there.mean() > 0.5
        moved = then.scene.world_from_model[motion.instance[there]]
        np.testing.assert_allclose(motion.world_from_model[there], moved, atol=1e-12)
        # The model keeps its texture and UV, so that no texture slides over a surface.
        for name in ("model", "layer", "uv_scale", "uv_offset"):
            one, other = getattr(sampled.scene, name)[there], getattr(then.scene, name)[motion.instance[there]]
            np.testing.assert_allclose(one, other, rtol=1e-12, err_msg=name)


def test_motion_goes_on_beyond_both_ends_of_a_sequence():
    with PairRenderer(moving(), 4) as renderer:
        first, last = (renderer.sampler.sample(index) for index in (0, 2))
    for sampled, motion, down in ((first, first.motion(-1), -1), (last, last.motion(+1), 1)):
        still = sampled.instances["slot"] < 0
        np.testing.assert_array_equal(motion.world_from_model[still], sampled.scene.world_from_model[still])
        # Models fall, so earlier they were higher, even before their release.
        lower = motion.world_from_model[~still, 1, 3] - sampled.scene.world_from_model[~still, 1, 3]
        assert (down * lower > 0).all()
    far = [first.motion(-step) for step in (400, 900)]
    # Long before time 0, as many other models were there, and different ones at different times.
    assert (far[0].instance[first.instances["slot"] >= 0] == -1).all()
    assert len(far[0].scene) > 0.5 * len(first.scene)
    one, other = (motion.scene.model[int((first.instances["slot"] < 0).sum()) :] for motion in far)
    common = min(len(one), len(other))
    assert (one[:common] == other[:common]).mean() < 0.5


def section_of(**changes):
    return CameraSection(
        **{"width_px": 60, "height_px": 40, "focal_px": Range(60, 60), "baseline_m": Range(0.2, 0.2)} | changes
    )


def test_a_sway_is_smooth_bounded_and_comes_back():
    section = section_of(sway_m=Range(0.1, 0.2), sway_deg=Range(1, 5), sway_s=Range(2.0, 2.0))
    sway, times = sample_sway(section, np.random.default_rng(0)), np.linspace(0, 4, 400)
    poses = np.array([sway.camera_from_world(time) for time in times])
    np.testing.assert_allclose(poses[0], sway.camera_from_world(2.0), atol=1e-12)
    turns = poses[:, :3, :3]
    np.testing.assert_allclose(turns @ turns.transpose(0, 2, 1), np.tile(np.eye(3), (400, 1, 1)), atol=1e-12)
    place = np.linalg.inv(poses)[:, :3, 3]
    assert 0.1 < np.linalg.norm(place, axis=1).max() <= sway.reach_m + 1e-12
    angle = np.arccos(np.clip((np.trace(turns, axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert np.deg2rad(1) < angle.max() <= sway.angle_rad + 1e-9
    # The speed is at most that of a sine with this amplitude and period.
    assert np.abs(np.diff(place, axis=0)).max() <= 1.001 * np.pi * sway.shift_m.max() * (times[1] - times[0])
    np.testing.assert_array_equal(NO_SWAY.camera_from_world(3.3), np.eye(4))


def test_a_sway_too_wide_for_a_far_plane_is_refused():
    camera, rng = StereoCamera.centred(600, 400, 300.0, 0.2), np.random.default_rng(0)
    sway = sample_sway(section_of(sway_deg=Range(40, 40)), rng)
    with pytest.raises(InputError, match=r"up to 120 degrees off .* than 85: lower camera\.sway_deg, raise the"):
        sample_plane(load_config("kitti"), SequenceRig((camera,), sway=sway), rng)
    wide, sway = StereoCamera.centred(600, 400, 20.0, 0.2), sample_sway(section_of(sway_m=Range(1, 1)), rng)
    with pytest.raises(InputError, match="up to 87 degrees off"):
        sample_plane(load_config("kitti"), SequenceRig((wide,), sway=sway), rng)
