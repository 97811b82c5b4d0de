"""Checks of arguments from Python callers, which raise `InputError` about the argument ``name``."""

from collections.abc import Iterable
from math import inf, isfinite
from numbers import Integral, Real
from typing import Annotated, Any, get_origin, get_type_hints

import numpy as np
from numpy.typing import DTypeLike, NDArray

from semisynth_gl.inputs.errors import InputError, shown

LEAST, MOST = 1e-9, 1e9
"""Smallest and largest magnitude of the lengths and focal lengths of a scene; 0 is allowed too.

The renderer multiplies up to four of them and of their inverses in float32, which holds 1e-38 to 3e38.
"""

MOST_PX = 1e6
"""Maximum magnitude of an image coordinate and of a focal length, px: float32 has steps of 1/16 px there."""

Interval = tuple[float, float]
"""The low and the high end of a range; see `CheckedFields`."""

OTHER_UNITS = "float32 cannot hold the values computed from it: choose other units"
"""Advice in messages about magnitudes beyond `LEAST` and `MOST`."""


def check_type(name: str, value: object, expected: type, hint: str) -> None:
    """Check that an argument is an instance of a class; the message ends with ``hint``."""
    if not isinstance(value, expected):
        raise _error(name, f"a {expected.__name__}", value, hint)


def check_one_of(name: str, value: object, expected: Iterable[str]) -> None:
    """Check that an argument is one of the expected strings."""
    names = list(expected)
    if not (isinstance(value, str) and value in names):
        raise _error(name, f"one of {', '.join(names)}", value)


def to_whole(name: str, value: object, least: int | None = None, most: int | None = None) -> int:
    """Convert a whole number, Python's or NumPy's, to int; check that it is from ``least`` to ``most``, if given."""
    if not isinstance(value, Integral) or isinstance(value, bool):
        raise _error(name, "a whole number", value)
    number = int(value)
    if (least is not None and number < least) or (most is not None and number > most):
        limits = f"{least} or more" if most is None else f"from {least} to {most}"
        raise _error(name, f"{most} or less" if least is None else limits, number)
    return number


def to_real(name: str, value: object, least: float = -inf, most: float = inf) -> float:
    """Convert a finite real number of any type to Python's int or float; check that it is from ``least`` to ``most``.

    A NumPy float32 would lower the precision of everything that is computed with it.
    """
    if not isinstance(value, Real) or isinstance(value, bool) or not isfinite(value):
        raise _error(name, "a finite number", value)
    number = value if isinstance(value, int) else float(value)
    if not least <= number <= most:
        raise _error(name, f"from {least:g} to {most:g}", number)
    return number


class CheckedFields:
    """Base of frozen dataclasses that convert and check their numbers by the annotations.

    ``Annotated[int, 0]`` is a whole number of 0 or more, ``Annotated[float, 0, 1]`` a real number from 0 to 1, and
    ``Annotated[Interval, 0, 1]`` two such numbers in rising order.
    """

    __slots__ = ()

    def __post_init__(self) -> None:
        for name, hint in get_type_hints(type(self), include_extras=True).items():
            if get_origin(hint) is not Annotated:
                continue
            kind, limits, value = hint.__origin__, hint.__metadata__, getattr(self, name)
            if kind is int or kind is float:
                value = to_whole(name, value, *limits) if kind is int else to_real(name, value, *limits)
            else:
                ends = [to_real(name, end, *limits) for end in value] if isinstance(value, tuple | list) else []
                if len(ends) != 2 or ends[0] > ends[1]:
                    raise InputError(f"expected (low, high) in rising order, got {shown(value)}", argument=name)
                value = tuple(ends)
            object.__setattr__(self, name, value)


def check_magnitudes(name: str, array: NDArray[Any]) -> None:
    """Check that the numbers of an array are finite, and at most `MOST` in magnitude."""
    if not (np.abs(array) <= MOST).all():
        raise _error(name, f"at most {MOST:g} in magnitude", array.flat[np.abs(array).argmax()].item(), OTHER_UNITS)


def to_array(name: str, value: object, dtype: DTypeLike) -> NDArray[Any]:
    """Convert a number or anything array-like with rows of equal length to an array of a dtype.

    Strings, objects, and numbers that an integer dtype cannot hold exactly are refused.
    """
    hint = ""
    try:
        array = np.asarray(value)
        result = array.astype(dtype, copy=False)
        if array.dtype.kind not in "USO" and (result.dtype.kind not in "iu" or np.array_equal(array, result)):
            return result
    except (TypeError, ValueError, OverflowError) as error:
        hint = str(error)
    raise _error(name, f"an array of {np.dtype(dtype)}", value, hint)


def _error(name: str, expected: str, value: object, hint: str = "") -> InputError:
    return InputError(f"must be {expected}, got {shown(value)}{f': {hint}' if hint else ''}", argument=name)
