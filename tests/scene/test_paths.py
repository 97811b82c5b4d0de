"""Paths of falling models: nothing in view appears or disappears, whatever the camera, its sway and the drift."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from semisynth_gl.config import Range
from semisynth_gl.config.scene_sections import ParticlesSection
from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.scene.particles import Batch, particles_at, sample_release, sample_slots, stated_sizes
from semisynth_gl.scene.rig import NO_SWAY, Sway

COUNT = 40
_UNIT = np.random.default_rng(0).normal(size=(300, 3))
SPHERE = _UNIT / np.linalg.norm(_UNIT, axis=1, keepdims=True)


@st.composite
def rigs(draw):
    """A camera, the depth of its near plane, and a sway that turns by up to 5 degrees about any axis."""
    width, height = draw(st.integers(60, 400)), draw(st.integers(60, 400))
    camera = StereoCamera.centred(width, height, width * draw(st.floats(0.5, 3)), 0.3, width * draw(st.floats(0, 0.3)))
    turn, shift = draw(st.floats(0, 0.05)), draw(st.floats(0, 0.01))
    sway = Sway(np.full(3, shift), np.full(3, turn), np.linspace(1, 3, 6), np.arange(6.0))
    return camera, float(camera.depth_m(0.5 * width)), sway if draw(st.booleans()) else NO_SWAY


@settings(max_examples=100)
@given(rigs(), st.floats(0, 1.5), st.floats(0, 1), st.floats(0.5, 50) | st.just(np.inf), st.integers(0, 1000))
def test_nothing_in_view_appears_or_disappears(rig, drift, size, relief_px, seed):
    (camera, near_m, sway), rng = rig, np.random.default_rng(seed)
    section = ParticlesSection(drift=Range(drift, 2 * drift), size_px=Range(5, 5 + size * camera.width_px))
    batches = [Batch(1.0, 0.5 * camera.width_px, COUNT, stated_sizes(section))]
    slots = sample_slots(camera, section, batches, rng, near_m, sway, relief_px)
    assert (slots.flatness * slots.radius_px <= relief_px * (1 + 1e-9)).all()
    release = sample_release(camera, section, slots, rng)

    def seen(age, time_s):
        """Points (S, 300, 3) of the spheres around all models that are shown, in the swaying left camera's frame."""
        of_age = replace(slots, phase=np.full(COUNT, age))
        state = particles_at(camera, of_age, lambda _: release, 0.0, np.zeros(COUNT, np.int64))
        depth_m = np.linalg.norm(state.world_from_model[:, 2, :3], axis=1)
        assert (depth_m <= slots.flatness * state.radius_m * (1 + 1e-9)).all()
        balls = SPHERE * state.radius_m[:, None, None]
        balls[..., 2] *= slots.flatness[:, None]
        points = (state.world_from_model[:, None, :3, 3] + balls)[slots.shown]
        pose = sway.camera_from_world(time_s)
        return points @ pose[:3, :3].T + pose[:3, 3]

    for time_s in rng.uniform(0, 100, 3):
        for age in (0.0, 1.0):
            for eye in EYES:
                x, y, z = np.moveaxis(seen(age, time_s) - [camera.offset_m(eye), 0, 0], -1, 0)
                column, row = camera.focal_px * x / z + camera.cx_px(eye), camera.focal_px * y / z + camera.cy_px
                across, down = np.abs(2 * column + 1 - camera.width_px), np.abs(2 * row + 1 - camera.height_px)
                assert not ((z > 0) & (across < camera.width_px) & (down < camera.height_px - 1e-6)).any()
        for age in rng.random(3):
            assert (seen(age, time_s)[..., 2] > near_m * (1 - 1e-9)).all()


def test_models_whose_drift_would_take_them_too_near_are_still_shown():
    camera = StereoCamera.centred(300, 200, 300.0, 0.3)
    section = ParticlesSection(drift=Range(1, 1), size_px=Range(20, 20))
    near_m = float(camera.depth_m(150.0))
    slots = sample_slots(
        camera, section, [Batch(135.0, 135.0, 50, stated_sizes(section))], np.random.default_rng(0), near_m
    )
    release = sample_release(camera, section, slots, np.random.default_rng(0))
    assert slots.shown.all()
    # A free path of this length would pass the near plane.
    assert (slots.depth_m - 0.5 * slots.path_m < near_m).all()
    assert np.abs(release.drift[:, 1]).max() > 0.9
    no_room = sample_slots(
        camera, section, [Batch(149.0, 149.0, 5, stated_sizes(section))], np.random.default_rng(0), near_m
    )
    assert not no_room.shown.any()
