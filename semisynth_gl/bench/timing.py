"""Comparable times: alternatives take turns, so that other work of the machine meets all of them alike."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Timing(NamedTuple):
    """The time of one alternative: medians over the repeats of the seconds, and of the ratio to the baseline's time."""

    seconds: float
    ratio: float


def turns(names: Sequence[str], rounds: int) -> Iterator[tuple[int, str]]:
    """Yield the number of each round with all names in turn; each round begins with the next name."""
    for number in range(rounds):
        for k in range(len(names)):
            yield number, names[(number + k) % len(names)]


def alternated(
    calls: Mapping[str, Callable[[], object]], repeats: int, clock: Callable[[], float] = time.perf_counter
) -> dict[str, NDArray[np.float64]]:
    """Call all functions in `turns`; return the (repeats,) seconds of each by a clock."""
    seconds = {name: np.zeros(repeats) for name in calls}
    for number, name in turns(list(calls), repeats):
        start = clock()
        calls[name]()
        seconds[name][number] = clock() - start
    return seconds


def compare_times(seconds: Mapping[str, NDArray[np.float64]], baseline: str, pairs: float) -> dict[str, Timing]:
    """Compare (repeats,) seconds of a number of pairs with a baseline's in the same repeat; seconds become per pair."""
    return {
        name: Timing(float(np.median(own)) / pairs, float(np.median(own / seconds[baseline])))
        for name, own in seconds.items()
    }
