"""An engine of worker processes on this machine."""

import atexit
import signal
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from itertools import islice
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import wait
from time import monotonic
from typing import Any, Generic

from semisynth_gl.engines.task import Job, Result, Stop, threads_each
from semisynth_gl.engines.worker import CLOSE, STOP, Done, Failed, Lost, Told, work
from semisynth_gl.errors import WorkerError

# How many workers a task may lose before it is given up.
_LOSSES = 2

# How long the workers that are not to blame for an error may take to finish what they have in hand.
_GRACE_S = 5.0

# A worker that has let go of its pipe is about to end, with an exit code that tells why.
_LAST_BREATH_S = 1.0

# How soon a wish to stop is noticed.
_TICK_S = 0.1


class LocalEngine:
    """Worker processes of this machine; one that dies or hangs is replaced, and its task done again.

    The pool is this module's own: executors of the standard library and of its relatives cannot say which worker has
    which task, nor kill and replace one worker alone.

    Args:
        workers: how many at most; never more than tasks.
        timeout_s: a worker with a task, from which neither message nor result came for so long, hangs.
    """

    def __init__(self, workers: int, timeout_s: float) -> None:
        self._workers = workers
        self._timeout_s = timeout_s

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
            WorkerError: where a task has lost three workers.
            Exception: what a task or the opening of the job raises. Other workers may finish their tasks first.
        """
        pool = _Pool(job, self._workers, self._timeout_s, told, noted)
        # At its end the interpreter waits for processes before it closes iterators that were left open.
        atexit.register(pool.kill)
        try:
            yield from pool.results(iter(tasks), stop)
        finally:
            pool.kill()
            atexit.unregister(pool.kill)


class _Pool(Generic[Result]):
    """The workers of one run, and who has which task."""

    def __init__(
        self,
        job: Job[Result],
        most: int,
        timeout_s: float,
        told: Callable[[object], None],
        noted: Callable[[str], None],
    ) -> None:
        self._job = job
        self._most = most
        self._timeout_s = timeout_s
        self._told = told
        self._noted = noted
        self._workers: dict[int, _Worker] = {}
        self._again: deque[int] = deque()
        self._losses: Counter[int] = Counter()
        self._threads: int | None = None
        self._stopping = False
        self._latest = float("inf")
        self._failure: Exception | None = None

    def results(self, numbers: Iterator[int], stop: Stop) -> Iterator[tuple[int, Result]]:
        self._guide(numbers, stop)
        while self._latest > monotonic() and any(worker.task is not None for worker in self._workers.values()):
            done = self._receive()
            self._end_silent()
            # Before the caller looks at results, so that no worker waits for that.
            self._guide(numbers, stop)
            yield from done
        self._close()
        if self._failure:
            raise self._failure

    def kill(self) -> None:
        """End all workers at once."""
        for worker in self._workers.values():
            worker.kill()
        while self._workers:
            self._workers.popitem()[1].end()

    def _guide(self, numbers: Iterator[int], stop: Stop) -> None:
        """Give tasks to workers that have none, or see to it that all come to their end."""
        if self._failure:
            self._latest = min(self._latest, monotonic() + _GRACE_S)
        if not (stop.asked or self._failure):
            self._hand_out(numbers)
        elif not self._stopping:
            self._stopping = True
            for worker in self._workers.values():
                worker.send(STOP)

    def _hand_out(self, numbers: Iterator[int]) -> None:
        idle = [each for each in range(self._most) if each not in self._workers or self._workers[each].task is None]
        tasks = [self._again.popleft() for _ in idle[: len(self._again)]]
        tasks += islice(numbers, len(idle) - len(tasks))
        if self._threads is None:
            self._threads = threads_each(len(tasks))
        for each, task in zip(idle, tasks, strict=False):
            if each not in self._workers:
                self._workers[each] = _Worker(self._job, each, self._threads)
            self._workers[each].give(task)

    def _receive(self) -> list[tuple[int, Result]]:
        """Take in what workers send; return the results."""
        done: list[tuple[int, Result]] = []
        workers = list(self._workers.values())
        ready = wait([each.connection for each in workers] + [each.process.sentinel for each in workers], _TICK_S)
        for worker in workers:
            if worker.connection not in ready and worker.process.sentinel not in ready:
                continue
            messages, ended = worker.receive()
            for message in messages:
                self._take(worker, message, done)
            if ended:
                self._bury(worker)
        return done

    def _take(self, worker: "_Worker", message: object, done: list[tuple[int, Result]]) -> None:
        match message:
            case Told():
                self._told(message.message)
            case Done() if worker.task is not None:
                done.append((worker.task, message.result))
                worker.task = None
            case Lost():
                worker.ends_because = message.reason
            case Failed():
                self._failure = self._failure or message.error
                worker.task = None
                worker.closing = True
            case _:
                worker.task = None

    def _end_silent(self) -> None:
        for worker in list(self._workers.values()):
            if worker.task is not None and monotonic() - worker.heard_at > self._timeout_s:
                worker.ends_because = f"nothing came from it for {self._timeout_s:g} s"
                self._bury(worker)

    def _bury(self, worker: "_Worker") -> None:
        """Take a worker out that has ended or has to; its task is done again by another."""
        exit_code = worker.end(0 if worker.ends_because else _LAST_BREATH_S)
        del self._workers[worker.number]
        task = worker.task
        if worker.closing:
            return
        how = worker.ends_because or _how_it_ended(exit_code)
        what = f"worker {worker.number} is replaced ({how})"
        if task is None:
            self._noted(what)
        elif self._stopping:
            self._noted(f"worker {worker.number} has ended ({how}): task {task} is left undone")
        elif self._losses[task] == _LOSSES:
            self._failure = self._failure or WorkerError(
                f"task {task} has ended {_LOSSES + 1} workers, the last one like this: {how}. What is on disk stays. "
                "Where memory runs short, fewer workers take less of it"
            )
        else:
            self._losses[task] += 1
            self._again.append(task)
            self._noted(f"{what}: task {task} is done again")

    def _close(self) -> None:
        """Let idle workers close their job."""
        latest = min(self._latest, monotonic() + self._timeout_s)
        for worker in self._workers.values():
            if worker.task is None:
                worker.closing = True
                worker.send(CLOSE)
        while any(worker.closing for worker in self._workers.values()) and monotonic() < latest:
            self._receive()


class _Worker:
    """A worker process as seen from outside.

    Args:
        job: what it opens.
        number: its number.
        threads: how many llvmpipe may have of its own.
    """

    def __init__(self, job: Job[Any], number: int, threads: int) -> None:
        # Forked processes would inherit an OpenGL context that they cannot use.
        context = get_context("spawn")
        self.number = number
        self.task: int | None = None
        self.closing = False
        self.ends_because = ""
        self.heard_at = monotonic()
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=work, args=(job, number, theirs, threads), daemon=True)
        with _signals_held():
            self.process.start()
        theirs.close()

    def give(self, task: int) -> None:
        self.task = task
        self.heard_at = monotonic()
        self.send(task)

    def send(self, message: int | str) -> None:
        # A worker that has just died is noticed when its end of the pipe is read.
        with suppress(OSError):
            self.connection.send(message)

    def receive(self) -> tuple[list[object], bool]:
        """Return the messages that have come, and whether its end of the pipe is closed: no more will come."""
        self.heard_at = monotonic()
        messages: list[object] = []
        try:
            while self.connection.poll():
                messages.append(self.connection.recv())
        except (EOFError, OSError):
            return messages, True
        return messages, False

    def kill(self) -> None:
        # It may be closed already where an interrupt came while it was being ended.
        with suppress(ValueError):
            self.process.kill()

    def end(self, patience_s: float = 0) -> int | None:
        """See to it that its process has ended, by itself or else by force; return the exit code."""
        with suppress(ValueError):
            self.process.join(patience_s)
            self.process.kill()
            self.process.join()
            exit_code = self.process.exitcode
            self.connection.close()
            self.process.close()
            return exit_code
        return None


def _how_it_ended(exit_code: int | None) -> str:
    if exit_code is not None and exit_code < 0:
        with suppress(ValueError):
            return f"killed by {signal.Signals(-exit_code).name}"
    return f"it ended with exit code {exit_code}"


@contextmanager
def _signals_held() -> Iterator[None]:
    """Let processes that are started meanwhile inherit a mask that keeps them safe until they ignore these signals."""
    # It is started with the first process otherwise, and would lift the mask.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
