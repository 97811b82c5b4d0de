"""Surfaces of models: revolved, swept, extruded and flat surfaces.

Every surface has UV in model units, and triangles whose normals point outwards. Seen from outside, u points to the
right and v downwards, so that no texture is mirrored. z points up. Lengths are in model units.

trimesh.creation has similar functions, but without UV.
"""

from itertools import product
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from semisynth_gl.geometry.mesh import (
    Floats,
    Mesh,
    cross,
    least_aligned_axis,
    lengths,
    make_part,
    merged,
    mesh_grid,
    split_quads,
    unit,
    without_degenerate,
)
from semisynth_gl.geometry.unwrap import facing_axes

BAND_STRETCH = 1.1
"""Maximum factor by which the texture of a lathed surface is stretched or compressed around the axis."""

BAND_SHEAR = 0.15
"""Maximum shear of the texture on a lathed surface: `lathe` unrolls cones that fit bands of it, but not exactly."""


def grid_surface(points: ArrayLike, uv: ArrayLike | None = None) -> Mesh:
    """Triangulate a grid of points, (R, C, 3), some of which may coincide; ``uv`` is (R, C, 2).

    Normals point along the cross product of the direction along a row and the direction along a column. By default, u
    is the mean arc length along rows, and -v that along columns, which fits nearly developable sheets.
    """
    grid = np.asarray(points, np.float64)
    rows, columns, _ = grid.shape
    if uv is None:
        along_row = lengths(np.diff(grid, axis=1)).mean(axis=0)
        along_column = lengths(np.diff(grid, axis=0)).mean(axis=1)
        uv = np.stack(np.meshgrid(_cumulative(along_row), -_cumulative(along_column)), axis=2)
    _, _, triangles = mesh_grid(rows - 1, columns - 1)
    coordinates = np.asarray(uv, np.float64).reshape(-1, 2)
    return without_degenerate(make_part("grid", grid.reshape(-1, 3), coordinates, triangles))


def lathe(profile: ArrayLike, segments: int = 32, *, closed: bool = False) -> Mesh:
    """Revolve a profile, (P, 2) radius and height, about the z axis; circles are polygons of ``segments`` sides.

    The profile runs outwards along the bottom, up the outer side, and inwards along the top. Only its ends may have a
    radius of 0. The surface is closed if both ends have a radius of 0, or if ``closed`` joins them.

    For UV, the profile is cut into bands. A cone is fitted to each band and unrolled. Along the profile, lengths in UV
    are exact; around the axis, they are within `BAND_STRETCH` and `BAND_SHEAR`.
    """
    points = np.asarray(profile, np.float64)
    if closed:
        points = np.concatenate([points, points[:1]])
    radius, height = points.T
    arc = _cumulative(lengths(np.diff(points, axis=0)))
    angle = np.linspace(-np.pi, np.pi, segments + 1)
    around = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    around[-1] = around[0]  # bit for bit, so that the seam closes
    x, y = radius[:, None] * around.T[:, None]
    grid = np.stack(np.broadcast_arrays(x, y, height[:, None]), axis=2)
    bands, start = [], 0
    while start < len(points) - 1:
        stop, offset, slope = _longest_band(radius, arc, start, segments)
        rows = slice(start, stop + 1)
        bands.append(grid_surface(grid[rows], _conic_uv(arc[rows], offset, slope, angle, segments)))
        start = stop
    return merged("lathe", bands)


def _longest_band(radius: Floats, arc: Floats, start: int, segments: int) -> tuple[int, float, float]:
    """Return the last profile point of the longest band that a cone fits, and the cone's offset and slope."""
    fit = (start + 1, *_fitted_cone(radius[start : start + 2], arc[start : start + 2]))
    for stop in range(start + 2, len(radius)):
        r, s = radius[start : stop + 1], arc[start : stop + 1]
        offset, slope = _fitted_cone(r, s)
        fitted, actual = (offset + slope * s)[r > 0], r[r > 0]
        shear = np.abs(np.diff(r) - slope * np.diff(s)) * np.sin(np.pi / segments)
        stretched = (fitted > BAND_STRETCH * actual) | (fitted * BAND_STRETCH < actual)
        if stretched.any() or (shear > BAND_SHEAR * np.diff(s)).any():
            break
        fit = (stop, offset, slope)
    return fit


def _fitted_cone(radius: Floats, arc: Floats) -> tuple[float, float]:
    """Fit radius = offset + slope * arc by least squares; if an end is on the axis, exactly through that end."""
    poles = np.flatnonzero(radius == 0)
    origin = arc[poles[0]] if len(poles) else arc.mean()
    level = 0.0 if len(poles) else radius.mean()
    slope = float(((arc - origin) * (radius - level)).sum() / ((arc - origin) ** 2).sum())
    return float(level - slope * origin), slope


