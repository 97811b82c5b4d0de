"""Resampled truth belongs to the surface of the nearest pixel, and is exact on planes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from semisynth_gl.augmentation.resampling import SamplePoints

SIDES = (24, 40)
SLOPE = st.floats(-2, 2, width=32)


@given(st.tuples(SLOPE, SLOPE), st.tuples(SLOPE, SLOPE), st.integers(4, 35), st.floats(0.3, 3), st.sampled_from("xy"))
def test_a_value_is_that_of_the_surface_of_the_nearest_pixel(far, near, edge, scale, form):
    """Two planes 200 px of disparity apart, with the edge at a column or a row."""
    y, x = np.mgrid[: SIDES[0], : SIDES[1]].astype(np.float64)

    def value(x, y, is_near):
        return np.where(is_near, 400 + near[0] * x + near[1] * y, 200 + far[0] * x + far[1] * y)

    is_near = x < edge if form == "x" else y < edge // 2 + 1
    values = value(x, y, is_near).astype(np.float32)
    columns = ((np.arange(int(SIDES[1] * scale)) + 0.5) / scale - 0.5)[None]
    rows = ((np.arange(int(SIDES[0] * scale)) + 0.5) / scale - 0.5)[:, None]
    owner = is_near[np.rint(rows).astype(int).clip(0, 23), np.rint(columns).astype(int).clip(0, 39)]
    found = SamplePoints(columns, rows, SIDES).on_surface(values, 0.01)
    np.testing.assert_allclose(found, value(columns, rows, owner), atol=2e-3)


def test_where_planes_meet_each_side_has_its_own_slope():
    ridge = -np.abs(np.arange(21) - 10.0).astype(np.float32)[None].repeat(5, 0)
    at = np.array([[9.6, 9.9, 10.3]])
    np.testing.assert_allclose(
        SamplePoints(at, np.array([[2.0]]), (5, 21)).on_surface(ridge, 0.1)[0], [-0.4, -0.1, -0.3]
    )


def test_what_is_one_pixel_wide_keeps_its_value():
    values = np.full((9, 9), 3, np.float32)
    values[:, 4], values[2] = 50, np.inf
    found = SamplePoints(np.array([[3.6, 4.0, 4.4]]), np.array([[6.3]]), (9, 9)).on_surface(values, 0.1)
    assert found.tolist() == [[50, 50, 50]]
    assert np.isinf(SamplePoints(np.array([[1.2]]), np.array([[2.4]]), (9, 9)).on_surface(values, 0.1)).all()
    beside = SamplePoints(np.array([[1.2]]), np.array([[1.3]]), (9, 9)).on_surface(values, 0.1)
    assert beside.tolist() == [[3]]


@pytest.mark.parametrize("sides", [(1, 1), (2, 2), (1, 5)])
def test_images_of_few_pixels_have_their_nearest_values(sides):
    values = np.arange(sides[0] * sides[1], dtype=np.float32).reshape(sides) ** 2
    found = SamplePoints(np.array([[0.2]]), np.array([[-0.3]]), sides).on_surface(values, 1e-3)
    assert found == values[0, 0]
