"""Every pixel of a view has a positive disparity, and rooms keep to their range."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from samplers import catalogue, static_scene_of
from tiny_datasets import CLUTTER_ALONE

from semisynth_gl import load_config, render_pair
from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.scene.instances import to_scene
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.rig import BEYOND_NEAR, SequenceRig
from semisynth_gl.scene.view_volume import deepest_m

KINDS = ("cuboid", "plane", "room", "street")
# Every wall has a hole, since the deepest points are seen through holes.
PIERCED = (
    "room.doorway=0.6",
    "room.niche=0.4",
    "room.furniture=0",
    "room.small=0",
    "room.pictures=0",
    "room.curtain=0",
)


# Each view shows x / z from -0.5 to 0.5 of its eye; the right eye is at x = 0.1 m.
RIG = StereoCamera.centred(200, 100, focal_px=200, baseline_m=0.1)


@pytest.mark.parametrize(
    ("corners", "deepest"),
    [
        # A wall beside the axis enters the left view at z = 2, and stays in it.
        ([(1, -9, 1.5), (1, -9, 30), (1, 9, 30), (1, 9, 1.5)], 30.0),
        ([(-9, -9, 4), (9, -9, 4), (9, 9, 4), (-9, 9, 4)], 4.0),
        # The right view ends at x = z / 2 + 0.1. There the face has z = 5 + 0.8 (x - 2) = 5.8.
        ([(2, -9, 5), (4, -9, 6.6), (4, 9, 6.6), (2, 9, 5)], 5.8),
        ([(5, -9, 1), (9, -9, 1), (9, 9, 1), (5, 9, 1)], 0.0),
        ([(-1, -1, -4), (1, -1, -4), (1, 1, -4), (-1, 1, -4)], 0.0),
    ],
    ids=["along", "across", "partly", "aside", "behind"],
)
def test_only_what_a_view_shows_counts(corners, deepest):
    assert deepest_m(SequenceRig((RIG,)), np.array([corners], float)) == pytest.approx(deepest)


def seen_px(static, camera, time_s=0.0):
    """Cast rays on a grid from border to border of both views; return the disparities of static instances."""
    x_px, y_px = np.meshgrid(
        np.linspace(-0.4971, camera.width_px - 0.5013, 27), np.linspace(-0.4937, camera.height_px - 0.5029, 21)
    )
    scene = to_scene(static.instances, camera, static.rig.near_m, static.rig.sway.camera_from_world(time_s))
    hits = [cast_rays(scene, catalogue().models, eye, x_px.ravel(), y_px.ravel()) for eye in EYES]
    instance, depth_m = (np.concatenate([getattr(each, name) for each in hits]) for name in ("instance", "depth_m"))
    disparity = camera.disparity_px(depth_m)
    return np.where((instance >= 0) & (disparity > 0), disparity, np.inf)


@st.composite
def rigs(draw):
    """Sample config overrides of a rig; some rigs sway as far as their disparity range allows."""
    width, height, sways = draw(st.integers(60, 400)), draw(st.integers(60, 300)), draw(st.booleans())
    least, doffs = draw(st.floats(0.5, 20)), width * draw(st.floats(0, 0.05 if sways else 0.4))
    most = least * draw(st.floats(2.5, 40)) + (2 * doffs if sways else 0)
    return [
        f"camera.width_px={width}",
        f"camera.height_px={height}",
        f"camera.focal_px={width * draw(st.floats(0.5, 2.2))}",
        f"camera.doffs_px={doffs}",
        f"disparity.min_px={least}",
        f"disparity.max_px={most}",
        f"background.wall_disparity_px=[{least},{draw(st.sampled_from([least * 2, most]))}]",
        f"background.plane_disparity_px=[{least * 0.05},{least * 0.5}]",
        *(["camera.sway_m=[0,0.01]", "camera.sway_deg=[0,1]"] if sways else []),
        *(["camera.baselines=3", "camera.baseline_m=[0.1,0.4]"] if draw(st.integers(0, 2)) == 0 else []),
    ]


@settings(max_examples=30)
@given(rigs(), st.sampled_from(KINDS), st.integers(0, 10_000))
def test_every_pixel_has_a_disparity_and_rooms_keep_to_their_range(rig, kind, seed):
    weights = [f"background.{name}={int(name == kind)}" for name in KINDS]
    config = load_config("middlebury", [*CLUTTER_ALONE, *PIERCED, *weights, "disparity.target={form: uniform}", *rig])
    # Walls stay 1 % beyond the near plane; their disparity must still be positive.
    assume(config.disparity.max_px > (BEYOND_NEAR - 1) * config.camera.doffs_px.high)
    static = static_scene_of(config, seed)
    times = (0.0, 0.6, 1.9) if static.rig.sway.moves else (0.0,)
    for time_s in times:
        for camera in static.rig.views:
            px = seen_px(static, camera, time_s)
            assert np.isfinite(px).all()
            assert px.min() > 0
            # A swaying camera can come too near to houses; the renderer clips them at the near plane.
            assert px.max() <= config.disparity.max_px or (kind == "street" and len(times) > 1)
            if kind == "room":
                # With a large doffs, even the nearest possible wall can be beyond the depth of min_px.
                farthest_m = max(static.rig.camera.depth_m(config.disparity.min_px), BEYOND_NEAR * static.rig.near_m)
                assert px.min() >= camera.disparity_px(farthest_m) - 1e-6


@pytest.mark.parametrize("kind", ["cuboid", "room", "street"])
def test_a_camera_that_sways_far_sees_no_end(kind):
    weights = [f"background.{name}={int(name == kind)}" for name in KINDS]
    moving = "camera.sway_m=0.2", "camera.sway_deg=12", "disparity.target={form: uniform}"
    config = load_config("kitti", [*CLUTTER_ALONE, *PIERCED, *weights, *moving])
    for seed in range(3):
        static = static_scene_of(config, seed)
        for time_s in (0.0, 0.6, 1.9):
            assert np.isfinite(seen_px(static, static.rig.camera, time_s)).all()


def test_a_pair_that_is_too_deep_is_sampled_again_and_refused_at_last():
    # Where the longer baseline sees 13 px, the shorter one sees 0 px.
    keys = (
        "camera={width_px: 96, height_px: 64, focal_px: 90, baseline_m: null, baselines: [0.3, 0.4]}",
        "camera={doffs_px: null, cx_left_px: 20, cx_right_px: 60}",
        "disparity={min_px: 2, max_px: 60, target: {form: uniform}}",
        "background.wall_disparity_px=2",
        "particles.layers=[]",
        "textures={source: procedural, large_px: 0, max_patches: 8}",
        "models={variants: 1, complex: 0}",
        "checks.attempts=2",
    )
    with pytest.raises(InputError, match=r"in 2 attempts.* too deep: no disparity for \d+ pixels"):
        render_pair(load_config("middlebury", [*CLUTTER_ALONE, *keys]), 0)
