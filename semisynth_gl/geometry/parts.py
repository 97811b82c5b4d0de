"""Parts of models: outlines, curves, rods and balls, and rotations to place them."""

from collections.abc import Iterable

import numpy as np
import pyrr
from numpy.typing import ArrayLike

from semisynth_gl.geometry.mesh import Floats, Mesh, cross, least_axis, lengths, make_part, unit
from semisynth_gl.geometry.surfaces import lathe, sweep


def circle(radius: float, sides: int, turn_rad: float = 0.0) -> Floats:
    """A regular polygon about the origin, anticlockwise; (sides, 2), model units."""
    return on_circle(radius, turn_rad + np.arange(sides) * (2 * np.pi / sides))


def rectangle(width: float, height: float) -> Floats:
    """A rectangle about the origin, anticlockwise; (4, 2), model units."""
    return np.array([[-width, -height], [width, -height], [width, height], [-width, height]]) / 2


def arc(radius: float, start_rad: float, stop_rad: float, count: int) -> Floats:
    """Points of a circle about the origin, both ends included; (count, 2), model units."""
    return on_circle(radius, np.linspace(start_rad, stop_rad, count))


def on_circle(radius: ArrayLike, angle_rad: ArrayLike) -> Floats:
    """Points in polar coordinates, (N,) each or a number; (N, 2), model units."""
    return np.stack([np.multiply(radius, np.cos(angle_rad)), np.multiply(radius, np.sin(angle_rad))], axis=1)


def lift(curve: Floats, axes: str) -> Floats:
    """Lift a plane curve of (P, 2) points into space, its two axes along two of "xyz", such as "xz"; (P, 3)."""
    points = np.zeros((len(curve), 3))
    points[:, ["xyz".index(axis) for axis in axes]] = curve
    return points


def smooth(points: ArrayLike, steps: int = 6) -> Floats:
    """A Catmull-Rom curve through (N, D) points, with ``steps`` pieces between neighbours; (steps * (N - 1) + 1, D)."""
    given = np.asarray(points, np.float64)
    extended = np.concatenate([2 * given[:1] - given[1:2], given, 2 * given[-1:] - given[-2:-1]])[:, None]
    p, start, stop, q = extended[:-3], extended[1:-2], extended[2:-1], extended[3:]
    t = (np.arange(steps) / steps)[None, :, None]
    from_start, to_stop = (stop - p) / 2, (q - start) / 2
    bend = 3 * (stop - start) - 2 * from_start - to_stop
    snap = 2 * (start - stop) + from_start + to_stop
    curve = start + t * (from_start + t * (bend + t * snap))
    return np.concatenate([curve.reshape(-1, given.shape[1]), given[-1:]])


def rounded(corners: ArrayLike, radius: float, steps: int) -> Floats:
    """Replace the inner corners of a polyline, (N, 3), by arcs of a radius, of ``steps`` straight pieces each.

    Returns the points of the new polyline, (P, 3). Neighbouring corners must be far enough apart for both arcs.
    """
    given = np.asarray(corners, np.float64)
    points = [given[:1]]
    for before, corner, after in zip(given[:-2], given[1:-1], given[2:], strict=True):
        arriving, leaving = unit(corner - before), unit(after - corner)
        turn = float(np.arccos(np.clip(arriving @ leaving, -1, 1)))
        if turn < 1e-6:
            points.append(corner[None])
            continue
        inward = (leaving - arriving @ leaving * arriving) / np.sin(turn)
        start = corner - radius * np.tan(turn / 2) * arriving
        angle = np.linspace(0, turn, steps + 1)[:, None]
        points.append(start + radius * (np.sin(angle) * arriving + (1 - np.cos(angle)) * inward))
    return np.concatenate([*points, given[-1:]])


def hollow(outside: Floats, wall: float) -> Floats:
    """Return a vessel's profile, (Q, 2), from the middle of the foot over the lip to the middle of the inner floor.

    ``outside``, (P, 2), is radius and height from the foot's rim up to the lip. It must rise, and have no sharp steps,
    which would fold over when the profile is offset inwards by ``wall``, the thickness.
    """
    along = np.gradient(outside, axis=0)
    along /= lengths(along)[:, None]
    inside = outside + wall * np.stack([-along[:, 1], along[:, 0]], axis=1)
    floor = outside[0, 1] + wall
    edge = np.interp(floor, inside[:, 1], inside[:, 0])  # where the inner wall meets the floor
    inside = inside[inside[:, 1] > floor + 0.1 * wall][::-1]
    lip = np.array([(outside[-1] + inside[0]) / 2 + (0, wall / 3)])
    return np.concatenate([[[0, outside[0, 1]]], outside, lip, inside, [[edge, floor], [0, floor]]])


def rod(start: ArrayLike, stop: ArrayLike, radius: float, end_radius: float | None = None, sides: int = 8) -> Mesh:
    """A straight round rod between two points, closed; a frustum where its ends differ in radius."""
    first, last = np.asarray(start, np.float64), np.asarray(stop, np.float64)
    length = float(np.linalg.norm(last - first))
    taper = radius if end_radius is None else end_radius
    axis = (last - first) / length
    return placed(lathe([(0, 0), (radius, 0), (taper, length), (0, length)], sides), rotation=onto(axis), at=first)


def ball(radius: float, segments: int, rings: int) -> Mesh:
    """A ball about the origin, with ``segments`` sides at its equator and ``rings`` of latitude, poles included."""
    profile = arc(radius, -np.pi / 2, np.pi / 2, rings)
    profile[[0, -1], 0] = 0
    return lathe(profile, segments)


def wire(path: ArrayLike, radius: float, sides: int = 8, *, closed: bool = False) -> Mesh:
    """A round wire along a curve, (P, 3)."""
    return sweep(circle(radius, sides), path, closed=closed)


def turned(axis: ArrayLike, angle_rad: float) -> Floats:
    """Return the (3, 3) rotation about an axis through the origin, by the right-hand rule, for column vectors."""
    # pyrr's matrices are for row vectors.
    return np.asarray(pyrr.matrix33.create_from_axis_rotation(np.asarray(axis, np.float64), angle_rad), np.float64).T


def turned_about_z(angle_rad: float) -> Floats:
    """Return the result of `turned` for the z axis, to the last bit and in the same memory order, ten times as fast."""
    sine, cosine = 0.0 + np.sin(angle_rad), np.cos(angle_rad)
    return np.array([[cosine, sine, 0.0], [0.0 - sine, cosine, 0.0], [0.0, 0.0, (1 - cosine) + cosine]]).T


def placed(mesh: Mesh, at: ArrayLike = (0.0, 0.0, 0.0), *, rotation: Floats | None = None) -> Mesh:
    """Return a mesh rotated by ``rotation``, (3, 3) for column vectors, and then moved by ``at``, (3,)."""
    positions = mesh.positions.astype(np.float64)
    if rotation is not None:
        # Not by BLAS, which rounds equal points of a seam differently, and differently on every machine.
        positions = np.einsum("ij,vj->vi", rotation, positions)
    return make_part(mesh.name, positions + np.asarray(at), mesh.uv, mesh.triangles)


def around(count: int, start_rad: float = 0.0) -> Iterable[Floats]:
    """Yield ``count`` rotations about z, (3, 3) each, evenly spread over a full turn."""
    return (turned((0, 0, 1), start_rad + 2 * np.pi * i / count) for i in range(count))


def onto(axis: Floats) -> Floats:
    """Return a rotation that takes z onto a unit vector; (3, 3) for column vectors."""
    x = unit(cross(least_axis(axis), axis))
    return np.stack([x, cross(axis, x), axis], axis=1)
