"""Alternatives beside each other: timed in turns, so that other work on the machine affects all alike, and weighed."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

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


def front(points: Mapping[str, Sequence[float]], tolerance: float = 0.05) -> set[str]:
    """Return the names of the points on the Pareto front, which no other point dominates; smaller values are better.

    A point dominates another if at least one of its values is smaller by more than the tolerance, and none is larger by
    more than that. All points have equally many values. The tolerance is relative: repeated timings differ by 5 %.
    """

    def dominates(point: Sequence[float], rival: Sequence[float]) -> bool:
        pairs = list(zip(point, rival, strict=True))
        return all(a <= b * (1 + tolerance) for a, b in pairs) and any(a * (1 + tolerance) < b for a, b in pairs)

    return {name for name, own in points.items() if not any(dominates(point, own) for point in points.values())}


def alternative_rows(
    texts: Mapping[str, str],
    times: Mapping[str, Timing],
    figures: Mapping[str, Mapping[str, Any]],
    weighed: Mapping[str, Sequence[float]],
) -> list[dict[str, Any]]:
    """Return a row for each alternative, in the order of ``texts``.

    All arguments go by the names of the alternatives.

    Args:
        texts: descriptions.
        times: times for a pair, relative to the default's.
        figures: further keys and values of the row.
        weighed: the values besides time that decide about the Pareto front, smaller being better. An alternative
            without such values is never on the front.

    Returns:
        Rows with "name", "text", "seconds_per_pair", "time_ratio", the keys of ``figures``, and "on_front".
    """
    best = front({name: (times[name].ratio, *values) for name, values in weighed.items()})
    return [
        {
            "name": name,
            "text": text,
            "seconds_per_pair": times[name].seconds,
            "time_ratio": times[name].ratio,
            **figures[name],
            "on_front": name in best,
        }
        for name, text in texts.items()
    ]
