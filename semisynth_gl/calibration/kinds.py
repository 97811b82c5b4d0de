"""Kinds of arrays that their numbers tell: camera matrices, rotations, projections, poses, sizes."""

import numpy as np

from semisynth_gl.calibration.arrays import Size
from semisynth_gl.calibration.tree import Array, FormatError

# Numbers are printed with six digits.
_PRINTED = 1e-4
_LARGEST = 1e9
_LARGEST_SIDE_PX = 99_999


def is_camera_matrix(value: Array) -> bool:
    """Return whether nine numbers are [fx s cx; 0 fy cy; 0 0 1]."""
    if not are_numbers(value, 9):
        return False
    k = value.reshape(3, 3)
    zeros = abs(k[1, 0]) + abs(k[2, 0]) + abs(k[2, 1]) + abs(k[2, 2] - 1)
    return bool(min(k[0, 0], k[1, 1]) > 1 and zeros < _PRINTED)


def is_rotation(value: Array) -> bool:
    """Return whether nine numbers are a rotation."""
    if not are_numbers(value, 9):
        return False
    r = value.reshape(3, 3)
    return bool(np.allclose(r @ r.T, np.eye(3), atol=_PRINTED) and np.linalg.det(r) > 0)


def is_rotation_vector(value: Array) -> bool:
    """Return whether three numbers may be a rotation's axis times its angle, less than a full turn."""
    return are_numbers(value, 3) and bool(np.linalg.norm(value) < 2 * np.pi)


def is_projection(value: Array) -> bool:
    """Return whether twelve numbers are the projection matrix of a rectified camera."""
    return are_numbers(value, 12) and is_camera_matrix(value.reshape(3, 4)[:, :3])


def is_pose(value: Array) -> bool:
    """Return whether 12 or 16 numbers are a rotation and a translation."""
    if not are_numbers(value, 12, 16):
        return False
    pose = value.reshape(-1, 4)
    return is_rotation(pose[:3, :3]) and (len(pose) == 3 or np.allclose(pose[3], (0, 0, 0, 1)))


def is_reprojection(value: Array) -> bool:
    """Return whether sixteen numbers are OpenCV's Q, from disparities to points."""
    if not are_numbers(value, 16):
        return False
    q = value.reshape(4, 4)
    return bool(q[0, 0] == q[1, 1] == 1 and q[2, 3] > 1 and q[3, 2] != 0 and not q[2, :3].any())


def are_numbers(value: Array, *sizes: int) -> bool:
    """Return whether an array has one of the sizes, and all its numbers are finite and of usable magnitude."""
    # Written so that nan fails too.
    return value.size in sizes and bool((np.abs(value) <= _LARGEST).all())


def is_coefficients(value: Array) -> bool:
    """Return whether an array may be the coefficients of a lens: none, or four and more in a row or a column."""
    return value.ndim < 3 and max(value.shape, default=0) == value.size and (value.size == 0 or value.size >= 4)


def checked_size(width: float, height: float) -> Size | None:
    """Return a size; None for 0 x 0, as OpenCV writes an unknown one. Raises FormatError for sides that are none."""
    if width == 0 and height == 0:
        return None
    for side in (width, height):
        if not (1 <= side <= _LARGEST_SIDE_PX and side == int(side)):
            raise FormatError(
                f"expected a width and height of 1 to {_LARGEST_SIDE_PX} whole pixels, got {width:g} x {height:g}"
            )
    return Size(int(width), int(height))
