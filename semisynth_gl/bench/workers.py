"""Pairs per second from start to end through the engine, and each stage of a pair alone, in turns.

Everything runs in worker processes, as a dataset does, and writes the files that a dataset has.
"""

import os
import shutil
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import ceil
from multiprocessing import get_context
from multiprocessing.synchronize import Barrier
from pathlib import Path

import numpy as np

from semisynth_gl.bench.shards import SPLIT, do_all, shard_job
from semisynth_gl.bench.stages import Costs, StageRow, stage_rows
from semisynth_gl.config import Config
from semisynth_gl.dataset.places import Folder
from semisynth_gl.dataset.plan import Shard
from semisynth_gl.dataset.shard import ShardWriter
from semisynth_gl.engines.task import Task, cores, threads_each
from semisynth_gl.generation.shard_job import ShardJob
from semisynth_gl.listener import Listener
from semisynth_gl.pairs.pipeline import PAIR_STAGES, PairRenderer
from semisynth_gl.render.context import Backend

_THREADS = "LP_NUM_THREADS"
# Least number of pairs of each worker in a round.
_PAIRS_EACH = 4
_SINGLE = "1, one thread"


@dataclass(frozen=True, slots=True)
class WorkersRow:
    """Measurements of one number of workers.

    Attributes:
        name: the row's name.
        workers: number of processes.
        threads: number of threads that llvmpipe draws with in each process; with 0 it draws in the thread that calls.
        pairs: number of pairs in each round.
        pairs_per_second: median over the rounds, files written.
        ratio: median over the rounds of its pairs per second divided by those of one worker with one thread.
    """

    name: str
    workers: int
    threads: int
    pairs: int
    pairs_per_second: float
    ratio: float


@dataclass(frozen=True, slots=True)
class Throughput:
    """Measurements of workers and stages.

    Attributes:
        workers: a row of each number of workers, the single-threaded worker first.
        stages: a row of each stage.
        pair_seconds: time of a pair in one process with one thread, its stages following each other without a wait.
        shares: of each round, the part of the stages' limit that most workers reached; see `limit_of`.
        facts: backend, renderer and version of OpenGL.
    """

    workers: list[WorkersRow]
    stages: list[StageRow]
    pair_seconds: float
    shares: list[float]
    facts: dict[str, str]


@dataclass(frozen=True, slots=True)
class _Done:
    """A task of `_WholePairs`; its clock is the machine's, not the process's."""

    worker: int
    pairs: int
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class _WholePairs:
    """Makes shards and tells who did it and when, once all workers are open; each writes to a folder of its own."""

    job: ShardJob
    opened: Barrier

    @contextmanager
    def open(self, worker: int) -> Iterator[Task[_Done]]:
        job = replace(self.job, place=Folder(self.job.place.path(str(worker))))
        plan = job.plan
        shards = plan.shards
        with PairRenderer(plan.config, plan.seed, job.backend, plan.split(SPLIT)) as renderer:
            # Buffers are made and shaders compiled with the first pair.
            job.make(shards[0], lambda _: renderer, Listener())
            self.opened.wait()
            start = time.perf_counter()

            def make(number: int, listener: Listener) -> _Done:
                shard = shards[number]
                job.make(shard, lambda _: renderer, listener)
                return _Done(worker, shard.end - shard.first, start, time.perf_counter())

            yield make


