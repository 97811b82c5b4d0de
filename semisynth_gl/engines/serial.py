"""An engine without workers: everything happens in this process."""

from collections.abc import Callable, Generator, Iterable
from contextlib import ExitStack, suppress
from types import TracebackType
from typing import Generic, Self

from semisynth_gl.engines.task import Job, Result, Stop, Task, Watch
from semisynth_gl.errors import ContextLostError

# How often a task is done again after its context was lost.
_RETRIES = 2


class SerialEngine:
    """Does one task after the other in this process; the job is opened when the first one comes."""

    def run(
        self,
        job: Job[Result],
        tasks: Iterable[int],
        *,
        told: Callable[[object], None],
        noted: Callable[[str], None],
        stop: Stop,
    ) -> Generator[tuple[int, Result], None, None]:
        """Do all tasks; see `Engine.run`.

        Raises:
            ContextLostError: where a task loses its context once more than it is done again.
        """
        watch = _WatchHere(told, stop)
        with _Opened(job) as opened:
            for number in tasks:
                if stop.asked:
                    return
                yield number, _do(opened, number, watch, noted)


def _do(opened: "_Opened[Result]", number: int, watch: Watch, noted: Callable[[str], None]) -> Result:
    for _ in range(_RETRIES):
        try:
            return opened.task()(number, watch)
        except ContextLostError as error:
            noted(f"{error}: task {number} is done again")
            opened.close_lost()
    return opened.task()(number, watch)


class _WatchHere:
    def __init__(self, told: Callable[[object], None], stop: Stop) -> None:
        self._stop = stop
        self.tell = told

    @property
    def stopping(self) -> bool:
        return self._stop.asked


class _Opened(Generic[Result]):
    """A job that opens when it is needed."""

    def __init__(self, job: Job[Result]) -> None:
        self._job = job
        self._task: Task[Result] | None = None
        self._stack = ExitStack()

    def task(self) -> Task[Result]:
        if self._task is None:
            self._task = self._stack.enter_context(self._job.open(0))
        return self._task

    def close_lost(self) -> None:
        """Close a job whose context is lost, so that it opens anew."""
        self._task = None
        # Closing may stumble over the same loss.
        with suppress(ContextLostError):
            self._stack.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None:
        return self._stack.__exit__(kind, error, trace)
