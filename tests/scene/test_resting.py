"""Resting particles touch the surface below them and stay there, whichever frame is sampled first."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from samplers import sampler_of as make_sampler

from semisynth_gl import load_config
from semisynth_gl.geometry.mesh import make_mesh
from semisynth_gl.scene.resting import come_to_rest, surfaces_below, triangles_of

MOVING = ["sequence.length=3", "sequence.frame_s=2", "camera.sway_m=0.01", "camera.sway_deg=1"]
GROUND = ["structures.ground=1", "structures.ground_disparity_px=[60,150]", "structures.panels=2"]


@cache
def sampler_of(*overrides):
    few = "models.variants=1", "models.complex=0"
    config = load_config("middlebury", ["scenes=[]", "textures.large_px=0", *few, *overrides])
    return make_sampler(config, 3)


def by_slot(sampled, *, at_rest=None):
    """Return the particles' poses by slot: of all, of resting, or of falling particles."""
    rows = sampled.instances[sampled.instances["slot"] >= 0]
    return {int(row["slot"]): row["pose"] for row in rows if at_rest in (None, row["resting"])}


def test_models_at_rest_touch_what_was_below_them():
    options = "particles.density=sparse", *GROUND
    sampler, falling = sampler_of("particles.resting=1", *options), sampler_of(*options)
    touching = 0
    for index in range(2):
        sampled, above = sampler.sample(index), falling.sample(index)
        scene, still = sampled.scene, np.flatnonzero(sampled.instances["slot"] < 0)
        assert not sampled.instances["resting"][still].any()
        # Swap axes to x, z, -y: the camera's y axis points down.
        corners = triangles_of(sampler.models, scene.model[still], scene.world_from_model[still])
        upright = corners[..., [0, 2, 1]] * (1, 1, -1)
        poses = by_slot(above)
        for number in np.flatnonzero(sampled.instances["resting"]):
            pose, before = scene.world_from_model[number], poses[sampled.instances["slot"][number]]
            height, normal = surfaces_below(upright, np.array([[before[0, 3], before[2, 3], -before[1, 3]]]))
            vertices = sampler.models[scene.model[number]].positions.astype(float) @ pose[:3, :3].T + pose[:3, 3]
            below = (before[0, 3], before[2, 3], height[0])
            heights = (vertices[:, [0, 2, 1]] * (1, 1, -1) - below) @ normal[0]
            assert heights.min() == pytest.approx(0, abs=1e-9)
            touching += 1
        rows = sampled.instance_table()
        assert [row.get("resting", False) for row in rows] == sampled.instances["resting"].tolist()
        assert all(row["still"] is False for row in rows if "resting" in row)
    assert touching > 20


@pytest.mark.parametrize("kind", ["cuboid", "room", "street"])
def test_particles_at_rest_were_let_down_and_the_others_fall_as_before(kind):
    weights = [f"background.{name}={int(name == kind)}" for name in ("cuboid", "plane", "room", "street")]
    options = (*weights, "particles.layers=[{count: 120}]", *(GROUND if kind == "cuboid" else ()))
    rested, fallen = (sampler_of(f"particles.resting={share}", *options) for share in (0.5, 0))
    sunk = []
    for index in range(3):
        now, before = rested.sample(index), by_slot(fallen.sample(index))
        for slot, pose in by_slot(now, at_rest=False).items():
            np.testing.assert_array_equal(pose, before[slot])
        for slot, pose in by_slot(now, at_rest=True).items():
            if slot in before:
                # The particle moved down (+y, up to the camera's pitch) and did not turn.
                np.testing.assert_array_equal(pose[:3, :3], before[slot][:3, :3])
                sunk.append(pose[1, 3] - before[slot][1, 3])
    assert len(sunk) > 5
    assert np.median(sunk) > 0


def test_particles_at_rest_stay_whatever_frame_is_sampled_first():
    options = "particles.resting=0.6", *GROUND, *MOVING
    sampler, other = sampler_of(*options), sampler_of.__wrapped__(*options)
    forwards = [sampler.sample(index) for index in range(6)]
    for index in (5, 1, 4, 0):
        again = other.sample(index)
        np.testing.assert_array_equal(again.scene.world_from_model, forwards[index].scene.world_from_model)
        np.testing.assert_array_equal(again.instances["resting"], forwards[index].instances["resting"])
        motion = again.motion(+1)
        at_rest = again.instances["resting"]
        assert at_rest.sum() > 3
        # In the world, resting particles stay in place and falling particles move.
        np.testing.assert_array_equal(motion.world_from_model[at_rest], again.scene.world_from_model[at_rest])
        falling = ~at_rest & (again.instances["slot"] >= 0)
        assert (motion.world_from_model[falling] != again.scene.world_from_model[falling]).any(axis=(1, 2)).all()
    # Resting slots keep their models while falling slots may start the next generation.
    first, last = (
        dict(zip(each.instances["slot"], each.scene.model, strict=True)) for each in (forwards[0], forwards[2])
    )
    resting = set(forwards[0].instances["slot"][forwards[0].instances["resting"]])
    assert resting == set(forwards[2].instances["slot"][forwards[2].instances["resting"]])
    assert all(first[slot] == last[slot] for slot in resting)
    assert any(first[slot] != last[slot] for slot in first.keys() & last.keys() - resting)


@settings(max_examples=40)
@given(st.integers(0, 2**31), st.integers(1, 40))
def test_the_surface_below_is_the_highest_that_is_not_above(seed, count):
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-1, 1, (count, 3, 3))
    points = rng.uniform(-0.6, 0.6, (3, 3))
    points[2, 2] = np.inf
    for (x, y, top), height, normal in zip(points, *surfaces_below(corners, points), strict=True):
        expected = []
        for number, (first, second, third) in enumerate(corners):
            along = np.linalg.solve(np.stack([second - first, third - first], axis=1)[:2], (x, y) - first[:2])
            at = first[2] + along @ (second[2] - first[2], third[2] - first[2])
            if along.min() >= 0 and along.sum() <= 1 and at <= top:
                expected.append((at, number))
        if not expected:
            assert normal.tolist() == [0, 0, 0]
            continue
        highest, number = max(expected)
        assert height == pytest.approx(highest, abs=1e-9)
        assert normal[2] >= 0
        assert np.linalg.norm(normal) == pytest.approx(1)
        np.testing.assert_allclose((corners[number, 1:] - corners[number, 0]) @ normal, 0, atol=1e-9)


def test_nothing_rests_on_a_steep_slope_or_above_nothing():
    mesh = make_mesh("thing", [[0, 0, 1], [1, 0, 0], [0, -1, 0], [-1, 0, -1]], np.zeros((4, 2)), [[0, 1, 2], [1, 2, 3]])
    up = np.array([0.0, -1.0, 0.0])
    for angle, rests in ((0, True), (0.9, True), (1.1, False)):
        along, back = np.array([np.cos(angle), np.sin(angle), 0]) * 10, np.array([0, 5, -9])
        slope = np.array([[back - along, back + along, (0, 5, 20)]])
        assert bool(come_to_rest(np.eye(4)[None], [mesh], slope, up)) == rests
        assert not come_to_rest(np.eye(4)[None], [mesh], slope + np.array([100, 0, 0]), up)
