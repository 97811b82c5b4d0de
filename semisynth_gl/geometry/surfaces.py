"""Surfaces that models are built from: revolved, swept, extruded, flat.

Every one of them carries UV in model units and winds its triangles so that the normal points outwards. Seen from
outside, u runs to the right and v downwards, so that no texture is mirrored. A model stands on z = 0 or near it, z up.
"""

# ruff: noqa: RUF005  an array plus a tuple is a sum, not a concatenation

import numpy as np
from numpy.typing import ArrayLike, NDArray

from semisynth_gl.errors import InputError
from semisynth_gl.geometry.mesh import Mesh, cross, lengths, make_mesh, merged, without_degenerate
from semisynth_gl.geometry.unwrap import facing_axes

BAND_STRETCH = 1.1
"""How far a length around a lathed surface may be from its length in UV."""


def grid_surface(points: ArrayLike, uv: ArrayLike | None = None) -> Mesh:
    """Triangulate a grid of points; its normal is (along a row) x (along a column).

    Args:
        points: (R, C, 3), model units. Points may coincide, as those of a pole do.
        uv: (R, C, 2); by default the mean arc lengths along rows and columns, which suits sheets that are nearly
            developable.
    """
    grid = np.asarray(points, np.float64)
    rows, columns = grid.shape[:2]
    if uv is None:
        along_row = lengths(np.diff(grid, axis=1)).mean(axis=0)
        along_column = lengths(np.diff(grid, axis=0)).mean(axis=1)
        uv = np.stack(np.meshgrid(_cumulative(along_row), -_cumulative(along_column)), axis=2)
    first = np.arange(rows * columns).reshape(rows, columns)[:-1, :-1].ravel()
    corner = first[:, None] + np.array([0, 1, columns + 1, columns])
    triangles = np.concatenate([corner[:, [0, 1, 2]], corner[:, [0, 2, 3]]])
    mesh = make_mesh("grid", grid.reshape(-1, 3), np.asarray(uv, np.float64).reshape(-1, 2), triangles)
    return without_degenerate(mesh)


def lathe(profile: ArrayLike, segments: int = 32, *, closed: bool = False) -> Mesh:
    """Revolve a profile about the z axis.

    The surface is closed where the profile starts and ends on the axis, or where ``closed`` joins its ends. The
    profile is cut into bands, each of which is unrolled like the cone that fits it best (an equidistant conic
    projection): exact along the profile, within `BAND_STRETCH` around it, and exact for cones, cylinders and discs.

    Args:
        profile: (P, 2) radius and height, model units, with the outside to the right of the way: outwards along the
            bottom, up the outer side, inwards along the top. The radius is zero only at ends.
        segments: sides of the polygon that stands for the circle.
        closed: whether the last point is joined to the first.
    """
    points = np.asarray(profile, np.float64)
    if closed:
        points = np.concatenate([points, points[:1]])
    radius, height = points.T
    arc = _cumulative(lengths(np.diff(points, axis=0)))
    angle = np.linspace(-np.pi, np.pi, segments + 1)
    around = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    around[-1] = around[0]  # bit for bit, so that the seam closes
    grid = np.concatenate(
        [radius[:, None, None] * around, np.broadcast_to(height[:, None, None], (len(points), segments + 1, 1))], axis=2
    )
    bands = []
    start = 0
    while start < len(points) - 1:
        stop, offset, slope = _longest_band(radius, arc, start)
        rows = slice(start, stop + 1)
        bands.append(grid_surface(grid[rows], _conic_uv(arc[rows], offset, slope, angle, segments)))
        start = stop
    return merged("lathe", bands)


def _longest_band(radius: NDArray[np.float64], arc: NDArray[np.float64], start: int) -> tuple[int, float, float]:
    """Last profile point that one cone still fits, and that cone as radius = offset + slope * arc."""
    fit = (start + 1, *_fitted_cone(radius[start : start + 2], arc[start : start + 2]))
    for stop in range(start + 2, len(radius)):
        r, s = radius[start : stop + 1], arc[start : stop + 1]
        offset, slope = _fitted_cone(r, s)
        cone, seen = (offset + slope * s)[r > 0], r[r > 0]
        if (cone > BAND_STRETCH * seen).any() or (cone * BAND_STRETCH < seen).any():
            break
        fit = (stop, offset, slope)
    return fit


