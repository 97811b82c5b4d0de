"""The engines of this machine: `SerialEngine` works in this process, `LocalEngine` in worker processes.

The pool of workers is written here because no other one fits. The standard library's executors neither tell which
worker has which task nor replace a single worker, and pebble's pool limits the time of a whole task. A shard may take
any time, but hangs if no pair comes for long; then another worker goes on after the shard's last pair.
"""

import atexit
import signal
from collections import Counter, deque
from collections.abc import Generator, Iterable, Iterator
from contextlib import ExitStack, suppress
from itertools import islice
from multiprocessing import get_context
from multiprocessing.connection import wait
from time import monotonic
from typing import Any, Generic

from semisynth_gl.engines.interrupts import interrupts_blocked
from semisynth_gl.engines.task import Call, Job, Result, Task, threads_each
from semisynth_gl.engines.worker import CLOSE, STOP, Broken, Failed, Finished, work
from semisynth_gl.inputs.errors import ContextLostError, WorkerError
from semisynth_gl.listener import Listener

# How often a task is repeated after the loss of its context or worker.
_RETRIES = 2
# How long the other workers may go on with their tasks after an error.
_GRACE_S = 5.0
# How long to wait for the exit code of a worker that has closed its pipe: the worker ends soon, and the code says why.
_LAST_BREATH_S = 1.0
# How soon a request to stop is noticed.
_TICK_S = 0.1


class SerialEngine:
    """Does one task after the other in this process. The job is opened for the first task, as worker 0."""

    def run(
        self, job: Job[Result], tasks: Iterable[int], listener: Listener
    ) -> Generator[tuple[int, Result], None, None]:
        """Do all tasks; see `Engine.run`. ContextLostError is raised for a task that loses its context three times."""
        task: Task[Result] | None = None
        with ExitStack() as resources:
            for number in tasks:
                if listener.stopping:
                    return
                for attempt in range(_RETRIES + 1):
                    try:
                        task = task or resources.enter_context(job.open(0))
                        result = task(number, listener)
                        break
                    except ContextLostError as error:
                        if attempt == _RETRIES:
                            raise
                        listener.on_message(f"{error}: task {number} is done again")
                        task = None
                        # Closing may raise the same error.
                        with suppress(ContextLostError):
                            resources.close()
                yield number, result


class LocalEngine:
    """Runs tasks in worker processes of this machine; replaces a worker that dies or hangs, and does its task again.

    Args:
        workers: the largest number of workers; there are never more workers than tasks.
        timeout_s: time without a call or a result from a task after which its worker is taken to hang, s.
    """

    def __init__(self, workers: int, timeout_s: float) -> None:
        self._workers = workers
        self._timeout_s = timeout_s

    def run(
        self, job: Job[Result], tasks: Iterable[int], listener: Listener
    ) -> Generator[tuple[int, Result], None, None]:
        """Do all tasks; see `Engine.run`. WorkerError is raised for a task that has ended three workers."""
        pool = _Pool(job, self._workers, self._timeout_s, listener)
        # A Python process that exits waits for its child processes before it closes iterators that are still open.
        atexit.register(pool.kill)
        try:
            yield from pool.results(iter(tasks))
        finally:
            pool.kill()
            atexit.unregister(pool.kill)


