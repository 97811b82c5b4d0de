"""The base class of all sections of a config, and the types of their values."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer

NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Weight = NotNegative
Count = Annotated[int, Field(ge=1)]


class Section(BaseModel):
    """Base of all sections: unknown keys are errors, values are not coerced, nothing changes after loading."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


def _list_as_tuple(value: Any) -> Any:  # noqa: ANN401 - a validator gets any YAML value
    return tuple(value) if isinstance(value, list) else value


# YAML has lists, and a frozen section has tuples.
FROM_LIST = BeforeValidator(_list_as_tuple)


def one_of(names: Iterable[str]) -> AfterValidator:
    """Return a validator that accepts these names alone."""
    known = tuple(names)

    def check(name: str) -> str:
        if name not in known:
            raise ValueError(f"expected one of {', '.join(known)}")
        return name

    return AfterValidator(check)


@dataclass(frozen=True, slots=True)
class Range:
    """The closed interval [low, high]. A single number x is the interval [x, x]."""

    low: float
    high: float

    @property
    def middle(self) -> float:
        """The middle of the interval."""
        return (self.low + self.high) / 2

    def draw(self, rng: np.random.Generator) -> float:
        """Draw uniformly. A draw takes one random number for any width, so that fixing a value shifts no other draw."""
        return self.low + (self.high - self.low) * float(rng.random())

    def draw_log(self, rng: np.random.Generator, size: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """Draw (size,) float64 uniformly in the logarithm. The interval must be positive."""
        return self.low * np.power(self.high / self.low, rng.random(size))

    def draw_many(self, rng: np.random.Generator, size: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """Draw (size,) float64 uniformly."""
        return self.low + (self.high - self.low) * rng.random(size)


def _parse(value: object) -> Range:
    if isinstance(value, Range):
        return value
    ends = value if isinstance(value, (list, tuple)) else (value, value)
    if len(ends) != 2 or not all(isinstance(end, (int, float)) and not isinstance(end, bool) for end in ends):
        raise ValueError("expected a number or [low, high]")
    low, high = (float(end) for end in ends)
    if not (np.isfinite(low) and np.isfinite(high)):
        raise ValueError("expected finite numbers")
    if low > high:
        raise ValueError(f"expected [low, high] with low <= high, but {low:g} > {high:g}: the range is empty")
    return Range(low, high)


def _check_low(value: Range, *, positive: bool) -> Range:
    if value.low < 0 or (positive and value.low == 0):
        raise ValueError(f"expected numbers {'above 0' if positive else 'of 0 or more'}")
    return value


def _serialize(value: Range) -> float | list[float]:
    return value.low if value.low == value.high else [value.low, value.high]


RangeField = Annotated[Range, BeforeValidator(_parse), PlainSerializer(_serialize)]
PositiveRange = Annotated[RangeField, AfterValidator(partial(_check_low, positive=True))]
NotNegativeRange = Annotated[RangeField, AfterValidator(partial(_check_low, positive=False))]
