"""The engines of this machine: each makes shards, in this process or in worker processes."""

import ctypes
import os
import pickle
import signal
from collections.abc import Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from ctypes import Array, c_bool, c_longlong
from dataclasses import dataclass
from itertools import islice
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.sharedctypes import Synchronized
from threading import Thread
from typing import Any, Protocol, runtime_checkable

from semisynth_gl.dataset.interrupts import ENDING_SIGNALS, interrupts_blocked
from semisynth_gl.dataset.make import Job, ShardMaker
from semisynth_gl.inputs.errors import ContextLostError, WorkerError, counted, described
from semisynth_gl.listener import FinishedPair, Listener
from semisynth_gl.seeds.splits import SplitName

THREADS = "LP_NUM_THREADS"
"""Environment variable with the number of threads that llvmpipe may have; see `threads_each`."""

# Largest number of pools of a run; a pool that lost a worker is replaced.
_POOLS = 3
# Shards that wait for each worker, so that none is idle.
_AHEAD = 2
# How soon a request to stop reaches the workers.
_TICK_S = 0.1
# M_TRIM_THRESHOLD, -1: most free bytes that stay at the heap's end. M_MMAP_THRESHOLD, -3: arrays larger than this are
# not part of the heap; 32 MiB is the most that all versions of glibc accept.
_MALLOC_OPTIONS = {-1: 256 << 20, -3: 32 << 20}
_NO_SHARD = -1
_AT_ITS_START = "its start (a script needs the line `if __name__ == '__main__':`)"
_SHARD_BITS = 32

_Made = tuple[bool, list[tuple[str, Any]]]


@runtime_checkable
class Engine(Protocol):
    """Makes the shards of a job."""

    def run(self, job: Job, numbers: Sequence[int], listener: Listener) -> None:
        """Make shards; return once all are complete, or soon after `Listener.stopping` is true.

        Args:
            job: the dataset.
            numbers: the shards' numbers in the plan.
            listener: hears the pairs of finished shards, and messages about lost workers.

        Raises:
            WorkerError: where workers keep dying.
            Exception: the error of a shard, as `ShardMaker.make_shard` raises it.
        """


class SerialEngine:
    """Makes one shard after the other in this process."""

    def run(self, job: Job, numbers: Sequence[int], listener: Listener) -> None:
        """Make shards; see `Engine.run`."""
        with closing(ShardMaker(job)) as maker:
            for number in numbers:
                if listener.stopping or not maker.make_shard(number, listener):
                    return