class _Pool(Generic[Result]):
    """The workers of one run and their tasks."""

    def __init__(self, job: Job[Result], most: int, timeout_s: float, listener: Listener) -> None:
        self._job = job
        self._most = most
        self._timeout_s = timeout_s
        self._listener = listener
        self._workers: dict[int, _Worker] = {}
        self._retried: deque[int] = deque()
        self._retries: Counter[int] = Counter()
        self._threads: int | None = None
        self._stopping = False
        self._latest = float("inf")
        self._failure: Exception | None = None

    def results(self, numbers: Iterator[int]) -> Iterator[tuple[int, Result]]:
        self._guide(numbers)
        while self._latest > monotonic() and any(worker.task is not None for worker in self._workers.values()):
            results = self._receive()
            self._end_silent()
            # Tasks are handed out before results are yielded, so that no worker waits for the caller.
            self._guide(numbers)
            yield from results
        self._close()
        if self._failure:
            raise self._failure

    def kill(self) -> None:
        """End all workers at once."""
        for worker in self._workers.values():
            worker.kill()
        while self._workers:
            self._workers.popitem()[1].end()

    def _guide(self, numbers: Iterator[int]) -> None:
        """Give tasks to workers without one, or ask all workers to stop."""
        if self._failure:
            self._latest = min(self._latest, monotonic() + _GRACE_S)
        if not (self._listener.stopping or self._failure):
            self._hand_out(numbers)
        elif not self._stopping:
            self._stopping = True
            for worker in self._workers.values():
                worker.send(STOP)

    def _hand_out(self, numbers: Iterator[int]) -> None:
        idle = [slot for slot in range(self._most) if slot not in self._workers or self._workers[slot].task is None]
        tasks = [self._retried.popleft() for _ in idle[: len(self._retried)]]
        tasks += islice(numbers, len(idle) - len(tasks))
        if self._threads is None:
            self._threads = threads_each(len(tasks))
        for slot, task in zip(idle, tasks, strict=False):
            if slot not in self._workers:
                self._workers[slot] = _Worker(self._job, slot, self._threads)
            self._workers[slot].give(task)

    def _receive(self) -> list[tuple[int, Result]]:
        """Handle the messages of the workers; return the numbers and results of finished tasks."""
        results: list[tuple[int, Result]] = []
        workers = list(self._workers.values())
        ready = wait([each.connection for each in workers] + [each.process.sentinel for each in workers], _TICK_S)
        for worker in workers:
            if worker.connection not in ready and worker.process.sentinel not in ready:
                continue
            messages, ended = worker.receive()
            for message in messages:
                self._take(worker, message, results)
            if ended:
                self._bury(worker)
        return results

    def _take(self, worker: "_Worker", message: object, results: list[tuple[int, Result]]) -> None:
        match message:
            case Call():
                message.repeat(self._listener)
            case Finished() if worker.task is not None:
                results.append((worker.task, message.result))
                worker.task = None
            case Broken():
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
        """Remove a worker that has ended or must end, and let another worker do its task again where that may help."""
        exit_code = worker.end(0 if worker.ends_because else _LAST_BREATH_S)
        del self._workers[worker.number]
        task = worker.task
        if worker.closing:
            return
        how = worker.ends_because or _how_it_ended(exit_code)
        replaced = f"worker {worker.number} is replaced ({how})"
        if task is None:
            self._listener.on_message(replaced)
        elif self._stopping:
            self._listener.on_message(f"worker {worker.number} has ended ({how}): task {task} is left undone")
        elif self._retries[task] == _RETRIES:
            self._failure = self._failure or WorkerError(
                f"task {task} has ended {_RETRIES + 1} workers, the last one like this: {how}. Finished files stay on "
                "disk. If memory runs short, use fewer workers"
            )
        else:
            self._retries[task] += 1
            self._retried.append(task)
            self._listener.on_message(f"{replaced}: task {task} is done again")

    def _close(self) -> None:
        """Let idle workers close the job, and wait for them."""
        latest = min(self._latest, monotonic() + self._timeout_s)
        for worker in self._workers.values():
            if worker.task is None:
                worker.closing = True
                worker.send(CLOSE)
        while any(worker.closing for worker in self._workers.values()) and monotonic() < latest:
            self._receive()


class _Worker:
    """A worker process, as seen from the process that started it."""

    def __init__(self, job: Job[Any], number: int, threads: int) -> None:
        # A forked process would inherit an OpenGL context that it cannot use.
        context = get_context("spawn")
        self.number = number
        self.task: int | None = None
        self.closing = False
        self.ends_because = ""
        self.heard_at = monotonic()
        self.connection, worker_end = context.Pipe()
        self.process = context.Process(target=work, args=(job, number, worker_end, threads), daemon=True)
        with interrupts_blocked():
            self.process.start()
        worker_end.close()

    def give(self, task: int) -> None:
        self.task = task
        self.heard_at = monotonic()
        self.send(task)

    def send(self, message: int | str) -> None:
        # If the worker has just died, that is noticed when the pipe is read.
        with suppress(OSError):
            self.connection.send(message)

    def receive(self) -> tuple[list[object], bool]:
        """Return the worker's unread messages, and True if its end of the pipe is closed, so that no more will come."""
        self.heard_at = monotonic()
        messages: list[object] = []
        try:
            while self.connection.poll():
                messages.append(self.connection.recv())
        except (EOFError, OSError):
            return messages, True
        return messages, False

    def kill(self) -> None:
        # The process object may be closed already, if an interrupt came in the middle of `end`.
        with suppress(ValueError):
            self.process.kill()

    def end(self, patience_s: float = 0) -> int | None:
        """Wait ``patience_s`` for the process to end, then kill it; return its exit code, None if closed already."""
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