def _conic_uv(arc: Floats, offset: float, slope: float, angle: Floats, segments: int) -> Floats:
    """Unroll the cone radius = offset + slope * arc to UV, (R, C, 2): rows by arc, columns by angle.

    At angle 0, v is -arc.
    """
    half = np.pi / segments
    if abs(slope) < 1e-6:  # a cylinder, with the circumference of the polygon
        u = offset * np.sin(half) / half * angle
        return np.stack(np.broadcast_arrays(u[None, :], -arc[:, None]), axis=2)
    # Unrolled, each flat facet keeps its angle at the apex.
    unrolled = np.arcsin(slope * np.sin(half)) / half * angle
    from_apex = arc[:, None] + offset / slope
    v_up = from_apex * np.cos(unrolled) - offset / slope
    return np.stack([from_apex * np.sin(unrolled), -v_up], axis=2)


def sweep(section: ArrayLike, path: ArrayLike, *, closed: bool = False, scales: ArrayLike | float = 1.0) -> Mesh:
    """Sweep a polygon along a curve, with as little rotation about the curve as possible, and close both ends.

    ``section``, (S, 2), is the polygon, anticlockwise and star-shaped about the origin. ``path``, (P, 3), is the curve;
    neighbouring points must differ. ``closed`` joins its last point to its first. ``scales``, (P,), are factors by
    which the section is scaled at the points of the path. -v is the length along the curve.
    """
    outline, points = np.asarray(section, np.float64), np.asarray(path, np.float64)
    factor = np.broadcast_to(np.asarray(scales, np.float64), len(points))
    across, beside, tangent = _frames(points, closed=closed)
    if closed:
        points, factor, across, beside = (np.concatenate([a, a[:1]]) for a in (points, factor, across, beside))
    loop = np.concatenate([outline, outline[:1]])
    section_points = loop[None, :, :1] * across[:, None] + loop[None, :, 1:] * beside[:, None]
    rings = points[:, None] + factor[:, None, None] * section_points
    around = _cumulative(lengths(np.diff(loop, axis=0)))
    along = _cumulative(lengths(np.diff(points, axis=0)))
    u = (around - around[-1] / 2) * factor[:, None]
    parts = [grid_surface(rings, np.stack(np.broadcast_arrays(u, -along[:, None]), axis=2))]
    if not closed:
        parts += [_cap(rings[0, -2::-1], -tangent[0], points[0]), _cap(rings[-1, :-1], tangent[-1], points[-1])]
    return merged("sweep", parts)


def _frames(points: Floats, *, closed: bool) -> tuple[Floats, Floats, Floats]:
    """Return rotation-minimising frames of a polyline: two unit normals and the tangent, (P, 3) each, right-handed.

    The method is double reflection (Wang et al., Computation of rotation minimizing frames, 2008). After one round of a
    closed polyline, the frame has rotated about the tangent. Equal parts of this rotation are undone at each point.
    """
    if closed:
        tangent = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    else:
        step = np.diff(points, axis=0)
        step /= lengths(step)[:, None]
        tangent = np.concatenate([step[:1], step[:-1] + step[1:], step[-1:]])
    tangent /= lengths(tangent)[:, None]
    count = len(points)
    axis = least_aligned_axis(tangent[0])
    normal = unit(axis - (axis @ tangent[0]) * tangent[0])
    normals = [normal]
    for start in range(count if closed else count - 1):
        stop = (start + 1) % count
        chord = unit(points[stop] - points[start])
        normal = normal - 2 * (chord @ normal) * chord
        reflected_tangent = tangent[start] - 2 * (chord @ tangent[start]) * chord
        turn = tangent[stop] - reflected_tangent
        length = np.linalg.norm(turn)
        if length > 1e-9:
            turn /= length
            normal = normal - 2 * (turn @ normal) * turn
        normals.append(normal)
    across = np.stack(normals[:count])
    beside = cross(tangent, across)
    if closed:
        mismatch = np.arctan2(normal @ beside[0], normal @ across[0])
        twist = -mismatch * np.arange(count)[:, None] / count
        cos, sin = np.cos(twist), np.sin(twist)
        across, beside = cos * across + sin * beside, cos * beside - sin * across
    return across, beside, tangent


def _cap(ring: Floats, normal: Floats, centre: Floats) -> Mesh:
    """Fill a flat ring, (S, 3) and anticlockwise about ``normal``, with a fan of triangles around ``centre``."""
    points = np.concatenate([ring, centre[None]])
    first = np.arange(len(ring))
    fan = np.stack([first, np.roll(first, -1), np.full(len(ring), len(ring))], axis=1)
    return without_degenerate(make_part("cap", points, _planar_uv(points, normal), fan))


