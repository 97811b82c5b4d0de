"""Parts of models: outlines, curves, rods, balls and wires. Lengths are in model units."""

import numpy as np
from numpy.typing import ArrayLike

from semisynth_gl.geometry.mesh import Floats, Mesh, lengths, make_part, unit
from semisynth_gl.geometry.rotations import z_onto
from semisynth_gl.geometry.surfaces import lathe, sweep


def circle(radius: float, sides: int, turn_rad: float = 0.0) -> Floats:
    """Return a regular polygon about the origin, anticlockwise; (sides, 2)."""
    return from_polar(radius, turn_rad + np.arange(sides) * (2 * np.pi / sides))


def rectangle(width: float, height: float) -> Floats:
    """Return a rectangle about the origin, anticlockwise; (4, 2)."""
    return np.array([[-width, -height], [width, -height], [width, height], [-width, height]]) / 2


def arc(radius: float, start_rad: float, stop_rad: float, count: int) -> Floats:
    """Return points of a circle about the origin, both ends included; (count, 2)."""
    return from_polar(radius, np.linspace(start_rad, stop_rad, count))


def from_polar(radius: ArrayLike, angle_rad: ArrayLike) -> Floats:
    """Return the points, (N, 2), with these polar coordinates; each is (N,) or one number."""
    return np.stack([np.multiply(radius, np.cos(angle_rad)), np.multiply(radius, np.sin(angle_rad))], axis=1)


def lift(curve: Floats, axes: str) -> Floats:
    """Put a plane curve, (P, 2), into the plane of two of the axes "xyz", such as "xz"; (P, 3)."""
    points = np.zeros((len(curve), 3))
    points[:, ["xyz".index(axis) for axis in axes]] = curve
    return points


def spline(points: ArrayLike, steps: int = 6) -> Floats:
    """Return a Catmull-Rom curve through points (N, D), with ``steps`` pieces between neighbours.

    The curve is (steps * (N - 1) + 1, D).
    """
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
    """Replace the inner corners of a polyline, (N, 3), by arcs of ``steps`` straight pieces each; (P, 3).

    The polyline must turn at each corner, and neighbouring corners must be far enough apart for both arcs.
    """
    given = np.asarray(corners, np.float64)
    points = [given[:1]]
    for before, corner, after in zip(given[:-2], given[1:-1], given[2:], strict=True):
        arriving, leaving = unit(corner - before), unit(after - corner)
        turn = float(np.arccos(np.clip(arriving @ leaving, -1, 1)))
        inward = (leaving - arriving @ leaving * arriving) / np.sin(turn)
        start = corner - radius * np.tan(turn / 2) * arriving
        angle = np.linspace(0, turn, steps + 1)[:, None]
        points.append(start + radius * (np.sin(angle) * arriving + (1 - np.cos(angle)) * inward))
    return np.concatenate([*points, given[-1:]])


def hollow(outside: Floats, wall: float) -> Floats:
    """Return a vessel's profile, (Q, 2), from the middle of the foot over the lip to the middle of the inner floor.

    ``outside``, (P, 2), is radius and height from the foot's rim up to the lip. The inner side is this curve, moved
    inwards by the thickness ``wall``. The curve must have no sharp steps, where the inner side would fold over.
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
    """Return a closed, straight, round rod between two points; it is a frustum if ``end_radius`` differs."""
    first, last = np.asarray(start, np.float64), np.asarray(stop, np.float64)
    length = float(np.linalg.norm(last - first))
    taper = radius if end_radius is None else end_radius
    along_z = lathe([(0, 0), (radius, 0), (taper, length), (0, length)], sides)
    return placed(along_z, first, rotation=z_onto((last - first) / length))


def ball(radius: float, segments: int, rings: int) -> Mesh:
    """Return a ball about the origin: ``segments`` sides at its equator, ``rings`` of latitude including both poles."""
    profile = arc(radius, -np.pi / 2, np.pi / 2, rings)
    profile[[0, -1], 0] = 0
    return lathe(profile, segments)


def wire(path: ArrayLike, radius: float, sides: int = 8, *, closed: bool = False) -> Mesh:
    """Return a round wire along a curve, (P, 3)."""
    return sweep(circle(radius, sides), path, closed=closed)


def placed(mesh: Mesh, at: ArrayLike = (0.0, 0.0, 0.0), *, rotation: Floats | None = None) -> Mesh:
    """Return a mesh rotated by ``rotation``, (3, 3) for column vectors, and then moved by ``at``, (3,)."""
    positions = mesh.positions.astype(np.float64)
    if rotation is not None:
        # einsum, since BLAS may round equal points of a seam differently, and does so differently on each machine.
        positions = np.einsum("ij,vj->vi", rotation, positions)
    return make_part(mesh.name, positions + np.asarray(at), mesh.uv, mesh.triangles)
