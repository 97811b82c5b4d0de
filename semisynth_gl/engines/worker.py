"""The inside of a worker process: it opens the job, does the tasks that come through its pipe, and sends the results.

The process that started the worker sends task numbers, `STOP` and, as the last message, `CLOSE`. The worker answers
each number with `Finished` or `NotBegun`. If it cannot go on, it sends `Broken` or `Failed` and ends; a crash ends it
without a message. Before the answer to a number, any number of `Call` may come.
"""

import ctypes
import os
import pickle
import signal
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait
from queue import SimpleQueue
from traceback import format_exc
from typing import Any

from semisynth_gl.engines.task import THREADS, Call, Job, Relay
from semisynth_gl.inputs.errors import ContextLostError, WorkerError, described

STOP = "stop"
CLOSE = "close"

# M_TRIM_THRESHOLD, -1: most free bytes that stay at the heap's end. M_MMAP_THRESHOLD, -3: arrays larger than this are
# not part of the heap; 32 MiB is the most that all versions of glibc accept.
_MALLOC_OPTIONS = {-1: 256 << 20, -3: 32 << 20}


@dataclass(frozen=True, slots=True)
class Finished:
    """The task has a result."""

    result: Any


@dataclass(frozen=True, slots=True)
class NotBegun:
    """The task was not begun, because of a stop."""


@dataclass(frozen=True, slots=True)
class Broken:
    """The worker cannot go on; another worker may."""

    reason: str


@dataclass(frozen=True, slots=True)
class Failed:
    """The task or the job raised an error that another worker would meet too."""

    error: Exception


def work(job: Job[Any], worker: int, connection: Connection, threads: int) -> None:
    """Run a worker, from the start of its process to its end.

    Args:
        job: the work.
        worker: the worker's number.
        connection: the worker's end of the pipe.
        threads: number of llvmpipe's threads, as `threads_each` returns it.
    """
    # A terminal sends Ctrl-C, and a scheduler SIGTERM, to all processes. Workers ignore both, since the first process
    # decides about the tasks in hand. The signals were blocked until here: see `interrupts_blocked`.
    for ending_signal in (signal.SIGINT, signal.SIGTERM):
        signal.signal(ending_signal, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGTERM})
    os.environ.setdefault(THREADS, str(threads))
    keep_freed_memory()
    pipe = _Pipe(connection)
    try:
        with job.open(worker) as task:
            for number in pipe.tasks():
                if pipe.stopping:
                    pipe.send(NotBegun())
                    continue
                try:
                    result = task(number, pipe)
                except ContextLostError as error:
                    _give_up(pipe, error)
                pipe.send(Finished(result))
    except ContextLostError as error:
        _give_up(pipe, error)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever it is, the caller has to know
        pipe.send(Failed(portable(error, f"worker {worker}")))


def keep_freed_memory() -> None:
    """Let this process keep the memory of a pair for the next pair.

    Otherwise glibc returns the memory of freed arrays to the kernel, which gives it out again in single zeroed pages,
    with thousands of page faults for each pair. With another C library than glibc, nothing is done.
    """
    set_option = getattr(ctypes.CDLL(None), "mallopt", None)
    if set_option is not None:
        for option, size in _MALLOC_OPTIONS.items():
            set_option(option, size)


def portable(error: BaseException, where: str) -> Exception:
    """Return the error that is being handled in a form that can be raised in another process.

    This is the error itself, with a note that has its traceback and ``where``, the process that raised it. It is a
    `WorkerError` with the error's text instead if the error does not survive pickling, or is no `Exception`, such as
    SystemExit, which would end the other process.
    """
    if not isinstance(error, Exception):
        return WorkerError(f"{where} met {described(error)}")
    error.add_note(f"In {where}:\n{format_exc().rstrip()}")
    try:
        kept = type(pickle.loads(pickle.dumps(error))) is type(error)  # noqa: S301 - its own bytes
    except Exception:  # noqa: BLE001 - an error's own methods take part in it
        kept = False
    return error if kept else WorkerError(f"{where} met {described(error)}")


def _give_up(pipe: "_Pipe", error: ContextLostError) -> None:
    pipe.send(Broken(str(error)))
    # The job stays open, since closing it would use the broken context again.
    os._exit(1)


class _Pipe(Relay):
    """The worker's end of its pipe, and the listener of its tasks."""

    def __init__(self, connection: Connection) -> None:
        super().__init__(self.send)
        self._connection = connection
        self._sending = threading.Lock()
        self._tasks: SimpleQueue[int | None] = SimpleQueue()
        threading.Thread(target=self._receive, daemon=True).start()

    def send(self, message: Call | Finished | NotBegun | Broken | Failed) -> None:
        with self._sending:
            self._connection.send(message)

    def tasks(self) -> Iterator[int]:
        return iter(self._tasks.get, None)

    def _receive(self) -> None:
        parent = parent_process()
        if parent is None:
            raise RuntimeError("a worker is started by another process")
        while parent.sentinel not in wait([self._connection, parent.sentinel]):
            try:
                message = self._connection.recv()
            except (EOFError, OSError):
                break
            if message == STOP:
                self.stop()
            else:
                self._tasks.put(None if message == CLOSE else message)
        # The parent process has ended or closed the pipe, so nobody waits for a result.
        os._exit(1)