def _fitted_cone(radius: NDArray[np.float64], arc: NDArray[np.float64]) -> tuple[float, float]:
    """Least-squares line radius = offset + slope * arc; through the pole where the profile ends on the axis."""
    poles = np.flatnonzero(radius == 0)
    origin = arc[poles[0]] if len(poles) else arc.mean()
    level = 0.0 if len(poles) else radius.mean()
    slope = float(((arc - origin) * (radius - level)).sum() / ((arc - origin) ** 2).sum())
    return float(level - slope * origin), slope


def _conic_uv(
    arc: NDArray[np.float64], offset: float, slope: float, angle: NDArray[np.float64], segments: int
) -> NDArray[np.float64]:
    """Unroll the cone radius = offset + slope * arc over ``angle``; (R, C, 2). On the meridian of angle 0, v = -arc."""
    half = np.pi / segments
    if abs(slope) < 1e-6:  # a cylinder; its circumference is that of the polygon
        u = offset * np.sin(half) / half * angle
        return np.stack(np.broadcast_arrays(u[None, :], -arc[:, None]), axis=2)
    # From the apex, the sides of the polygon are seen under this angle each, a flat facet's true angle.
    unrolled = np.arcsin(slope * np.sin(half)) / half * angle
    from_apex = arc[:, None] + offset / slope
    u = from_apex * np.sin(unrolled)
    v_up = from_apex * np.cos(unrolled) - offset / slope
    return np.stack([u, -v_up], axis=2)


def sweep(
    section: ArrayLike,
    path: ArrayLike,
    *,
    closed: bool = False,
    scales: ArrayLike | float = 1.0,
    capped: bool = True,
) -> Mesh:
    """Carry a polygon along a curve, in frames that turn about the curve as little as possible.

    Lengths along the curve are those of its centre line: where the curve bends with radius R, a point of the section
    at distance r is off by r / R, so bends should be wider than about four times the section.

    Args:
        section: (S, 2) polygon, anticlockwise, star-shaped about the origin, model units.
        path: (P, 3), model units; no two neighbours coincide.
        closed: whether the last point is joined to the first.
        scales: factor of the section at each path point, (P,) or one for all.
        capped: whether the ends of an open sweep are closed.
    """
    outline = np.asarray(section, np.float64)
    points = np.asarray(path, np.float64)
    factor = np.broadcast_to(np.asarray(scales, np.float64), len(points))
    across, beside, tangent = _frames(points, closed=closed)
    if closed:
        points, factor = np.concatenate([points, points[:1]]), np.append(factor, factor[0])
        across, beside = np.concatenate([across, across[:1]]), np.concatenate([beside, beside[:1]])
    loop = np.concatenate([outline, outline[:1]])
    rings = points[:, None] + factor[:, None, None] * (
        loop[None, :, :1] * across[:, None] + loop[None, :, 1:] * beside[:, None]
    )
    around = _cumulative(lengths(np.diff(loop, axis=0)))
    along = _cumulative(lengths(np.diff(points, axis=0)))
    u = (around - around[-1] / 2) * factor[:, None]
    parts = [grid_surface(rings, np.stack(np.broadcast_arrays(u, -along[:, None]), axis=2))]
    if capped and not closed:
        parts += [_cap(rings[0, -2::-1], -tangent[0], points[0]), _cap(rings[-1, :-1], tangent[-1], points[-1])]
    return merged("sweep", parts)


