"""Pairs in flight: while a GPU draws the next pair, threads encode those that are drawn."""

from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Drawn = TypeVar("Drawn")
Encoded = TypeVar("Encoded")


def encoded(pairs: Iterable[Drawn], encode: Callable[[Drawn], Encoded], threads: int) -> Generator[Encoded, None, None]:
    """Encode pairs, and yield them in their order; compression, checksums and numpy let other threads run.

    Pairs are drawn in this thread, which owns the context. While the next pair is drawn, each thread encodes one; 0
    encodes in this thread, as is best where the processor draws. An error of drawing or encoding is raised here, once
    the pairs drawn before are yielded.
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
            except Exception as error:  # noqa: BLE001 - raised again, once the pairs before it are done
                failure = error
                break
            waiting.append(pool.submit(encode, pair))
            if len(waiting) > threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    if failure is not None:
        raise failure
