import numpy as np
import pytest
from geometry_measures import STRETCH_BOUND, jacobians, stretch, volume
from hypothesis import given, settings
from hypothesis import strategies as st

from semisynth_gl.geometry.kinds import SIMPLE_KINDS
from semisynth_gl.geometry.unwrap import DIRECTIONS, project_uv


def test_bound_is_the_worst_angle_over_the_sphere() -> None:
    # a fine grid over one of the 48 equal triangles that directions cut the sphere into
    a, b = np.meshgrid(np.linspace(0, 1, 801), np.linspace(0, 1, 801))
    points = np.stack([a * b, b, np.ones_like(a)], axis=2).reshape(-1, 3)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    nearest = (points @ DIRECTIONS.T).max(axis=1)
    assert 1 / nearest.min() == pytest.approx(STRETCH_BOUND, rel=1e-3)
    assert (1 / nearest <= STRETCH_BOUND + 1e-12).all()
    assert STRETCH_BOUND < 1.15


@given(st.tuples(*[st.floats(-1, 1)] * 9))
@settings(max_examples=200, deadline=None)
def test_no_triangle_is_stretched_beyond_the_bound(values: tuple[float, ...]) -> None:
    corners = np.array(values).reshape(3, 3)
    height = np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
    if height < 1e-2:
        return
    mesh = project_uv("m", corners, [(0, 1, 2)])
    assert stretch(mesh)[0] <= STRETCH_BOUND + 1e-3
    assert np.linalg.det(jacobians(mesh))[0] < 0  # v downwards: not mirrored


def test_sphere_reaches_the_bound_and_keeps_its_surface() -> None:
    sphere = SIMPLE_KINDS["sphere"](np.random.default_rng(0))
    mesh = project_uv("ball", sphere.positions, sphere.triangles)
    assert 1.1 < stretch(mesh).max() <= STRETCH_BOUND + 1e-3
    assert volume(mesh) == pytest.approx(volume(sphere), rel=1e-6)
    assert (mesh.positions[mesh.triangles] == sphere.positions[sphere.triangles]).all()
