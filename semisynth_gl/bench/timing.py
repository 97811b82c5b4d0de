"""Comparable times: alternatives are timed in turns, so that other work on the machine affects all of them alike."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Timing(NamedTuple):
    """The time of one alternative, as medians over the repeats.

    Attributes:
        seconds: seconds per pair.
        ratio: the time divided by the baseline's time in the same repeat.
    """

    seconds: float
    ratio: float


def turns(names: Sequence[str], rounds: int) -> Iterator[tuple[int, str]]:
    """Yield (round, name) for all names in each round; each round begins one name later than the round before."""
    for number in range(rounds):
        for k in range(len(names)):
            yield number, names[(number + k) % len(names)]


def alternated(
    calls: Mapping[str, Callable[[], object]], repeats: int, clock: Callable[[], float] = time.perf_counter
) -> dict[str, NDArray[np.float64]]:
    """Call each function ``repeats`` times, in `turns`; return, by name, the (repeats,) seconds of its calls."""
    seconds = {name: np.zeros(repeats) for name in calls}
    for number, name in turns(list(calls), repeats):
        start = clock()
        calls[name]()
        seconds[name][number] = clock() - start
    return seconds


def compare_times(seconds: Mapping[str, NDArray[np.float64]], baseline: str, pairs: float) -> dict[str, Timing]:
    """Return the `Timing` of each alternative from the times that `alternated` returns.

    ``baseline`` is the name of the alternative to compare with. ``pairs`` is the number of pairs that one call handles,
    by which seconds are divided.
    """
    return {
        name: Timing(float(np.median(own)) / pairs, float(np.median(own / seconds[baseline])))
        for name, own in seconds.items()
    }
