"""Comparable times: alternatives take turns, so that other work of the machine meets all of them alike."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Timing(NamedTuple):
    """Time of one alternative.

    Attributes:
        seconds: median over the repeats.
        ratio: median over the repeats of its time divided by the baseline's in the same repeat.
    """

    seconds: float
    ratio: float


def turns(names: Sequence[str], rounds: int) -> Iterator[tuple[int, str]]:
    """Yield the number of each round with all names in turn; each round begins with the next name."""
    for number in range(rounds):
        for k in range(len(names)):
            yield number, names[(number + k) % len(names)]


def alternated(calls: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, NDArray[np.float64]]:
    """Call all functions in turn, ``repeats`` times round; each round begins with the next function.

    Returns:
        (repeats,) float64 seconds of each function.
    """
    seconds = {name: np.zeros(repeats) for name in calls}
    for number, name in turns(list(calls), repeats):
        start = time.perf_counter()
        calls[name]()
        seconds[name][number] = time.perf_counter() - start
    return seconds


def compare_times(seconds: Mapping[str, NDArray[np.float64]], baseline: str, pairs: float) -> dict[str, Timing]:
    """Take medians of times and of their ratios to the baseline's.

    Args:
        seconds: (repeats,) of each alternative, for all pairs together.
        baseline: one of the names.
        pairs: number of pairs in a repeat; `Timing.seconds` is for one of them.
    """
    return {
        name: Timing(float(np.median(own)) / pairs, float(np.median(own / seconds[baseline])))
        for name, own in seconds.items()
    }
