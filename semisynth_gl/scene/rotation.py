"""Rotation matrices of many things at once."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def rotation_of(quaternion: Floats) -> Floats:
    """Rotation matrices (N, 3, 3) of unit quaternions (N, 4), x y z w."""
    x, y, z, w = quaternion.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def rotation_about(axis: Floats, angle_rad: Floats) -> Floats:
    """Rotation matrices (N, 3, 3) about unit axes (N, 3) by angles (N,), right-handed."""
    half = angle_rad / 2
    return rotation_of(np.concatenate([axis * np.sin(half)[:, None], np.cos(half)[:, None]], axis=1))
