"""A quantity that is either one number or drawn from an interval."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, BeforeValidator, PlainSerializer


@dataclass(frozen=True, slots=True)
class Range:
    """The closed interval [low, high]; a single number is the interval [x, x]."""

    low: float
    high: float

    def draw(self, rng: np.random.Generator) -> float:
        """Draw uniformly; one number is consumed whatever the width, so that fixing a value shifts no other draw."""
        return self.low + (self.high - self.low) * float(rng.random())

    def draw_log(self, rng: np.random.Generator, size: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """Draw (size,) float64 uniformly in the logarithm; the interval must be positive."""
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


def _positive(value: Range) -> Range:
    if value.low <= 0:
        raise ValueError("expected numbers above 0")
    return value


def _not_negative(value: Range) -> Range:
    if value.low < 0:
        raise ValueError("expected numbers of 0 or more")
    return value


def _plain(value: Range) -> float | list[float]:
    return value.low if value.low == value.high else [value.low, value.high]


RangeField = Annotated[Range, BeforeValidator(_parse), PlainSerializer(_plain)]
PositiveRange = Annotated[RangeField, AfterValidator(_positive)]
NotNegativeRange = Annotated[RangeField, AfterValidator(_not_negative)]
