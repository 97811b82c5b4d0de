"""The kinds of arrays in calibrations, told by their numbers, and by words where numbers do not tell."""

from collections.abc import Callable, Mapping

import numpy as np

from semisynth_gl.calibration.names import Entry
from semisynth_gl.calibration.tree import Array, rotation_of_quaternion
from semisynth_gl.frame.raw_camera import rotation_of

# Numbers are printed with six digits.
_PRINTED = 1e-4
_LARGEST = 1e9
COEFFICIENT_WORDS = "d$|dist|coef|kc|radtan|equidistant"
"""Beginnings of words in names of a lens's coefficients, as a regular expression."""
_TRANSLATION = "t$|tr$|trans|trns|tvec|shift|position"


def are_numbers(value: Array, *counts: int) -> bool:
    """Return whether an array has one of the numbers of entries, all finite and of usable magnitude."""
    return value.size in counts and bool((np.abs(value) <= _LARGEST).all())  # written so that nan fails too


def as_rotation(value: Array) -> Array | None:
    """Return nine numbers as a rotation (3, 3), None if they are none."""
    if not are_numbers(value, 9):
        return None
    r = value.reshape(3, 3)
    return r if np.allclose(r @ r.T, np.eye(3), atol=_PRINTED) and np.linalg.det(r) > 0 else None


def as_camera_matrix(value: Array) -> Array | None:
    """Return nine numbers as [fx s cx; 0 fy cy; 0 0 1], None if they are none."""
    if not are_numbers(value, 9):
        return None
    k = value.reshape(3, 3)
    return k if min(k[0, 0], k[1, 1]) > 1 and np.abs([k[1, 0], *(k[2] - (0, 0, 1))]).sum() < _PRINTED else None


def as_pose(value: Array) -> Array | None:
    """Return 12 or 16 numbers as a pose (4, 4), None if they are none."""
    if not are_numbers(value, 12, 16):
        return None
    pose = np.vstack([value.reshape(-1, 4), [0, 0, 0, 1]])
    is_pose = as_rotation(pose[:3, :3]) is not None and np.allclose(pose[3:], (0, 0, 0, 1))
    return pose[:4] if is_pose else None


def _rotation(entry: Entry) -> Array | None:
    """Return a rotation from a matrix, or by its name from a rotation vector or a quaternion."""
    value = entry.value.ravel()
    if value.size == 9 or not entry.is_rotation:
        return as_rotation(value)
    if are_numbers(value, 3) and np.linalg.norm(value) < 2 * np.pi:
        x, y, z = value.tolist()
        return np.array(rotation_of((x, y, z)))
    # The part of a quaternion that is nearly 1 is w, which is the first or the last one.
    if are_numbers(value, 4) and abs(np.linalg.norm(value) - 1) < 1e-3 and np.abs(value[[0, 3]]).max() > 0.9:
        return rotation_of_quaternion(value if abs(value[3]) > abs(value[0]) else np.roll(value, -1))
    return None


def _coefficients(entry: Entry) -> Array | None:
    in_a_row = max(entry.value.shape, default=0) == entry.value.size != 1
    fitting = in_a_row and are_numbers(entry.value, 0, *range(4, 33)) and entry.has(COEFFICIENT_WORDS)
    return entry.value.ravel() if fitting else None


def _translation(entry: Entry) -> Array | None:
    is_shift = are_numbers(entry.value, 3) and entry.has(_TRANSLATION) and not entry.is_rotation
    return entry.value.ravel() if is_shift else None


def _projection(entry: Entry) -> Array | None:
    p = entry.value.reshape(3, 4) if are_numbers(entry.value, 12) else None
    return None if p is None or as_camera_matrix(p[:, :3]) is None else p


def _reprojection(entry: Entry) -> Array | None:
    q = entry.value.reshape(4, 4) if are_numbers(entry.value, 16) else np.zeros((4, 4))
    return q if q[0, 0] == q[1, 1] == 1 and q[2, 3] > 1 and q[3, 2] != 0 and not q[2, :3].any() else None


KINDS: Mapping[str, Callable[[Entry], Array | None]] = {
    "K": lambda entry: as_camera_matrix(entry.value),
    "D": _coefficients,
    "R": _rotation,
    "P": _projection,
    "Q": _reprojection,
    "T": _translation,
}
"""Functions that return an entry as an array of a kind, by OpenCV's names, or None; R1, R2 and R are of one kind."""
