"""What engines and the work that they run agree on: a job is opened once in each worker and called for each task."""

import os
from collections.abc import Callable, Generator, Iterable
from contextlib import AbstractContextManager
from typing import Protocol, TypeVar

Result = TypeVar("Result")
Result_co = TypeVar("Result_co", covariant=True)


class Watch(Protocol):
    """What a running task knows of whoever runs the engine."""

    @property
    def stopping(self) -> bool:
        """Whether the task should return soon, with what it has."""

    def tell(self, message: object) -> None:
        """Send a message to whoever runs the engine; it also proves that the worker lives.

        Args:
            message: anything that can be pickled.
        """


class Task(Protocol[Result_co]):
    """The function that is called with each task's number."""

    def __call__(self, number: int, watch: Watch, /) -> Result_co:
        """Do one task."""


class Job(Protocol[Result_co]):
    """What a worker opens once: entering gives the function that it calls for each task.

    A job goes to worker processes by pickling, so it holds settings alone and opens its resources when it is entered.
    """

    def open(self, worker: int) -> AbstractContextManager[Task[Result_co]]:
        """Open what the tasks need.

        Args:
            worker: the worker's number, from 0; a worker that takes another's place has its number.
        """


class Stop:
    """The caller's wish to stop soon. A signal handler may ask at any time.

    Attributes:
        asked: whether it was asked for.
    """

    def __init__(self) -> None:
        self.asked = False

    def ask(self) -> None:
        """Ask to stop: running tasks return soon, no other is begun."""
        self.asked = True


class Engine(Protocol):
    """Runs a job's function over numbered tasks."""

    def run(
        self,
        job: Job[Result],
        tasks: Iterable[int],
        *,
        told: Callable[[object], None],
        noted: Callable[[str], None],
        stop: Stop,
    ) -> Generator[tuple[int, Result], None, None]:
        """Do all tasks.

        Once a stop is asked for no further task is begun, those that run see `Watch.stopping`, and the iteration ends
        after their results. Closing the iterator ends all workers at once: keep it in `contextlib.closing`, so that
        an exception between two results closes it too.

        Args:
            job: opened once in each worker.
            tasks: their numbers, all different; each is taken when a worker is free for it.
            told: gets the tasks' messages, in order for each worker. Called, like the next one, by the iteration.
            noted: gets a sentence for the user about each restart and retry.
            stop: the wish to stop soon.

        Yields:
            Each task's number and result as soon as it is done, in any order.

        Raises:
            WorkerError: where workers keep dying.
            Exception: what a task or the opening of the job raises, of the same type.
        """


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0))


def threads_each(workers: int) -> int:
    """How many threads llvmpipe may have of its own (LP_NUM_THREADS) in each of several processes.

    They share the cores out; 0 lets it draw in the thread that calls.
    """
    share = cores() // max(workers, 1)
    return 0 if share < 2 else share
