"""The agreement between engines and their jobs: a job is opened once in each worker and called for each task."""

import os
from collections.abc import Callable, Generator, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar, runtime_checkable

from semisynth_gl.listener import Listener

THREADS = "LP_NUM_THREADS"
"""The environment variable that tells llvmpipe how many threads it may have; see `threads_each`."""

Result = TypeVar("Result")
Result_co = TypeVar("Result_co", covariant=True)


class Task(Protocol[Result_co]):
    """The function that a worker calls with each task's number."""

    def __call__(self, number: int, listener: Listener, /) -> Result_co:
        """Do one task; each call of the listener, the engine's caller's, also proves that the worker lives."""


class Job(Protocol[Result_co]):
    """The work of an engine. Each worker opens the job once, and calls the function that comes for each task.

    A job goes to worker processes by pickling: it holds settings alone and opens its resources when it is entered.
    """

    def open(self, worker: int) -> AbstractContextManager[Task[Result_co]]:
        """Open the resources of the tasks; the worker's number is from 0, and its replacement has the same number."""


@runtime_checkable
class Engine(Protocol):
    """Runs a job's function over numbered tasks."""

    def run(
        self, job: Job[Result], tasks: Iterable[int], listener: Listener
    ) -> Generator[tuple[int, Result], None, None]:
        """Do all tasks.

        Once the listener asks to stop, no further task begins, and the iteration ends after the results of the running
        ones, which see `Listener.stopping` too. Closing the iterator ends all workers at once: keep the iterator in
        `contextlib.closing`, so that an exception between two results closes it too.

        Args:
            job: the work, opened once in each worker.
            tasks: the tasks' numbers, all different; each number is taken when a worker is free for it.
            listener: hears the tasks' calls, in order for each worker, and a message about each restart and retry.

        Yields:
            Each task's number and result as soon as the task ends, in any order.

        Raises:
            WorkerError: where workers keep dying.
            Exception: the error of a task or of the job's opening, of the same type; others may end their tasks first.
        """


@dataclass(frozen=True, slots=True)
class Call:
    """A call of a listener's method, on its way from a worker's process to the caller's; it can be pickled."""

    method: str
    argument: Any

    def repeat(self, listener: Listener) -> None:
        """Call the method of the caller's listener."""
        getattr(listener, self.method)(self.argument)


class Relay(Listener):
    """The caller's listener as a worker's process has it; a function sends each call on."""

    def __init__(self, send: Callable[[Call], object]) -> None:
        for name in dir(Listener):
            if name.startswith("on_"):
                setattr(self, name, lambda argument, name=name: send(Call(name, argument)))


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0))


def threads_each(workers: int) -> int:
    """Return how many threads llvmpipe may have (`THREADS`) in each of several processes that share the cores.

    0 lets llvmpipe draw in the thread that calls.
    """
    share = cores() // max(workers, 1)
    return 0 if share < 2 else share