class Recorder(Listener):
    """The listener of a worker process: it keeps the calls for the listener of the process that started the worker."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, Any]] = []

    def on_renderer(self, name: str) -> None:
        """Keep the call."""
        self.calls.append(("on_renderer", name))

    def on_pair(self, pair: FinishedPair) -> None:
        """Keep the call."""
        self.calls.append(("on_pair", pair))


def repeat(calls: Sequence[tuple[str, Any]], listener: Listener) -> None:
    """Make the calls that a `Recorder` has kept."""
    for method, argument in calls:
        getattr(listener, method)(argument)


class LocalEngine:
    """Makes shards in at most ``workers`` processes of this machine.

    Where a process dies, all are started anew for the shards that are missing, twice at most.
    """

    def __init__(self, workers: int) -> None:
        self._workers = workers

    def run(self, job: Job, numbers: Sequence[int], listener: Listener) -> None:
        """Make shards; see `Engine.run`."""
        left = dict.fromkeys(numbers)
        for attempt in range(1, _POOLS + 1):
            pool = _Pool(job, min(self._workers, len(left)))
            try:
                with closing(pool.complete_shards(list(left), listener)) as complete:
                    for number in complete:
                        del left[number]
            except (BrokenProcessPool, ContextLostError) as error:
                if listener.stopping:
                    return
                lost = isinstance(error, ContextLostError)
                why = str(error) if lost else f"a worker process died at {pool.in_hand()}"
                if attempt == _POOLS:
                    advice = "Complete shards stay on disk; where memory runs short, use fewer workers"
                    raise WorkerError(f"{why}, the {_POOLS}rd time. {advice}") from None
                listener.on_message(f"{why}: the workers are started anew for {counted(len(left), 'shard')}")
            else:
                return


@dataclass(frozen=True, slots=True)
class _Shared:
    """Memory that a pool's processes share with the process that started them.

    Attributes:
        stopping: whether the workers should stop after the pair in hand.
        started: number of workers so far, by which each takes its own number.
        in_hand: shard and pair that each worker is at, see `_Pool.in_hand`; a worker that ends itself leaves
            `_NO_SHARD`.
    """

    stopping: c_bool
    started: "Synchronized[int]"
    in_hand: "Array[c_longlong]"


class _Pool:
    """A pool of worker processes, used once."""

    def __init__(self, job: Job, workers: int) -> None:
        # A forked process would inherit an OpenGL context that it cannot use.
        context = get_context("spawn")
        self._job = job
        self._workers = workers
        in_hand = context.RawArray(c_longlong, [_NO_SHARD] * workers)
        self._shared = _Shared(context.RawValue(c_bool), context.Value("i", 0), in_hand)
        arguments = (job, self._shared, threads_each(workers))
        self._executor = ProcessPoolExecutor(workers, context, _start, arguments)
        self._strangers = {*active_children()}

    def complete_shards(self, numbers: Sequence[int], listener: Listener) -> Generator[int, None, None]:
        """Yield the number of each complete shard, in any order; raises BrokenProcessPool where a process dies."""
        waiting = iter(numbers)
        pending: dict[Future[_Made], int] = {}
        try:
            while True:
                if listener.stopping:
                    self._shared.stopping.value = True
                else:
                    with interrupts_blocked():  # the first call starts the processes
                        for number in islice(waiting, _AHEAD * self._workers - len(pending)):
                            pending[self._executor.submit(_make, number)] = number
                if not pending:
                    return
                done = wait(pending, _TICK_S, FIRST_COMPLETED).done
                # A lost process leaves an error in all other shards: those that are complete come first.
                for future in sorted(done, key=lambda each: each.exception() is not None):
                    number = pending.pop(future)
                    complete, calls = future.result()
                    repeat(calls, listener)
                    if complete:
                        yield number
        except BrokenProcessPool:
            self._executor.shutdown()  # waits until the processes have said that they were ended
            raise
        finally:
            self._executor.shutdown(wait=not pending, cancel_futures=True)
            for process in {*active_children()} - self._strangers if pending else ():
                process.kill()
                process.join()

    def in_hand(self) -> str:
        """Return the pairs that lost processes were at, in words."""
        shards = self._job.plan.shards
        at = [divmod(value, 1 << _SHARD_BITS) for value in self._shared.in_hand if value != _NO_SHARD]
        return " or ".join(f"pair {index} of {shards[number].split}" for number, index in at) or _AT_ITS_START


class _WorkerListener(Recorder):
    """Notes in shared memory which pair the worker is at."""

    def __init__(self, shared: _Shared, worker: int, shard: int) -> None:
        super().__init__()
        self._shared = shared
        self._worker = worker
        self._shard = shard

    @property
    def stopping(self) -> bool:
        return bool(self._shared.stopping.value)

    def on_render(self, split: SplitName, index: int) -> None:  # noqa: ARG002 - the shard says the split
        self._shared.in_hand[self._worker] = (self._shard << _SHARD_BITS) + index


# The state of a worker process: what it was started with, its number, and what makes shards once it is needed.
_started: tuple[Job, _Shared, int]
_makers: list[ShardMaker] = []


def _start(job: Job, shared: _Shared, threads: int) -> None:
    """Begin a worker process."""
    global _started  # noqa: PLW0603 - one for the process
    with shared.started.get_lock():
        number = shared.started.value
        shared.started.value += 1
    _started = job, shared, number

    def end(*_: object) -> None:
        shared.in_hand[number] = _NO_SHARD
        os._exit(1)

    def end_with_parent() -> None:
        if (parent := parent_process()) is not None:
            parent.join()
        os._exit(1)

    # A terminal sends Ctrl-C to all processes: the first one decides about the pairs in hand. The executor ends the
    # other workers with SIGTERM when one has died.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, end)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING_SIGNALS)
    Thread(target=end_with_parent, daemon=True).start()
    os.environ.setdefault(THREADS, str(threads))
    keep_freed_memory()


def _make(shard: int) -> _Made:
    """Make a shard in a worker process; return whether it is complete, and the calls of its listener."""
    job, shared, worker = _started
    listener = _WorkerListener(shared, worker, shard)
    try:
        if listener.stopping:
            return False, []
        if not _makers:
            _makers.append(ShardMaker(job, worker))
        return _makers[0].make_shard(shard, listener), listener.calls
    except Exception as error:  # noqa: BLE001 - raised again in the process that waits for it
        raise portable(error) from None
    finally:
        shared.in_hand[worker] = _NO_SHARD


def portable(error: Exception) -> Exception:
    """Return an error that survives pickling: itself, or a `WorkerError` with its text."""
    try:
        kept = type(pickle.loads(pickle.dumps(error))) is type(error)  # noqa: S301 - its own bytes
    except Exception:  # noqa: BLE001 - an error's own methods take part in it
        kept = False
    return error if kept else WorkerError(f"a worker process met {described(error)}")


def keep_freed_memory() -> None:
    """Let this process keep the memory of a pair for the next pair.

    Otherwise glibc returns the memory of freed arrays to the kernel, which gives it out again in single zeroed pages,
    with thousands of page faults for each pair. With another C library than glibc, nothing is done.
    """
    set_option = getattr(ctypes.CDLL(None), "mallopt", None)
    if set_option is not None:
        for option, size in _MALLOC_OPTIONS.items():
            set_option(option, size)


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


def threads_each(workers: int) -> int:
    """Return the number of threads that llvmpipe may have (`THREADS`) in each of ``workers`` processes.

    The processes share the usable cores. 0 lets llvmpipe draw in the calling thread.
    """
    share = cores() // max(workers, 1)
    return 0 if share < 2 else share
