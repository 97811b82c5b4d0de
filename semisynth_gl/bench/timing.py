"""Times that can be compared: alternatives take turns, so that what else the machine does meets all of them alike."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Timing:
    """Time of one alternative.

    Attributes:
        seconds: median over the repeats.
        ratio: median over the repeats of its time divided by the baseline's in the same repeat.
    """

    seconds: float
    ratio: float


def alternated(calls: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, NDArray[np.float64]]:
    """Call each in turn, ``repeats`` times round, starting with another one each time.

    Returns:
        (repeats,) float64 seconds of each.
    """
    names = list(calls)
    seconds = {name: np.zeros(repeats) for name in names}
    for number in range(repeats):
        first = number % len(names)
        for name in names[first:] + names[:first]:
            start = time.perf_counter()
            calls[name]()
            seconds[name][number] = time.perf_counter() - start
    return seconds


def compared(seconds: Mapping[str, NDArray[np.float64]], baseline: str, pairs: int) -> dict[str, Timing]:
    """Medians of times that each drew ``pairs`` pairs, and their ratios to the baseline's."""
    return {
        name: Timing(float(np.median(own)) / pairs, float(np.median(own / seconds[baseline])))
        for name, own in seconds.items()
    }


def front(points: Mapping[str, Sequence[float]], tolerance: float = 0.05) -> set[str]:
    """Names of the points that no other one beats.

    One point beats another where it is smaller in something by more than ``tolerance`` (relative: what repeated
    timings differ by) and in nothing larger by more than that.

    Args:
        points: of each name the same number of values, the smaller the better.
        tolerance: relative.
    """

    def beats(one: Sequence[float], other: Sequence[float]) -> bool:
        pairs = list(zip(one, other, strict=True))
        return all(a <= b * (1 + tolerance) for a, b in pairs) and any(a * (1 + tolerance) < b for a, b in pairs)

    return {name for name, own in points.items() if not any(beats(other, own) for other in points.values())}
