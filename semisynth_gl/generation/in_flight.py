"""Pairs in flight: while a GPU draws the next pair, threads encode the pairs that are drawn."""

from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Drawn = TypeVar("Drawn")
Encoded = TypeVar("Encoded")


def encoded(pairs: Iterable[Drawn], encode: Callable[[Drawn], Encoded], threads: int) -> Generator[Encoded, None, None]:
    """Encode pairs in ``threads`` threads, and yield the results in order.

    This thread draws the pairs, since it owns the context, while each other thread encodes one pair: compression,
    checksums and NumPy let other threads run. With 0 threads, this thread also encodes, which is best where the
    processor draws. An error of drawing or encoding is raised here, after the results of all earlier pairs.
    """
    if threads == 0:
        yield from map(encode, pairs)
        return
    waiting: deque[Future[Encoded]] = deque()
    failure: Exception | None = None
    with ThreadPoolExecutor(threads) as pool:
        drawn = iter(pairs)
        while True:
            try:
                pair = next(drawn)
            except StopIteration:
                break
            except Exception as error:  # noqa: BLE001 - raised again after all earlier pairs
                failure = error
                break
            waiting.append(pool.submit(encode, pair))
            if len(waiting) > threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    if failure is not None:
        raise failure
