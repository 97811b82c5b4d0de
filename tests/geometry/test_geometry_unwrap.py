import numpy as np
import pytest
from geometry_measures import STRETCH_BOUND, jacobians, stretch, volume
from hypothesis import given, settings
from hypothesis import strategies as st

from semisynth_gl.geometry.kinds import SIMPLE_KINDS
from semisynth_gl.geometry.unwrap import project_uv


@given(st.tuples(*[st.floats(-1, 1)] * 9))
@settings(max_examples=200, deadline=None)
def test_no_triangle_is_stretched_beyond_the_bound(values: tuple[float, ...]) -> None:
    corners = np.array(values).reshape(3, 3)
    height = np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
    if height < 1e-2:
        return
    mesh = project_uv("m", corners, [(0, 1, 2)])
    assert stretch(mesh)[0] <= STRETCH_BOUND + 1e-3
    assert np.linalg.det(jacobians(mesh))[0] < 0  # v points downwards: not mirrored


def test_sphere_reaches_the_bound_and_keeps_its_surface() -> None:
    sphere = SIMPLE_KINDS["sphere"](np.random.default_rng(0))
    mesh = project_uv("ball", sphere.positions, sphere.triangles)
    assert 1.1 < stretch(mesh).max() <= STRETCH_BOUND + 1e-3
    assert volume(mesh) == pytest.approx(volume(sphere), rel=1e-6)
    assert (mesh.positions[mesh.triangles] == sphere.positions[sphere.triangles]).all()