class _StageClock(Listener):
    """Adds up the time of each stage of a pair, on the clock and of the processor, s."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(PAIR_STAGES, 0.0)
        self.cpu_seconds = dict.fromkeys(PAIR_STAGES, 0.0)
        self._last = time.perf_counter(), time.process_time()

    def on_stage(self, stage: str) -> None:
        last, self._last = self._last, (time.perf_counter(), time.process_time())
        self.seconds[stage] += self._last[0] - last[0]
        self.cpu_seconds[stage] += self._last[1] - last[1]


@dataclass(frozen=True, slots=True)
class _Staged:
    """A task of `StagedPairs`."""

    costs: Mapping[str, Costs]
    pair_seconds: float
    facts: dict[str, str]


@dataclass(frozen=True, slots=True)
class StagedPairs:
    """Makes single pairs and times their stages; the driver finishes each before the next begins.

    Attributes:
        job: the pairs, each a shard.
    """

    job: ShardJob

    @contextmanager
    def open(self, worker: int) -> Iterator[Task[_Staged]]:
        """Open a renderer."""
        del worker
        plan = self.job.plan
        shards = plan.shards
        with PairRenderer(plan.config, plan.seed, self.job.backend, plan.split(SPLIT)) as renderer:
            self._write(renderer, shards[0], Listener())
            yield lambda number, _: self._staged(renderer, shards[number])

    def _staged(self, renderer: PairRenderer, shard: Shard) -> _Staged:
        start = time.perf_counter()
        self._write(renderer, shard, Listener())
        whole = time.perf_counter() - start
        made: dict[str, int] = {}
        renderer.listener = clock = _StageClock()
        made["readback"], made["write"] = self._write(renderer, shard, clock)
        renderer.listener = None
        made["encode"] = made["write"]
        costs = {stage: Costs(clock.seconds[stage], clock.cpu_seconds[stage], made.get(stage)) for stage in PAIR_STAGES}
        return _Staged(costs, whole, renderer.facts)

    def _write(self, renderer: PairRenderer, shard: Shard, listener: Listener) -> tuple[int, int]:
        """Make a pair as `ShardJob.make` does; return the bytes of its arrays and of its files, which are removed."""
        plan, place = self.job.plan, self.job.place
        pair = renderer.render(shard.first)
        with ShardWriter(place, shard, packed=plan.layout.packed, folder=plan.folder(SPLIT)) as writer:
            listener.on_stage("write")
            files, facts = self.job.encode(pair, SPLIT)
            listener.on_stage("encode")
            writer.add(files, facts)
            record = writer.finish({"split": SPLIT, "first": shard.first, "end": shard.end})
        # Beginning and end of a shard are part of writing, and take the less the more pairs it has.
        listener.on_stage("write")
        shutil.rmtree(place.path(""))
        return sum(array.nbytes for array in pair.frame.arrays().values()), record["bytes"]


def measure_workers(
    config: Config, seed: int, backend: Backend, counts: Sequence[int], pairs: int, rounds: int
) -> Throughput:
    """Measure all numbers of workers and the stages, in turns.

    Args:
        config: where the pairs are from.
        seed: of the pairs.
        backend: "auto", "egl" or "osmesa".
        counts: numbers of workers.
        pairs: pairs of each number of workers in each round, or four of each worker, if that is more.
        rounds: how often each number takes its turn.
    """
    settings: dict[str, tuple[int, str | None]] = {_SINGLE: (1, "0")}
    settings |= {str(count): (count, None) for count in sorted(set(counts))}
    rates: dict[str, list[float]] = defaultdict(list)
    staged: list[list[_Staged]] = []
    order = ["stages", *settings]
    for number in range(rounds):
        first = number % len(order)
        for name in order[first:] + order[:first]:
            if name == "stages":
                staged.append(_stages(config, seed, backend, pairs))
            else:
                count, threads = settings[name]
                rates[name].append(_rate(config, seed, backend, count, threads, _pairs_of(count, pairs)))
    single = np.array(rates[_SINGLE])
    rows = [
        WorkersRow(
            name, count, _threads_of(count, threads), _pairs_of(count, pairs), float(np.median(rates[name])),
            float(np.median(rates[name] / single)),
        )
        for name, (count, threads) in settings.items()
    ]  # fmt: skip
    facts = staged[0][0].facts
    software = is_software(facts["renderer"])
    stages = stage_rows([pair.costs for part in staged for pair in part], cores(), software=software)
    by_round = [stage_rows([pair.costs for pair in part], cores(), software=software) for part in staged]
    most = max(settings, key=lambda name: settings[name][0])
    shares = [
        rate / min(row.allows_per_second for row in allowed)
        for rate, allowed in zip(rates[most], by_round, strict=True)
    ]  # fmt: skip
    pair_seconds = float(np.mean([pair.pair_seconds for part in staged for pair in part]))
    return Throughput(rows, stages, pair_seconds, shares, facts)


def is_software(renderer: str) -> bool:
    """Tell by a driver's name whether it draws on the processor."""
    return any(name in renderer.lower() for name in ("llvmpipe", "softpipe", "swrast", "software"))


@contextmanager
def worker_threads(threads: str | None) -> Iterator[None]:
    """Let processes that are started inside draw with a number of threads; None leaves that to the engine."""
    before = os.environ.get(_THREADS)
    if threads is not None:
        os.environ[_THREADS] = threads
    try:
        yield
    finally:
        if threads is not None:
            os.environ.pop(_THREADS)
            if before is not None:
                os.environ[_THREADS] = before


def _pairs_of(count: int, pairs: int) -> int:
    return max(pairs, _PAIRS_EACH * count)


def _threads_of(count: int, threads: str | None) -> int:
    """Return the number of threads that the engine gives each worker."""
    set_by_hand = threads or os.environ.get(_THREADS)
    if set_by_hand:
        return int(set_by_hand)
    return threads_each(count)


def _stages(config: Config, seed: int, backend: Backend, pairs: int) -> list[_Staged]:
    with tempfile.TemporaryDirectory() as scratch, worker_threads("0"):
        job = shard_job(config, seed, backend, 1 + pairs, 1, Path(scratch) / "out")
        # Pairs after the first, which has been drawn on opening: the same as the workers'.
        return do_all(StagedPairs(job), range(1, 1 + pairs), 1)


def _rate(config: Config, seed: int, backend: Backend, count: int, threads: str | None, pairs: int) -> float:
    """Measure pairs per second once all workers are open.

    The last pairs leave some workers without work, which a long run does not notice. So the number of pairs is divided
    by the mean of the times until each worker's last pair.
    """
    length = config.sequence.length
    # At least a sequence for each worker: an engine starts no more workers than there are tasks.
    sequences = max(count, ceil(pairs / length))
    with tempfile.TemporaryDirectory() as scratch, worker_threads(threads):
        job = shard_job(config, seed, backend, (1 + sequences) * length, length, Path(scratch))
        # Workers are spawned, and a barrier goes to processes of its own kind alone.
        opened = get_context("spawn").Barrier(count)
        shards = do_all(_WholePairs(job, opened), range(1, 1 + sequences), count)
    start = min(shard.start_s for shard in shards)
    last: dict[int, float] = {}
    for shard in shards:
        last[shard.worker] = max(last.get(shard.worker, 0.0), shard.end_s - start)
    return sum(shard.pairs for shard in shards) / float(np.mean(list(last.values())))
