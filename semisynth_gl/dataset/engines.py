"""The engines of this machine: each makes shards, in this process or in worker processes."""

import ctypes
import os
import signal
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from itertools import islice
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.sharedctypes import Synchronized
from threading import Thread
from typing import Any, Protocol

from semisynth_gl.dataset.interrupts import ENDING_SIGNALS, interrupts_blocked
from semisynth_gl.dataset.make import Job, ShardMaker
from semisynth_gl.inputs.errors import ContextLostError, WorkerError, counted
from semisynth_gl.listener import FinishedPair, Listener

THREADS = "LP_NUM_THREADS"
"""Environment variable with the number of threads that llvmpipe may have; see `threads_each`."""

_POOLS = 3  # of a run, at most; a pool that lost a worker is replaced
_AHEAD = 2  # shards that wait for each worker, so that none is idle
_TICK_S = 0.1  # how soon a request to stop ends the workers
# M_TRIM_THRESHOLD, -1: most free bytes that stay at the heap's end. M_MMAP_THRESHOLD, -3: arrays larger than this are
# not part of the heap; 32 MiB is the most that all versions of glibc accept.
_MALLOC_OPTIONS = {-1: 256 << 20, -3: 32 << 20}


class Engine(Protocol):
    """Makes the shards of a job."""

    def run(self, job: Job, numbers: Sequence[int], listener: Listener) -> None:
        """Make the shards of these numbers; return once all are complete, or soon after `Listener.stopping` is true.

        The listener hears the pairs of finished shards, and messages about lost workers. Raises WorkerError where
        workers keep dying, and the error of a shard as `ShardMaker.make_shard` does.
        """


class SerialEngine:
    """Makes one shard after the other in this process."""

    def run(self, job: Job, numbers: Sequence[int], listener: Listener) -> None:
        """Make shards; see `Engine.run`. A request to stop ends the shard after the current pair."""
        with closing(ShardMaker(job)) as maker:
            for number in numbers:
                if listener.stopping or not maker.make_shard(number, listener):
                    return


class Recorder(Listener):
    """Keeps what a worker process reports about a shard, for the listener of the first process."""

    def __init__(self) -> None:
        self._heard: list[tuple[str, Any]] = []

    def on_renderer(self, name: str) -> None:
        """Keep the name."""
        self._heard.append(("on_renderer", name))

    def on_pair(self, pair: FinishedPair) -> None:
        """Keep the pair."""
        self._heard.append(("on_pair", pair))

    def repeat(self, listener: Listener) -> None:
        """Tell another listener what this one has heard."""
        for method, value in self._heard:
            getattr(listener, method)(value)


class LocalEngine:
    """Makes shards in at most ``workers`` processes; where one dies, all are restarted, twice at most."""

    def __init__(self, workers: int) -> None:
        self._workers = workers

    def run(self, job: Job, numbers: Sequence[int], listener: Listener) -> None:
        """Make shards; see `Engine.run`. A request to stop ends the current shards."""
        left = dict.fromkeys(numbers)
        for attempt in range(1, _POOLS + 1):
            try:
                _run_pool(job, left, min(self._workers, len(left)), listener)
            except (BrokenProcessPool, ContextLostError) as error:
                why = str(error) if isinstance(error, ContextLostError) else "a worker process died"
                if attempt == _POOLS:
                    advice = "Complete shards stay on disk; where memory runs short, use fewer workers"
                    raise WorkerError(f"{why}, {_POOLS} times. {advice}") from None
                listener.on_message(f"{why}: the workers are restarted for {counted(len(left), 'shard')}")
            else:
                return


def _run_pool(job: Job, left: dict[int, None], workers: int, listener: Listener) -> None:
    """Make shards in a pool of processes; remove complete ones from ``left``. Ends early if the listener stops."""
    # A forked process would inherit an OpenGL context that it cannot use.
    context, strangers = get_context("spawn"), {*active_children()}
    executor = ProcessPoolExecutor(workers, context, _start, (job, context.Value("i", 0), threads_each(workers)))
    waiting, pending = iter([*left]), dict[Future[Recorder], int]()
    try:
        while not listener.stopping:
            with interrupts_blocked():  # the first call starts the processes
                for number in islice(waiting, _AHEAD * workers - len(pending)):
                    pending[executor.submit(_make, number)] = number
            if not pending:
                return
            done = wait(pending, _TICK_S, FIRST_COMPLETED).done
            # A lost process leaves an error in all other shards: those that are complete come first.
            for future in sorted(done, key=lambda each: each.exception() is not None):
                number = pending.pop(future)
                future.result().repeat(listener)
                del left[number]
    finally:
        executor.shutdown(wait=not pending, cancel_futures=True)
        for process in {*active_children()} - strangers if pending else ():
            process.kill()
            process.join()


# The shard maker of a worker process.
_maker: ShardMaker


def _start(job: Job, started: "Synchronized[int]", threads: int) -> None:
    """Begin a worker process; ``started`` counts them."""
    global _maker  # noqa: PLW0603 - one for the process
    # A terminal sends Ctrl-C to all processes: the first one decides about the current shards.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING_SIGNALS)
    with started.get_lock():
        number, started.value = started.value, started.value + 1
    Thread(target=_end_with_parent, daemon=True).start()
    os.environ.setdefault(THREADS, str(threads))
    keep_freed_memory()
    _maker = ShardMaker(job, number)


def _end_with_parent() -> None:
    if (parent := parent_process()) is not None:
        parent.join()
    os._exit(1)


def _make(number: int) -> Recorder:
    """Make a shard in a worker process; return what its listener heard."""
    heard = Recorder()
    _maker.make_shard(number, heard)
    return heard


def keep_freed_memory() -> None:
    """Let this process keep the memory of a pair for the next pair, if its C library is glibc.

    Otherwise glibc returns freed arrays to the kernel, which gives them out again in single zeroed pages.
    """
    set_option = getattr(ctypes.CDLL(None), "mallopt", None)
    if set_option is not None:
        for option, size in _MALLOC_OPTIONS.items():
            set_option(option, size)


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


def threads_each(workers: int) -> int:
    """Return llvmpipe's number of threads in each of so many processes, which share the usable cores.

    0 lets llvmpipe draw in the calling thread.
    """
    share = cores() // max(workers, 1)
    return 0 if share < 2 else share
