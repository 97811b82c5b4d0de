"""Engines: they run one function over numbered tasks, here or in worker processes, and know nothing of what it does.

A `Job` is what a worker opens once and then calls for each task. It goes to worker processes by pickling, so it holds
settings alone and opens its resources when it is entered.
"""

import os
import signal
import threading
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, ExitStack
from itertools import islice
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from types import TracebackType
from typing import Any, Generic, Protocol, Self, TypeVar

from semisynth_gl.errors import WorkerError

Result = TypeVar("Result")
Result_co = TypeVar("Result_co", covariant=True)

# Tasks handed out beyond those that are being worked on, so that no worker waits for its next one.
_TASKS_AHEAD = 2


class Job(Protocol[Result_co]):
    """What a worker opens once: entering gives the function that it calls for each task."""

    def open(self) -> AbstractContextManager["Task[Result_co]"]:
        """Open what the tasks need."""


class Task(Protocol[Result_co]):
    """The function that is called with each task's number."""

    def __call__(self, number: int, /) -> Result_co:
        """Do one task."""


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0))


class LocalWorkers(Generic[Result]):
    """Worker processes of this machine. Use them in a ``with`` block; they begin to open their job at once.

    Args:
        job: opened once in each worker.
        count: how many workers.

    Raises:
        WorkerError: (from `run`) where a worker dies.
    """

    def __init__(self, job: Job[Result], count: int) -> None:
        self._count = count
        # Workers share the cores out; llvmpipe draws in the calling thread where it is given none of its own.
        share = cores() // count
        # Forked processes would inherit an OpenGL context that they cannot use.
        self._pool = ProcessPoolExecutor(
            count,
            mp_context=get_context("spawn"),
            initializer=_open_job,
            initargs=(job, 0 if share < 2 else share),
        )
        for _ in range(count):
            self._pool.submit(os.getpid)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)

    def run(self, tasks: Iterable[int]) -> Iterator[Result]:
        """Do all tasks, and give their results in the tasks' order.

        Raises:
            WorkerError: where a worker dies.
            BaseException: what a task or the opening of the job raises.
        """
        waiting: deque[Future[Result]] = deque()
        numbers = iter(tasks)
        try:
            while True:
                for number in islice(numbers, self._count + _TASKS_AHEAD - len(waiting)):
                    waiting.append(self._pool.submit(_do_task, number))
                if not waiting:
                    return
                yield waiting.popleft().result()
        except BrokenProcessPool:
            raise WorkerError(
                "a worker process died: it was killed, or ran out of memory. Whole pairs stay on disk. "
                "Fewer --workers take less memory"
            ) from None


_opened: Any = None
_stack = ExitStack()


def _open_job(job: Job[Any], threads: int) -> None:
    # The terminal sends Ctrl-C to all processes; the first one decides what becomes of it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.environ.setdefault("LP_NUM_THREADS", str(threads))
    global _opened  # noqa: PLW0603 - a pool's initializer can hand nothing else to its tasks
    try:
        _opened = _stack.enter_context(job.open())
    except Exception as error:  # noqa: BLE001 - kept for the first task: a pool only says that it is broken
        _opened = error


def _do_task(number: int) -> Any:  # noqa: ANN401 - whatever the job returns
    if isinstance(_opened, Exception):
        raise _opened
    return _opened(number)


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
