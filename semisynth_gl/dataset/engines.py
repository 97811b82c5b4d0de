"""Engines that make shards on this machine, in this process or in worker processes."""

import ctypes
import os
import signal
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from multiprocessing import active_children, get_context, parent_process, resource_tracker
from multiprocessing.sharedctypes import Synchronized
from threading import Thread
from typing import Protocol

from semisynth_gl.dataset.make import DatasetJob, ShardMaker
from semisynth_gl.inputs.errors import ContextLostError, WorkerError, counted
from semisynth_gl.listener import Listener

LLVMPIPE_THREADS = "LP_NUM_THREADS"
"""Name of the environment variable that sets llvmpipe's number of threads; see `threads_each`."""

_POOLS = 3  # maximum per run; a pool that lost a worker is replaced
_INTERRUPTS = (signal.SIGINT, signal.SIGTERM)
# M_TRIM_THRESHOLD, -1: maximum number of free bytes at the heap's end. M_MMAP_THRESHOLD, -3: larger arrays are outside
# the heap; some versions of glibc accept no more than 32 MiB.
_MALLOC_OPTIONS = {-1: 256 << 20, -3: 32 << 20}


class Engine(Protocol):
    """Makes the shards of a job."""

    def run(self, job: DatasetJob, numbers: Sequence[int], listener: Listener) -> None:
        """Make the shards of these numbers; return once all are complete.

        The listener receives the pairs of finished shards, and messages about lost workers. Raises WorkerError if
        workers keep dying, and what `ShardMaker.make_shard` raises.
        """


class SerialEngine:
    """Makes one shard after the other in this process."""

    def run(self, job: DatasetJob, numbers: Sequence[int], listener: Listener) -> None:
        """Make shards; see `Engine.run`."""
        with closing(ShardMaker(job)) as maker:
            for number in numbers:
                maker.make_shard(number, listener)


class LocalEngine:
    """Makes shards in up to ``workers`` processes; if one dies, all are restarted, at most twice."""

    def __init__(self, workers: int) -> None:
        self._workers = workers

    def run(self, job: DatasetJob, numbers: Sequence[int], listener: Listener) -> None:
        """Make shards; see `Engine.run`."""
        remaining = dict.fromkeys(numbers)  # a dict, since lists remove slowly
        for attempt in range(1, _POOLS + 1):
            try:
                _run_pool(job, remaining, min(self._workers, len(remaining)), listener)
            except (BrokenProcessPool, ContextLostError) as error:
                why = str(error) if isinstance(error, ContextLostError) else "a worker process died"
                if attempt == _POOLS:
                    advice = "Complete shards stay on disk; where memory runs short, use fewer workers"
                    raise WorkerError(f"{why}, {_POOLS} times. {advice}") from None
                listener.on_message(f"{why}: the workers are restarted for {counted(len(remaining), 'shard')}")
            else:
                return


def _run_pool(job: DatasetJob, remaining: dict[int, None], workers: int, listener: Listener) -> None:
    """Make shards in a pool of processes that ends with the function; remove complete shards from ``remaining``."""
    # A forked process would inherit an OpenGL context that it cannot use.
    context, earlier = get_context("spawn"), {*active_children()}
    executor = ProcessPoolExecutor(workers, context, _start, (job, context.Value("i", 0), threads_each(workers)))
    try:
        with _interrupts_blocked():  # the first calls start the processes
            numbers = {executor.submit(_make, number): number for number in remaining}
        for future in as_completed(numbers):
            report_shard(job, numbers[future], future.result(), listener)
            del remaining[numbers[future]]
    finally:
        executor.shutdown(wait=not remaining, cancel_futures=True)
        for process in {*active_children()} - earlier if remaining else ():
            process.kill()
            process.join()


def report_shard(job: DatasetJob, number: int, renderer: str, listener: Listener) -> None:
    """Report a shard that a worker process made; ``renderer`` is the renderer's name there."""
    listener.on_renderer(renderer)
    shard = job.plan.shards[number]
    for _ in range(shard.first, shard.end):
        listener.on_pair()


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block SIGINT and SIGTERM inside the with statement; processes that start there inherit the blocked signals."""
    # The resource tracker unblocks the signals when it starts: start it before they are blocked.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _INTERRUPTS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


# Set in worker processes only.
_maker: ShardMaker


def _start(job: DatasetJob, started: "Synchronized[int]", threads: int) -> None:
    """Set up a worker process; ``started`` is the number of workers so far."""
    global _maker  # noqa: PLW0603 - one for the process
    # A terminal sends Ctrl-C to all processes. Workers ignore it: the main process ends them.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _INTERRUPTS)
    with started.get_lock():
        number, started.value = started.value, started.value + 1
    Thread(target=_end_with_parent, daemon=True).start()
    os.environ.setdefault(LLVMPIPE_THREADS, str(threads))
    keep_freed_memory()
    _maker = ShardMaker(job, number)


def _end_with_parent() -> None:
    if (parent := parent_process()) is not None:
        parent.join()
    os._exit(1)


def _make(number: int) -> str:
    """Make a shard in a worker process; return the renderer's name."""
    return _maker.make_shard(number, Listener())


def keep_freed_memory() -> None:
    """Let this process reuse the memory of a pair for the next pair, if its C library is glibc.

    Otherwise glibc returns freed arrays to the kernel, which zeroes each page before it can be used again.
    """
    set_option = getattr(ctypes.CDLL(None), "mallopt", None)
    if set_option is not None:
        for option, size in _MALLOC_OPTIONS.items():
            set_option(option, size)


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


def threads_each(workers: int) -> int:
    """Return the number of llvmpipe's threads in each of ``workers`` processes; with 0, the calling thread renders."""
    share = cores() // max(workers, 1)
    return 0 if share < 2 else share
