import numpy as np
import pytest
from geometry_measures import edge_balance, euler_characteristic, stretch, volume
from hypothesis import example, given, settings
from hypothesis import strategies as st

from semisynth_gl.geometry.parts import circle, hollow, rectangle, rod, rounded, spline
from semisynth_gl.geometry.rotations import about_z, rotation_about
from semisynth_gl.geometry.surfaces import (
    BAND_STRETCH,
    extruded,
    extruded_cells,
    lathe,
    sweep,
)


def test_cylinder_unrolls_to_its_polygon() -> None:
    mesh = lathe([(0, 0), (1, 0), (1, 2), (0, 2)], 6)
    assert volume(mesh) == pytest.approx(2 * 6 / 2 * np.sin(np.pi / 3), rel=1e-6)
    assert stretch(mesh).max() < 1 + 1e-5
    upright = np.ptp(mesh.positions[mesh.triangles][:, :, 2], axis=1) > 1
    side_u = mesh.uv[mesh.triangles[upright]][..., 0]
    assert np.ptp(side_u) == pytest.approx(6, rel=1e-5)  # six chords of length 1


@given(bottom=st.floats(0, 2), top=st.floats(0.05, 2), height=st.floats(0.05, 3), sides=st.integers(3, 40))
@settings(max_examples=60, deadline=None)
def test_every_frustum_unrolls_exactly(bottom: float, top: float, height: float, sides: int) -> None:
    mesh = lathe([(bottom if bottom > 0.05 else 0, 0), (top, height)], sides)
    assert stretch(mesh).max() < 1 + 1e-3


@given(
    st.lists(st.floats(0.1, 1), min_size=2, max_size=12),
    st.lists(st.floats(0.05, 0.5), min_size=12, max_size=12),
    st.integers(24, 48),
)
# The slopes alternate within a band, but one cone fits the radii.
@example(
    radii=[0.99446, 0.27994, 0.23044, 0.97164, 0.89656],
    steps=[0.05, 0.0625, 0.125, 0.05, 0.05, 0.05, 0.05, 0.05, 0.05, 0.05, 0.05, 0.05],
    sides=24,
)
# One wide cone fits the slopes, but its facets do not.
@example(radii=[0.4375, 0.8515625, 0.78125, 0.75], steps=[0.5, 0.125, 0.0625, 0.5, *[0.5] * 8], sides=24)
@settings(max_examples=40, deadline=None)
def test_lathe_keeps_its_bound_on_any_profile(radii: list[float], steps: list[float], sides: int) -> None:
    profile = np.column_stack([radii, np.cumsum(steps)[: len(radii)]])
    around = stretch(lathe(profile, sides))
    # a facet that deviates from the cone exceeds the bound a little
    assert around.max() < 1.06 * BAND_STRETCH
    closed = lathe([(0, profile[0, 1]), *profile, (0, profile[-1, 1])], sides)
    assert edge_balance(closed) == 0
    assert euler_characteristic(closed) == 2
    assert volume(closed) > 0


@given(st.lists(st.floats(0.2, 1), min_size=3, max_size=6), st.floats(0.01, 0.04))
@settings(max_examples=40, deadline=None)
def test_hollow_vessel_has_the_wall_it_was_asked_for(radii: list[float], wall: float) -> None:
    outside = spline(np.column_stack([radii, np.linspace(0, 1.5, len(radii))]), 6)
    outside[:, 0] = np.maximum(outside[:, 0], 0.15)
    profile = hollow(outside, wall)
    inner = profile[len(outside) + 2 : -2]
    # Every inner point is one wall thickness inside the outer line.
    start, step = outside[:-1], np.diff(outside, axis=0)
    share = np.clip(((inner[:, None] - start) * step).sum(axis=2) / (step**2).sum(axis=1), 0, 1)
    distance = np.linalg.norm(inner[:, None] - start - share[..., None] * step, axis=2).min(axis=1)
    assert (distance < 1.01 * wall).all()
    assert (inner[:, 0] < np.interp(inner[:, 1], outside[:, 1], outside[:, 0])).all()
    assert volume(lathe(profile, 24)) > 0


def test_straight_tapered_sweep_is_a_frustum() -> None:
    mesh = sweep(circle(1, 64), [(0, 0, 0), (0, 0, 3)], scales=[1, 0.5])
    exact = np.pi * 3 / 3 * (1 + 0.5 + 0.25)
    assert volume(mesh) == pytest.approx(exact, rel=0.002)
    assert euler_characteristic(mesh) == 2


def test_closed_sweep_has_one_hole_and_no_seam() -> None:
    mesh = sweep(rectangle(0.2, 0.4), np.column_stack([circle(1, 60), np.zeros(60)]), closed=True)
    assert edge_balance(mesh) == 0
    assert euler_characteristic(mesh) == 0
    assert volume(mesh) == pytest.approx(2 * np.pi * 0.08, rel=0.01)


def test_extruded_ring_has_the_volume_of_the_ring() -> None:
    mesh = extruded(circle(1, 48), 0.5, circle(0.6, 48))
    area = 48 / 2 * np.sin(2 * np.pi / 48)
    assert volume(mesh) == pytest.approx(0.5 * area * (1 - 0.36), rel=1e-5)
    assert euler_characteristic(mesh) == 0
    assert stretch(mesh).max() < 1 + 1e-5


@given(st.integers(0, 2**16 - 1))
@settings(max_examples=40, deadline=None)
def test_cells_have_the_volume_of_the_solid_ones(bits: int) -> None:
    solid = np.array([bits >> i & 1 for i in range(16)], bool).reshape(4, 4)
    solid[0, 0] = True
    x, y = np.array([0, 1, 1.5, 3, 4]), np.array([0, 0.5, 2, 2.5, 3])
    mesh = extruded_cells(solid, x, y, 0.7)
    assert volume(mesh) == pytest.approx(0.7 * (np.outer(np.diff(y), np.diff(x)) * solid).sum(), rel=1e-5)
    assert edge_balance(mesh) == 0
    assert stretch(mesh).max() < 1 + 1e-5


def test_rods_end_where_they_were_put() -> None:
    start, stop = np.array([1.0, 2, 3]), np.array([-2.0, 0.5, 4])
    mesh = rod(start, stop, 0.1, 0.05, sides=64)
    along = (stop - start) / np.linalg.norm(stop - start)
    share = (mesh.positions - start) @ along / np.linalg.norm(stop - start)
    away = np.linalg.norm(mesh.positions - start - np.outer((mesh.positions - start) @ along, along), axis=1)
    assert [share.min(), share.max()] == pytest.approx([0, 1], abs=1e-6)
    assert away[share < 0.5].max() == pytest.approx(0.1, abs=1e-6)
    assert away[share > 0.5].max() == pytest.approx(0.05, abs=1e-6)
    assert volume(mesh) > 0


def test_about_z_equals_the_rotation_about_any_axis() -> None:
    for angle in [0, -0.0, np.pi / 2, np.pi, -np.pi, *np.random.default_rng(0).uniform(-10, 10, 300)]:
        long, short = rotation_about((0, 0, 1), angle), about_z(angle)
        assert (long.T.tobytes(), long.strides) == (short.T.tobytes(), short.strides)


def test_rounded_corners_keep_their_radius() -> None:
    path = rounded([(0, 0, 0), (2, 0, 0), (2, 3, 0)], 0.5, 8)
    assert np.linalg.norm(path[1:-1] - (1.5, 0.5, 0), axis=1) == pytest.approx(np.full(9, 0.5))
    assert path[[0, -1]].tolist() == [[0, 0, 0], [2, 3, 0]]
