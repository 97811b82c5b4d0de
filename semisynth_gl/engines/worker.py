"""The inside of a worker process: it opens the job, does the tasks that come through its pipe, and sends the results.

The process that started it may send a task's number, `STOP` or, last of all, `CLOSE`; the worker answers each number
with `Done` or `Left`, unless it ends: with `Lost`, with `Failed`, or without a word.
"""

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

from semisynth_gl.engines.task import Job
from semisynth_gl.errors import ContextLostError, WorkerError

STOP = "stop"
CLOSE = "close"


@dataclass(frozen=True, slots=True)
class Told:
    """A message of the task's own."""

    message: Any


@dataclass(frozen=True, slots=True)
class Done:
    """The task is done."""

    result: Any


@dataclass(frozen=True, slots=True)
class Left:
    """The task was not begun, since a stop was asked for."""


@dataclass(frozen=True, slots=True)
class Lost:
    """The worker cannot go on; another one may."""

    reason: str


@dataclass(frozen=True, slots=True)
class Failed:
    """The task or the job raised an error that another worker would meet too."""

    error: Exception


def work(job: Job[Any], worker: int, connection: Connection, threads: int) -> None:
    """Be a worker: the whole life of its process.

    Args:
        job: opened once.
        worker: its number.
        connection: to the process that started it.
        threads: how many llvmpipe may have of its own; 0 lets it draw in the calling thread.
    """
    # The terminal sends Ctrl-C to all processes, schedulers send SIGTERM to all; the first process decides what becomes
    # of the tasks in hand. Both were held back until here: see `local`.
    for held in (signal.SIGINT, signal.SIGTERM):
        signal.signal(held, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGTERM})
    os.environ.setdefault("LP_NUM_THREADS", str(threads))
    line = _Line(connection)
    try:
        with job.open(worker) as task:
            for number in line.tasks():
                if line.stopping:
                    line.send(Left())
                    continue
                try:
                    result = task(number, line)
                except ContextLostError as error:
                    _give_up(line, error)
                line.send(Done(result))
    except ContextLostError as error:
        _give_up(line, error)
    except Exception as error:  # noqa: BLE001 - whatever it is, the caller has to know
        line.send(Failed(portable(error, f"worker {worker}")))


def portable(error: Exception, where: str) -> Exception:
    """Make an error fit to be raised in another process, with the traceback as a note.

    Args:
        error: the one that is being handled.
        where: who met it, for the note.

    Returns:
        The error itself, or a `WorkerError` with its text where pickling would not keep it.
    """
    error.add_note(f"In {where}:\n{format_exc().rstrip()}")
    try:
        kept = type(pickle.loads(pickle.dumps(error))) is type(error)  # noqa: S301 - its own bytes
    except Exception:  # noqa: BLE001 - an error's own methods take part in it
        kept = False
    return error if kept else WorkerError(f"{where} met {type(error).__qualname__}: {error}")


def _give_up(line: "_Line", error: ContextLostError) -> None:
    line.send(Lost(str(error)))
    # The job stays open: to close it would ask the lost context once more.
    os._exit(1)


class _Line:
    """A worker's end of its pipe, and what its tasks watch."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._sending = threading.Lock()
        self._stopping = threading.Event()
        self._tasks: SimpleQueue[int | None] = SimpleQueue()
        threading.Thread(target=self._listen, daemon=True).start()

    @property
    def stopping(self) -> bool:
        return self._stopping.is_set()

    def tell(self, message: object) -> None:
        self.send(Told(message))

    def send(self, message: Told | Done | Left | Lost | Failed) -> None:
        with self._sending:
            self._connection.send(message)

    def tasks(self) -> Iterator[int]:
        return iter(self._tasks.get, None)

    def _listen(self) -> None:
        parent = parent_process()
        if parent is None:
            raise RuntimeError("a worker is started by another process")
        while parent.sentinel not in wait([self._connection, parent.sentinel]):
            try:
                message = self._connection.recv()
            except (EOFError, OSError):
                break
            if message == STOP:
                self._stopping.set()
            else:
                self._tasks.put(None if message == CLOSE else message)
        # Nobody is left to work for.
        os._exit(1)
