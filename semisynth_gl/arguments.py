"""Checks of what callers in Python hand in: a wrong type is an error at the call, and not far behind it."""

from collections.abc import Iterable
from math import isfinite
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Any, cast, get_args

import numpy as np
from numpy.typing import DTypeLike, NDArray

from semisynth_gl.errors import InputError, described, shown


def check_type(name: str, value: object, expected: type | UnionType, hint: str = "") -> None:
    """Check that an argument is an instance of a class, or of one of several.

    Args:
        name: what the message calls the argument.
        value: the argument.
        expected: the class.
        hint: what to do, for the end of the message.

    Raises:
        InputError: where it is not.
    """
    if not isinstance(value, expected):
        raise _wrong(name, f"a {_named(expected)}", value, hint)


def check_one_of(name: str, value: object, expected: Iterable[str]) -> None:
    """Check that an argument is one of several texts.

    Raises:
        InputError: where it is not.
    """
    names = tuple(expected)
    if not (isinstance(value, str) and value in names):
        raise InputError(f"{name}: expected one of {', '.join(names)}, got {shown(value)}")


def to_whole(name: str, value: object, least: int | None = None, most: int | None = None) -> int:
    """Convert a whole number, Python's or numpy's, of ``least`` or more and ``most`` or less.

    Raises:
        InputError: where it is none.
    """
    if not isinstance(value, Integral) or isinstance(value, bool):
        raise _wrong(name, "a whole number", value)
    if least is not None and int(value) < least:
        raise InputError(f"{name} must be {least} or more, got {shown(int(value))}")
    if most is not None and int(value) > most:
        raise InputError(f"{name} must be {most} or less, got {shown(int(value))}")
    return int(value)


def to_real(name: str, value: object) -> float:
    """Convert a finite number of any kind to Python's; float32's would lose digits of all that it meets.

    Raises:
        InputError: where it is not.
    """
    try:
        finite = isinstance(value, Real) and not isinstance(value, bool) and isfinite(value)
    except OverflowError:  # a whole number that no float holds
        finite = False
    if not finite:
        raise _wrong(name, "a finite number", value)
    return value if isinstance(value, int) else float(cast("Real", value))


def to_array(name: str, value: object, dtype: DTypeLike) -> NDArray[Any]:
    """Convert anything array-like.

    Args:
        name: what the message calls the argument.
        value: the argument.
        dtype: of the array; whole numbers stay what they are, or are refused.

    Raises:
        InputError: where rows differ in length, or a value is no number of that dtype.
    """
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
    return InputError(
        f"{name} must be {expected}, got {shown(value)} ({type(value).__name__})" + (hint and f": {hint}")
    )
