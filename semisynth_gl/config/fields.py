"""The base class of all sections of a config, and the types of their values."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Self, TypeGuard

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    PlainValidator,
    model_validator,
)
from pydantic_core import ErrorDetails

LARGEST = 1e6
"""Largest magnitude of any number in a config: far above useful values, and far below overflow."""

SMALLEST = 1e-6
"""Smallest number accepted where a number above 0 is expected; its inverse is `LARGEST`."""


class ConfigError(ValueError):
    """A rule over several keys is broken.

    Attributes:
        keys: the dotted keys that the rule is about, below the section that states the rule.
    """

    def __init__(self, text: str, keys: Iterable[str] = ()) -> None:
        super().__init__(text)
        self.keys = tuple(keys)


def not_signed(least: float, came: float) -> str:
    """Return the text of a fault: a disparity is too small for a config whose disparities are positive."""
    return f"expected {'numbers above 0' if least else '0 or more'} where disparity.signed is false, got {came:g}"


Finite = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, le=LARGEST, allow_inf_nan=False)]
Positive = Annotated[float, Field(ge=SMALLEST, le=LARGEST, allow_inf_nan=False)]
Weight = NotNegative
Share = Annotated[float, Field(ge=0, le=1)]

_LONGEST_NAME = 100
_MOST_BASELINES = 64
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9-]*$", max_length=_LONGEST_NAME)]
PluginName = Annotated[str, Field(min_length=1, max_length=_LONGEST_NAME)]


class Section(BaseModel):
    """Base of all sections: unknown keys are errors, values are not coerced, nothing changes after loading.

    The docstring below a key is its text in ``semisynth-gl configs NAME`` and in the manual.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, use_attribute_docstrings=True)

    def _faults(self) -> Iterator[ConfigError]:
        """Yield the broken rules about keys that are valid one by one; only the first one is reported."""
        yield from ()

    @model_validator(mode="after")
    def _keys_go_together(self) -> Self:
        for fault in self._faults():
            raise fault
        return self


def _list_as_tuple(value: Any) -> Any:  # noqa: ANN401 - a validator gets any YAML value
    return tuple(value) if isinstance(value, list) else value


# Turns a YAML list into a tuple, since frozen sections hold tuples.
FROM_LIST = BeforeValidator(_list_as_tuple)


def _rule(holds: Callable[[Any], bool], expected: str) -> AfterValidator:
    """Return a validator that accepts the values for which ``holds`` returns True, and names what was ``expected``."""

    def check(value: Any) -> Any:  # noqa: ANN401 - a validator of any type
        if not holds(value):
            raise ValueError(f"expected {expected}")
        return value

    return AfterValidator(check)


def one_of(names: Iterable[str]) -> AfterValidator:
    """Return a validator that accepts only these names."""
    known = tuple(names)
    return _rule(known.__contains__, f"one of {', '.join(known)}")


