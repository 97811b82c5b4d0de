"""The interface between engines and jobs: a worker opens the job once, and calls its function for each task."""

import os
from collections.abc import Callable, Generator, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar, runtime_checkable

from semisynth_gl.listener import Listener

THREADS = "LP_NUM_THREADS"
"""Environment variable with the number of threads that llvmpipe may have; see `threads_each`."""

Result = TypeVar("Result")
Result_co = TypeVar("Result_co", covariant=True)


class Task(Protocol[Result_co]):
    """The function that a worker calls for each task."""

    def __call__(self, number: int, listener: Listener, /) -> Result_co:
        """Do the task of this number and return its result.

        Calls of the listener reach the listener of the engine's caller; each also proves that the worker is alive.
        """


class Job(Protocol[Result_co]):
    """The work that an engine does.

    Each worker opens the job once, and calls the function that opening returns for each task. A job is pickled for
    worker processes, so it only holds settings; it gets its resources when the context manager is entered.
    """

    def open(self, worker: int) -> AbstractContextManager[Task[Result_co]]:
        """Return a context manager with the tasks' resources, which yields the task function.

        Workers are numbered from 0; the replacement of a worker has the same number.
        """


@runtime_checkable
class Engine(Protocol):
    """Runs a job's function over numbered tasks."""

    def run(
        self, job: Job[Result], tasks: Iterable[int], listener: Listener
    ) -> Generator[tuple[int, Result], None, None]:
        """Do all tasks.

        Once `Listener.stopping` is true, no further task begins, and the iteration ends after the results of the
        running tasks, which can see `Listener.stopping` too. Closing the iterator ends all workers at once: keep it in
        `contextlib.closing`, so that an exception between two results closes it too.

        Args:
            job: the work, opened once in each worker.
            tasks: the tasks' numbers, all different; each number is taken only when a worker is free for it.
            listener: gets the tasks' calls, in order for each worker, and a message about each restart and retry.

        Yields:
            Each task's number and result, as soon as the task ends, so in any order.

        Raises:
            WorkerError: where workers keep dying, or an error cannot be pickled.
            Exception: the error of a task or of the job's opening, as it was raised; other running tasks may end first.
        """


@dataclass(frozen=True, slots=True)
class Call:
    """A call of a listener's method, to be sent from a worker's process to the caller's; it can be pickled."""

    method: str
    argument: Any

    def repeat(self, listener: Listener) -> None:
        """Call the method of a listener, the caller's."""
        getattr(listener, self.method)(self.argument)


class Relay(Listener):
    """A listener in a worker's process that turns each call into a `Call` and sends it with a function."""

    def __init__(self, send: Callable[[Call], object]) -> None:
        for name in dir(Listener):
            if name.startswith("on_"):
                setattr(self, name, lambda argument, name=name: send(Call(name, argument)))


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


def threads_each(workers: int) -> int:
    """Return the number of threads that llvmpipe may have (`THREADS`) in each of ``workers`` processes.

    The processes share the usable cores. 0 lets llvmpipe draw in the calling thread.
    """
    share = cores() // max(workers, 1)
    return 0 if share < 2 else share
