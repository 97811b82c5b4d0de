"""Checks of what callers in Python hand in: a wrong type is an error at the call, and not far behind it.

Each function raises `InputError`, whose message calls the argument by ``name``, where the argument is unfit.
"""

from collections.abc import Iterable
from math import isfinite
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Any, cast, get_args

import numpy as np
from numpy.typing import DTypeLike, NDArray

from semisynth_gl.inputs.errors import InputError, described, shown

LEAST, MOST = 1e-9, 1e9
"""Smallest magnitude beside 0, and largest one, of the numbers that are drawn.

Drawing multiplies up to four lengths, focal lengths and inverses of them in float32, which holds 1e-38 to 3e38.
"""

MOST_PX = 1e6
"""Largest magnitude of a place in the image, and of a focal length: float32's steps are 1/16 px there."""

OTHER_UNITS = "float32 does not hold what is worked out of it: choose other units"
"""What messages about magnitudes end with."""


def check_type(name: str, value: object, expected: type | UnionType, hint: str = "") -> None:
    """Check that an argument is an instance of a class, or of one of several; the message ends with the hint."""
    if not isinstance(value, expected):
        raise _wrong(name, f"a {_named(expected)}", value, hint)


def check_one_of(name: str, value: object, expected: Iterable[str]) -> None:
    """Check that an argument is one of several texts."""
    names = tuple(expected)
    if not (isinstance(value, str) and value in names):
        raise InputError(f"{name}: expected one of {', '.join(names)}, got {shown(value)}")


def to_whole(name: str, value: object, least: int | None = None, most: int | None = None) -> int:
    """Convert a whole number, Python's or numpy's, of ``least`` or more and ``most`` or less."""
    if not isinstance(value, Integral) or isinstance(value, bool):
        raise _wrong(name, "a whole number", value)
    number = int(value)
    if least is not None and number < least:
        raise InputError(f"{name} must be {least} or more, got {shown(number)}")
    if most is not None and number > most:
        raise InputError(f"{name} must be {most} or less, got {shown(number)}")
    return number


def to_real(name: str, value: object) -> float:
    """Convert a finite number of any kind to Python's; a float32 would cost all that it meets its digits."""
    try:
        finite = isinstance(value, Real) and not isinstance(value, bool) and isfinite(value)
    except OverflowError:  # a whole number that no float holds
        finite = False
    if not finite:
        raise _wrong(name, "a finite number", value)
    return value if isinstance(value, int) else float(cast("Real", value))


def to_magnitude(name: str, value: object, *, least: float = 0.0, most: float = MOST) -> float:
    """Convert 0, or a number from ``least`` to ``most`` in magnitude, to Python's."""
    number = to_real(name, value)
    magnitude = abs(number)
    if magnitude > most or 0 < magnitude < least:
        expected = f"0 or {least:g} to {most:g}" if least else f"at most {most:g}"
        raise InputError(f"{name} must be {expected} in magnitude, got {shown(value)}: {OTHER_UNITS}")
    return number


def check_magnitudes(name: str, array: NDArray[Any]) -> None:
    """Check that the numbers of an array are finite, and at most `MOST` in magnitude."""
    low, high = float(array.min(initial=0)), float(array.max(initial=0))
    if low >= -MOST and high <= MOST:
        return
    if not np.isfinite(array).all():
        raise InputError(f"{name} has values that are not finite")
    worst = low if -low > high else high
    raise InputError(f"{name} must be at most {MOST:g} in magnitude, got {worst:g}: {OTHER_UNITS}")


def to_array(name: str, value: object, dtype: DTypeLike) -> NDArray[Any]:
    """Convert anything array-like whose rows are of equal length; whole numbers stay exact, or are refused."""
    try:
        array = np.asarray(value)
        result = array.astype(dtype, copy=False)
    except Exception as error:  # noqa: BLE001 - a value's own method may make the array
        raise _wrong(name, f"an array of {np.dtype(dtype)}", value, described(error)) from None
    if array.dtype.kind in "USO" or (result.dtype.kind in "iu" and not np.array_equal(array, result)):
        raise _wrong(name, f"an array of {np.dtype(dtype)}", value)
    return result


def _named(expected: type | UnionType) -> str:
    kinds = get_args(expected) or (expected,)
    return " or ".join("None" if kind is NoneType else kind.__name__ for kind in kinds)


def _wrong(name: str, expected: str, value: object, hint: str = "") -> InputError:
    end = f": {hint}" if hint else ""
    return InputError(f"{name} must be {expected}, got {shown(value)} ({type(value).__name__}){end}")
