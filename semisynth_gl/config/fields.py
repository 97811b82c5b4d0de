"""The base class of all sections of a config, and the types of their values."""

import re
from collections.abc import Callable, Iterable
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

LARGEST = 1e6
"""Maximum magnitude of any number in a config: far above useful values, and far below overflow."""

SMALLEST = 1e-6
"""Minimum of numbers that must be above 0; its inverse is `LARGEST`."""


class ConfigError(ValueError):
    """A rule over several keys is broken.

    Attributes:
        keys: the dotted keys in the rule, relative to the section that states the rule.
    """

    def __init__(self, text: str, keys: Iterable[str]) -> None:
        super().__init__(text)
        self.keys = tuple(keys)


class ConfigSection(BaseModel):
    """Base class of all sections: unknown keys are errors, types are not converted, and sections are immutable.

    The docstring below a key is its description in ``semisynth-gl configs NAME`` and in the manual.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, use_attribute_docstrings=True)

    @model_validator(mode="after")
    def _validate_rules(self) -> Self:
        self._check_rules()
        return self

    def _check_rules(self) -> None:
        """Raise ConfigError if the keys of the section, which are valid one by one, contradict each other."""


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
        """Sample uniformly. Even if low equals high, one random number is used, so that later samples do not change."""
        return self.low + (self.high - self.low) * float(rng.random())

    def sample_log(self, rng: np.random.Generator, size: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """Sample (size,) float64 log-uniformly. The interval must be positive."""
        return self.low * np.power(self.high / self.low, rng.random(size))

    def sample_many(self, rng: np.random.Generator, size: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """Sample (size,) float64 uniformly."""
        return self.low + (self.high - self.low) * rng.random(size)


ZERO = Range(0.0, 0.0)


def is_number(value: object) -> TypeGuard[float]:
    """Return whether a value from YAML is a number (not true or false) of at most `LARGEST` in magnitude."""
    return isinstance(value, int | float) and not isinstance(value, bool) and -LARGEST <= value <= LARGEST


def _parse_range(value: object) -> Range:
    if isinstance(value, Range):
        return value
    ends = value if isinstance(value, (list, tuple)) else (value, value)
    if len(ends) != 2 or not all(map(is_number, ends)) or ends[0] > ends[1]:
        raise ValueError(f"expected a number or [low, high] with low <= high, up to {LARGEST:g}")
    return Range(float(ends[0]), float(ends[1]))


def range_to_yaml(value: Range) -> float | list[float]:
    """Return a range as a config states it: a number, or [low, high]."""
    return value.low if value.low == value.high else [value.low, value.high]


def _validator(is_valid: Callable[[Any], object], expected: str) -> AfterValidator:
    def check(value: Any) -> Any:  # noqa: ANN401 - a validator of any type
        if not is_valid(value):
            raise ValueError(f"expected {expected}")
        return value

    return AfterValidator(check)


def within(low: float, high: float = LARGEST) -> AfterValidator:
    """Return a validator of ranges that lie in the closed interval from ``low`` to ``high``."""
    return _validator(lambda value: low <= value.low and value.high <= high, f"{low:g} to {high:g}")


def one_of(names: Iterable[str]) -> AfterValidator:
    """Return a validator that accepts only these names."""
    known = tuple(names)
    return _validator(known.__contains__, f"one of {', '.join(known)}")


# Converts a list from YAML into a tuple: sections are immutable.
FROM_LIST = BeforeValidator(lambda value: tuple(value) if isinstance(value, list) else value)

Finite = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
NotNegative = Annotated[float, Field(ge=0, le=LARGEST)]
Positive = Annotated[float, Field(ge=SMALLEST, le=LARGEST)]
Share = Annotated[float, Field(ge=0, le=1)]
_HYPHENATED = re.compile("[A-Za-z0-9][A-Za-z0-9-]*")
Name = Annotated[str, Field(max_length=100), _validator(_HYPHENATED.fullmatch, "letters, digits and hyphens")]
PluginName = Annotated[str, Field(min_length=1, max_length=100)]
PathText = Annotated[str, _validator(lambda text: text and "\0" not in text, "a path")]

# A plain validator, since pydantic would otherwise build a schema of `Range` for each use, which is slow.
RangeField = Annotated[Range, PlainValidator(_parse_range), PlainSerializer(range_to_yaml)]
PositiveRange = Annotated[RangeField, within(SMALLEST)]
NotNegativeRange = Annotated[RangeField, within(0)]
Vector = Annotated[tuple[RangeField, ...], FROM_LIST, Field(min_length=3, max_length=3)]
