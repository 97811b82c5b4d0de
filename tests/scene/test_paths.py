"""Particle paths: their formulas, and that no particle appears or disappears while it is in view."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from samplers import still_rig

from semisynth_gl.config import Range
from semisynth_gl.config.scene_sections import ParticlesSection
from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.scene.particles import ParticleLayer, particle_poses, sample_generation, sample_slots, stated_sizes
from semisynth_gl.scene.rig import CameraSway

CAMERA = StereoCamera(600, 400, 700.0, 0.2, 280.0, 320.0, 190.0)
COUNT = 40
_UNIT = np.random.default_rng(0).normal(size=(300, 3))
SPHERE = _UNIT / np.linalg.norm(_UNIT, axis=1, keepdims=True)


@st.composite
def rigs(draw):
    """Sample a camera, its near plane, and a sway of up to 5 degrees about each axis."""
    width, height = draw(st.integers(60, 400)), draw(st.integers(60, 400))
    camera = StereoCamera.centred(width, height, width * draw(st.floats(0.5, 3)), 0.3, width * draw(st.floats(0, 0.3)))
    turn, shift = draw(st.floats(0, 0.05)), draw(st.floats(0, 0.01))
    sway = CameraSway(np.full(3, shift), np.full(3, turn), np.linspace(1, 3, 6), np.arange(6.0))
    rig = still_rig(camera, 0.5 * width)
    return replace(rig, sway=sway) if draw(st.booleans()) else rig


def slots_of(rig, section, *ranges, seed=2):
    """Sample slots of `COUNT` particles for each disparity range; also return a function that starts a generation."""
    batches = [ParticleLayer(Range(*ends), COUNT, stated_sizes(section)) for ends in ranges]
    slots = sample_slots(rig, section, batches, np.random.default_rng(seed))
    return slots, lambda number: sample_generation(rig.camera, section, slots, np.random.default_rng([3, number]))


def stream(**options):
    return slots_of(still_rig(CAMERA, 1e9), ParticlesSection(**options), (20.0, 30.0), (60.0, 90.0))


def poses_at(slots, release, time_s):
    return particle_poses(CAMERA, slots, release, time_s, slots.generation(time_s))


@settings(max_examples=100)
@given(rigs(), st.floats(0, 1.5), st.floats(0, 1), st.floats(0.5, 50) | st.just(np.inf), st.integers(0, 1000))
def test_nothing_in_view_appears_or_disappears(rig, drift, size, relief_px, seed):
    camera, rng, rig = rig.camera, np.random.default_rng(seed), replace(rig, relief_px=relief_px)
    section = ParticlesSection(drift=Range(drift, 2 * drift), size_px=Range(5, 5 + size * camera.width_px))
    slots, release = slots_of(rig, section, (1.0, 0.5 * camera.width_px), seed=seed)
    assert (slots.flatness * slots.radius_px <= relief_px * (1 + 1e-9)).all()

    def seen(age, time_s):
        """Return points (S, 300, 3) on the bounding spheres of shown models, in the swaying left camera's frame."""
        of_age = replace(slots, phase=np.full(COUNT, age))
        poses = particle_poses(camera, of_age, release, 0.0, np.zeros(COUNT, np.int64))
        radius_m = slots.radius_m(camera)
        assert (np.linalg.norm(poses[:, 2, :3], axis=1) <= slots.flatness * radius_m * (1 + 1e-9)).all()
        balls = SPHERE * radius_m[:, None, None]
        balls[..., 2] *= slots.flatness[:, None]
        points = (poses[:, None, :3, 3] + balls)[slots.shown]
        pose = rig.sway.camera_from_world(time_s)
        return points @ pose[:3, :3].T + pose[:3, 3]

    for time_s in rng.uniform(0, 100, 3):
        for age in (0.0, 1.0):
            for eye in EYES:
                x, y, z = np.moveaxis(seen(age, time_s) - [camera.offset_m(eye), 0, 0], -1, 0)
                cx, cy, fx, fy = camera.intrinsics_px(eye)
                column, row = fx * x / z + cx, fy * y / z + cy
                across, down = np.abs(2 * column + 1 - camera.width_px), np.abs(2 * row + 1 - camera.height_px)
                assert not ((z > 0) & (across < camera.width_px) & (down < camera.height_px - 1e-6)).any()
        for age in rng.random(3):
            assert (seen(age, time_s)[..., 2] > rig.near_m * (1 - 1e-9)).all()


