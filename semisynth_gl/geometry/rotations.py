"""Rotations as (3, 3) matrices for column vectors, by the right-hand rule."""

from collections.abc import Iterator
from functools import partial

import numpy as np
import pyrr
from numpy.typing import ArrayLike

from semisynth_gl.geometry.mesh import Floats, cross, least_aligned_axis, unit


def rotation_about(axis: ArrayLike, angle_rad: float) -> Floats:
    """Return the rotation about an axis through the origin."""
    # pyrr's matrices are for row vectors.
    return np.asarray(pyrr.matrix33.create_from_axis_rotation(np.asarray(axis, np.float64), angle_rad), np.float64).T


about_x, about_y = partial(rotation_about, (1, 0, 0)), partial(rotation_about, (0, 1, 0))


def about_z(angle_rad: float) -> Floats:
    """Return the rotation about the z axis: what `rotation_about` returns, bit for bit, but ten times as fast."""
    sine, cosine = 0.0 + np.sin(angle_rad), np.cos(angle_rad)
    return np.array([[cosine, sine, 0.0], [0.0 - sine, cosine, 0.0], [0.0, 0.0, (1 - cosine) + cosine]]).T


def even_turns(count: int, start_rad: float = 0.0) -> Iterator[Floats]:
    """Yield ``count`` rotations about z, evenly spread over a full turn."""
    return (about_z(start_rad + 2 * np.pi * i / count) for i in range(count))


def z_onto(axis: Floats) -> Floats:
    """Return a rotation of the z axis onto a unit vector."""
    x = unit(cross(least_aligned_axis(axis), axis))
    return np.stack([x, cross(axis, x), axis], axis=1)


def rotations_from_quaternions(quaternions: Floats) -> Floats:
    """Return the rotation matrices (N, 3, 3) of unit quaternions (N, 4), x y z w."""
    x, y, z, w = quaternions.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def rotations_about(axes: Floats, angle_rad: Floats) -> Floats:
    """Return the rotation matrices (N, 3, 3) about unit axes (N, 3) by angles (N,)."""
    half = angle_rad / 2
    return rotations_from_quaternions(np.concatenate([axes * np.sin(half)[:, None], np.cos(half)[:, None]], axis=1))