@dataclass(frozen=True, slots=True)
class Range:
    """The closed interval [low, high]. A single number x is the interval [x, x]."""

    low: float
    high: float

    @property
    def middle(self) -> float:
        """The middle of the interval."""
        return (self.low + self.high) / 2

    def sample(self, rng: np.random.Generator) -> float:
        """Sample uniformly. It always takes one random number, so fixing a value does not shift later ones."""
        return self.low + (self.high - self.low) * float(rng.random())

    def sample_log(self, rng: np.random.Generator, size: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """Sample (size,) float64 log-uniformly. The interval must be positive."""
        return self.low * np.power(self.high / self.low, rng.random(size))

    def sample_many(self, rng: np.random.Generator, size: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """Sample (size,) float64 uniformly."""
        return self.low + (self.high - self.low) * rng.random(size)


ZERO = Range(0.0, 0.0)


def reason_of(fault: ErrorDetails) -> str:
    """Return the reason that pydantic or a validator gives for a fault, as a clause that begins in lower case."""
    if fault["type"] in ("tuple_type", "list_type"):
        return "expected a list, such as [a, b]"
    if fault["type"] == "string_pattern_mismatch":
        return f"expected a text of the form {fault['ctx']['pattern']}"
    reason = fault["msg"].removeprefix("Value error, ")
    return f"{reason[0].lower()}{reason[1:]}"


def is_number(value: object) -> TypeGuard[float]:
    """Return whether a value from YAML is a number of any size; true and false are not."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _parse(value: object) -> Range:
    if isinstance(value, Range):
        return value
    ends = value if isinstance(value, (list, tuple)) else (value, value)
    if len(ends) != 2 or not all(map(is_number, ends)):
        raise ValueError("expected a number or [low, high]")
    # Checked before the conversion to float, since an integer may be too large for a float.
    if not all(-LARGEST <= end <= LARGEST for end in ends):
        raise ValueError(f"expected finite numbers of at most {LARGEST:g}")
    low, high = (float(end) for end in ends)
    if low > high:
        raise ValueError(f"expected [low, high] with low <= high, but {low:g} > {high:g}: the range is empty")
    return Range(low, high)


def at_least(smallest: float) -> AfterValidator:
    """Return a validator of ranges whose low end is at least ``smallest``."""
    return _rule(lambda value: value.low >= smallest, f"at least {smallest:g}")


def at_most(largest: float) -> AfterValidator:
    """Return a validator of ranges whose high end is at most ``largest``."""
    return _rule(lambda value: value.high <= largest, f"at most {largest:g}")


def below(end: float) -> AfterValidator:
    """Return a validator of ranges whose high end is below ``end``."""
    return _rule(lambda value: value.high < end, f"less than {end:g}")


def count(most: int) -> Any:  # noqa: ANN401 - pydantic's
    """Return a pydantic field that limits a whole number to 1 to ``most``."""
    return Field(ge=1, le=most)


def _parse_baselines(value: object) -> int | tuple[float, ...]:
    if isinstance(value, (list, tuple)):
        if not 1 <= len(value) <= _MOST_BASELINES or not all(map(is_number, value)):
            raise ValueError(f"expected a number of baselines, or a list of 1 to {_MOST_BASELINES} of them in metres")
        if not all(SMALLEST <= metres <= LARGEST for metres in value):
            raise ValueError(f"expected metres from {SMALLEST:g} to {LARGEST:g}")
        if len(set(value)) < len(value):
            raise ValueError("expected baselines that differ from each other")
        return tuple(map(float, value))
    if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= _MOST_BASELINES:
        raise ValueError(f"expected a whole number from 1 to {_MOST_BASELINES}, or a list of metres")
    return value


def written_range(value: Range) -> float | list[float]:
    """Return a range as a config states it: a number, or [low, high]."""
    return value.low if value.low == value.high else [value.low, value.high]


def _parse_path(value: Any) -> str:  # noqa: ANN401 - a validator gets any YAML value
    if not isinstance(value, str):
        raise ValueError("input should be a valid string")  # noqa: TRY004 - pydantic's
    if not value:
        raise ValueError("expected the name of a file or folder, got an empty one")
    if "\0" in value:
        raise ValueError("expected the name of a file or folder, got one with a zero byte")
    return value


# Pydantic's own strings refuse file names that are not UTF-8, which Python represents with lone surrogates.
PathText = Annotated[str, PlainValidator(_parse_path), PlainSerializer(lambda value: value, return_type=Any)]

Baselines = Annotated[
    int | Annotated[tuple[float, ...], Field(max_length=_MOST_BASELINES)],
    PlainValidator(_parse_baselines),
    PlainSerializer(lambda value: list(value) if isinstance(value, tuple) else value, return_type=Any),
]
"""A number of baselines, or the baselines in metres."""

# Plain, since pydantic would make a schema of the class `Range` for each use, which takes time.
RangeField = Annotated[Range, PlainValidator(_parse), PlainSerializer(written_range)]
PositiveRange = Annotated[RangeField, at_least(SMALLEST)]
NotNegativeRange = Annotated[RangeField, at_least(0)]
Vector = Annotated[tuple[RangeField, ...], FROM_LIST, Field(min_length=3, max_length=3)]