def _planar_uv(points: Floats, normal: Floats) -> Floats:
    """Return the UV, (N, 2), of points, (N, 3), on a plane with a unit normal, (3,)."""
    u, v = facing_axes(normal[None])
    return np.stack([points @ u[0], points @ v[0]], axis=1)


# The corners of the unit cube, in the order of 4 x + 2 y + z.
_CORNERS: Final = np.array(list(product((0, 1), repeat=3)))
# The four corners of each side, anticlockwise seen from outside: of boxes, whose sides are -x, +x, -y, +y, -z and +z,
# and of cells, whose sides are +z, -z, -x, +x, -y and +y.
_BOX_SIDES: Final = _CORNERS[[[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]]
_CELL_SIDES: Final = _CORNERS[[[1, 5, 7, 3], [0, 2, 6, 4], [2, 0, 1, 3], [4, 6, 7, 5], [0, 4, 5, 1], [6, 2, 3, 7]]]


def box(size: ArrayLike, centre: ArrayLike = (0.0, 0.0, 0.0)) -> Mesh:
    """Return a box about ``centre``, whose edges are parallel to the axes and have the lengths ``size``, (3,)."""
    signs = 2 * _BOX_SIDES - 1
    sides = np.asarray(centre, np.float64) + signs * np.asarray(size, np.float64) / 2
    uv = np.concatenate([_planar_uv(side, normal) for side, normal in zip(sides, signs.mean(axis=1), strict=True)])
    triangles = np.arange(0, 24, 4)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    return make_part("box", sides.reshape(-1, 3), uv, triangles.reshape(-1, 3))


def extruded(outline: ArrayLike, height: float, hole: Floats | None = None) -> Mesh:
    """Extrude a polygon, (N, 2), anticlockwise and star-shaped about the origin, from z = 0 to ``height``.

    ``hole`` is a polygon, (N, 2), anticlockwise and inside the outline. Top and bottom connect its n-th point to the
    n-th point of the outline.
    """
    outer = np.asarray(outline, np.float64)
    parts = [_wall(outer, height)]
    for z, up in ((0.0, -1), (height, 1)):
        rim, normal = _at_height(outer, z), np.array([0.0, 0.0, up])
        if hole is None:
            parts.append(_cap(rim[::up], normal, np.array([0.0, 0.0, z])))
        else:
            strip = np.stack([rim, _at_height(hole, z)][::up])
            strip = np.concatenate([strip, strip[:, :1]], axis=1)
            parts.append(grid_surface(strip, _planar_uv(strip.reshape(-1, 3), normal).reshape(2, -1, 2)))
    if hole is not None:
        parts.append(_wall(hole[::-1], height))
    return merged("extrusion", parts)


def _wall(outline: Floats, height: float) -> Mesh:
    """Return the upright surface over a closed polygon, (N, 2); it faces outwards if the polygon is anticlockwise."""
    loop = np.concatenate([outline, outline[:1]])
    return grid_surface([_at_height(loop, 0.0), _at_height(loop, height)])


def _at_height(polygon: Floats, z: float) -> Floats:
    return np.column_stack([polygon, np.full(len(polygon), z)])


def extruded_cells(solid: NDArray[np.bool_], x: Floats, y: Floats, height: float) -> Mesh:
    """Extrude the solid cells of a rectangular grid from z = 0 to ``height``.

    ``solid`` is (R, C) bool, with rows along y and columns along x. ``x``, (C + 1,), and ``y``, (R + 1,), are the
    increasing borders of the cells. The surface is closed; it is a manifold unless two cells touch only at a corner.
    """
    padded, (rows, columns) = np.pad(solid, 1), np.nonzero(solid)
    bounds = np.zeros((2, 3, len(rows)))
    bounds[:, 0] = x[columns], x[columns + 1]
    bounds[:, 1] = y[rows], y[rows + 1]
    bounds[1, 2] = height
    quads, uv = [], []
    for corners in _CELL_SIDES:
        normal = (2 * corners - 1).mean(axis=0)
        across, along, up = normal.astype(np.int64)
        is_open = ~padded[rows + 1 + along, columns + 1 + across] | (up != 0)
        quads.append(bounds[corners, np.arange(3)].transpose(2, 0, 1)[is_open].reshape(-1, 3))
        uv.append(_planar_uv(quads[-1], normal))
    points = np.concatenate(quads)
    return make_part("cells", points, np.concatenate(uv), split_quads(np.arange(len(points)).reshape(-1, 4)))


def _cumulative(steps: Floats) -> Floats:
    """Return the sums of the first 0 to N of N steps; (N + 1,)."""
    return np.concatenate([[0.0], np.cumsum(steps)])