def test_models_whose_drift_would_take_them_too_near_are_still_shown():
    rig = still_rig(StereoCamera.centred(300, 200, 300.0, 0.3), 150.0)
    section = ParticlesSection(drift=Range(1, 1), size_px=Range(20, 20))
    slots, release = slots_of(rig, section, (135.0, 135.0))
    assert slots.shown.all()
    # Without a limit, a path of this length would cross the near plane.
    assert (slots.depth_m - 0.5 * slots.path_m < rig.near_m).all()
    assert np.abs(release(0).drift[:, 1]).max() > 0.9
    assert not slots_of(rig, section, (149.0, 149.0))[0].shown.any()


def test_particles_fall_at_constant_speed_and_are_released_anew():
    slots, release = stream(fall_m_s=Range(1, 1), drift=Range(0, 0), spin_deg_s=Range(90, 90))
    times = np.linspace(0, 3 * slots.period_s.max(), 400)
    generation = np.array([slots.generation(t) for t in times])
    y = np.array([poses_at(slots, release, t)[:, 1, 3] for t in times])
    later = np.diff(generation, axis=0)
    step = np.broadcast_to(np.diff(times)[:, None], later.shape)
    np.testing.assert_allclose(np.diff(y, axis=0)[later == 0], step[later == 0], rtol=1e-9)
    assert (later >= 0).all()
    assert generation.max() >= 3
    # At any depth, a path starts and ends where the bounding sphere touches the upper or lower side of the frustum.
    row, secant = (
        CAMERA.focal_px * y / slots.depth_m + CAMERA.cy_px,
        np.hypot(1, (CAMERA.cy_px + 0.5) / CAMERA.focal_px),
    )
    assert (row >= -0.5 - secant * slots.radius_px - 1e-6).all()
    assert row.min() < -0.5 - slots.radius_px.max()
    assert CAMERA.height_px < row.max() < CAMERA.height_px + 1.1 * slots.radius_px.max()


def test_poses_at_a_time_need_no_steps():
    slots, release = stream(spin_deg_s=Range(90, 90), stretch=Range(1, 1), drift=Range(0, 0))
    first, later = (poses_at(slots, release, time_s)[:, :3, :3] for time_s in (0.0, 1e-3))
    same = slots.generation(0.0) == slots.generation(1e-3)
    turn = later[same] @ np.linalg.inv(first[same])
    angle = np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1))
    np.testing.assert_allclose(np.rad2deg(angle), 0.09, rtol=1e-3)
    for time_s in (0.0, 1.7, 100.0):
        disparity = CAMERA.disparity_px(poses_at(slots, release, time_s)[:, 2, 3])
        assert [((disparity >= low) & (disparity <= high)).sum() for low, high in ((20, 30), (60, 90))] == [COUNT] * 2


def test_stretch_never_exceeds_the_bounding_sphere():
    slots, release = stream(stretch=Range(0.2, 1))
    largest = np.linalg.norm(poses_at(slots, release, 0.3)[:, :3, :3], axis=1).max(axis=1)
    np.testing.assert_allclose(largest, slots.radius_m(CAMERA))


def test_batches_of_more_particles_than_allowed_are_cut_in_proportion():
    section = ParticlesSection(most=50)
    batches = [
        ParticleLayer(Range(low, low), count, stated_sizes(section)) for low, count in ((20.0, 400), (60.0, 100))
    ]
    slots = sample_slots(still_rig(CAMERA, 1e9), section, batches, np.random.default_rng(2))
    assert np.unique(slots.disparity_px, return_counts=True)[1] == pytest.approx([40, 10], abs=1)