def _frames(
    points: NDArray[np.float64], *, closed: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Rotation-minimising frames along a polyline: two unit normals and the tangent, (P, 3) each, right-handed.

    By double reflection (Wang et al., 2008). On a closed polyline the angle that is left over is spread evenly.
    """
    if closed:
        tangent = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    else:
        step = np.diff(points, axis=0)
        step /= lengths(step)[:, None]
        tangent = np.concatenate([step[:1], step[:-1] + step[1:], step[-1:]])
    tangent /= lengths(tangent)[:, None]
    count = len(points)
    across = np.zeros_like(points)
    axis = np.eye(3)[np.argmin(np.abs(tangent[0]))]
    across[0] = axis - (axis @ tangent[0]) * tangent[0]
    across[0] /= np.linalg.norm(across[0])
    stops = [*range(1, count), 0] if closed else range(1, count)
    moved = across[0]
    for start, stop in enumerate(stops):
        chord = points[stop] - points[start]
        chord /= np.linalg.norm(chord)
        reflected = moved - 2 * (chord @ moved) * chord
        heading = tangent[start] - 2 * (chord @ tangent[start]) * chord
        turn = tangent[stop] - heading
        length = np.linalg.norm(turn)
        if length > 1e-9:
            turn /= length
            reflected = reflected - 2 * (turn @ reflected) * turn
        moved = reflected
        if stop:
            across[stop] = moved
    beside = cross(tangent, across)
    if closed:
        left_over = np.arctan2(moved @ beside[0], moved @ across[0])
        twist = -left_over * np.arange(count)[:, None] / count
        across, beside = (
            np.cos(twist) * across + np.sin(twist) * beside,
            np.cos(twist) * beside - np.sin(twist) * across,
        )
    return across, beside, tangent


def _cap(ring: NDArray[np.float64], normal: NDArray[np.float64], centre: NDArray[np.float64]) -> Mesh:
    """Close a ring, (S, 3) and anticlockwise about ``normal``, with a fan around ``centre``, in its own plane."""
    points = np.concatenate([ring, centre[None]])
    first = np.arange(len(ring))
    fan = np.stack([first, np.roll(first, -1), np.full(len(ring), len(ring))], axis=1)
    return without_degenerate(make_mesh("cap", points, _planar_uv(points, normal), fan))


def _planar_uv(points: NDArray[np.float64], normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Coordinates of points, (N, 3), in the plane that faces along ``normal``; (N, 2)."""
    u, v = facing_axes(normal[None])
    return np.stack([points @ u[0], points @ v[0]], axis=1)


def flat_faces(points: ArrayLike, loops: list[list[int]]) -> Mesh:
    """Build a polyhedron from flat convex faces, each with texture of its own.

    Args:
        points: (V, 3) corners, model units.
        loops: for each face its corners, anticlockwise seen from outside.
    """
    corners = np.asarray(points, np.float64)
    uv, triangles, first = [], [], 0
    for loop in loops:
        face = corners[loop]
        normal = cross(face[1] - face[0], face[2] - face[1])
        normal /= np.linalg.norm(normal)
        uv.append(_planar_uv(face, normal))
        triangles += [[first, first + i, first + i + 1] for i in range(1, len(loop) - 1)]
        first += len(loop)
    return make_mesh("polyhedron", corners[np.concatenate(loops)], np.concatenate(uv), triangles)


def box(size: ArrayLike, centre: ArrayLike = (0.0, 0.0, 0.0)) -> Mesh:
    """A box with edges along the axes.

    Args:
        size: (3,) edge lengths, model units.
        centre: (3,), model units.
    """
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = np.asarray(centre, np.float64) + signs * np.asarray(size, np.float64) / 2
    loops = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return flat_faces(corners, loops)


def extruded(outline: ArrayLike, height: float, hole: ArrayLike | None = None) -> Mesh:
    """Extrude a polygon from z = 0 to ``height``.

    Args:
        outline: (N, 2), anticlockwise, star-shaped about the origin, model units.
        height: along z, model units.
        hole: (N, 2), anticlockwise, inside the outline; the n-th point of it faces the n-th of the outline, since the
            top is a strip between the two.

    Raises:
        InputError: where hole and outline differ in their number of points.
    """
    outer = np.asarray(outline, np.float64)
    parts = [_wall(outer, height)]
    for z, up in ((0.0, -1.0), (height, 1.0)):
        rim = np.column_stack([outer, np.full(len(outer), z)])
        normal = np.array([0.0, 0.0, up])
        if hole is None:
            parts.append(_cap(rim if up > 0 else rim[::-1], normal, np.array([0.0, 0.0, z])))
            continue
        inner = np.asarray(hole, np.float64)
        if len(inner) != len(outer):
            raise InputError(f"an extruded hole needs {len(outer)} points as its outline has, got {len(inner)}")
        edge = np.column_stack([inner, np.full(len(inner), z)])
        strip = np.stack([rim, edge] if up > 0 else [edge, rim])
        strip = np.concatenate([strip, strip[:, :1]], axis=1)
        parts.append(grid_surface(strip, _planar_uv(strip.reshape(-1, 3), normal).reshape(2, -1, 2)))
    if hole is not None:
        parts.append(_wall(np.asarray(hole, np.float64)[::-1], height))
    return merged("extrusion", parts)


def _wall(outline: NDArray[np.float64], height: float) -> Mesh:
    """The upright surface over a closed polygon, (N, 2); outwards where that is anticlockwise."""
    loop = np.concatenate([outline, outline[:1]])
    rings = np.stack([np.column_stack([loop, np.full(len(loop), z)]) for z in (0.0, height)])
    return grid_surface(rings)


def extruded_cells(solid: ArrayLike, x: ArrayLike, y: ArrayLike, height: float) -> Mesh:
    """Extrude the solid cells of a rectangular grid from z = 0 to ``height``: panels, lattices, letters.

    The surface is closed. It is a manifold where no two solid cells touch at a corner alone.

    Args:
        solid: (R, C) bool, row along y and column along x.
        x: (C + 1,) increasing borders of the columns, model units.
        y: (R + 1,) increasing borders of the rows, model units.
        height: along z, model units.
    """
    cells = np.asarray(solid, bool)
    border_x, border_y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    padded = np.pad(cells, 1)
    rows, columns = np.nonzero(cells)
    west, east, south, north = border_x[columns], border_x[columns + 1], border_y[rows], border_y[rows + 1]
    low, high = np.zeros(len(rows)), np.full(len(rows), float(height))
    quads: list[NDArray[np.float64]] = []
    axes: list[NDArray[np.float64]] = []
    # for each side of a cell: its normal, whether it is open, and its corners anticlockwise seen from outside
    everywhere = np.ones(len(rows), bool)
    sides = (
        ((0, 0, 1), everywhere, ((west, south, high), (east, south, high), (east, north, high), (west, north, high))),
        ((0, 0, -1), everywhere, ((west, south, low), (west, north, low), (east, north, low), (east, south, low))),
        (
            (-1, 0, 0),
            ~padded[rows + 1, columns],
            ((west, north, low), (west, south, low), (west, south, high), (west, north, high)),
        ),
        (
            (1, 0, 0),
            ~padded[rows + 1, columns + 2],
            ((east, south, low), (east, north, low), (east, north, high), (east, south, high)),
        ),
        (
            (0, -1, 0),
            ~padded[rows, columns + 1],
            ((west, south, low), (east, south, low), (east, south, high), (west, south, high)),
        ),
        (
            (0, 1, 0),
            ~padded[rows + 2, columns + 1],
            ((east, north, low), (west, north, low), (west, north, high), (east, north, high)),
        ),
    )
    for normal, is_open, corners in sides:
        quad = np.stack([np.stack(corner, axis=1) for corner in corners], axis=1)[is_open]
        quads.append(quad)
        axes.append(_planar_uv(quad.reshape(-1, 3), np.array(normal, np.float64)))
    points = np.concatenate(quads).reshape(-1, 3)
    first = np.arange(0, len(points), 4)[:, None]
    triangles = np.concatenate([first + [0, 1, 2], first + [0, 2, 3]])
    return make_mesh("cells", points, np.concatenate(axes), triangles)


def _cumulative(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums of the first 0, 1, .. steps."""
    return np.concatenate([[0.0], np.cumsum(steps)])
