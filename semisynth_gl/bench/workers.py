"""Pairs per second from start to end through the engine, and each stage of a pair alone, in turns.

Everything runs in worker processes, as a dataset does, and writes the files that a dataset has.
"""

import os
import shutil
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from math import ceil
from pathlib import Path

import numpy as np

from semisynth_gl.bench.stages import Costs, StageRow, stage_rows
from semisynth_gl.config import Config
from semisynth_gl.engine import LocalWorkers, Task, cores
from semisynth_gl.pipeline import PAIR_STAGES, PairRenderer, SequenceJob, Written
from semisynth_gl.render.context import Backend
from semisynth_gl.write.dataset import DatasetFolder
from semisynth_gl.write.middlebury import SCENES, scene_name

_THREADS = "LP_NUM_THREADS"
# Tasks below 0 only say which process does them, and wait a moment for the others to get theirs.
_WHO = -1
_MOMENT_S = 0.05
# Of a number of workers, as many pairs each at least.
_PAIRS_EACH = 4
_SINGLE = "1, one thread"


@dataclass(frozen=True, slots=True)
class WorkersRow:
    """One number of workers.

    Attributes:
        name: of the row.
        workers: processes.
        threads: that llvmpipe draws with in each of them; 0 draws in the thread that calls.
        pairs: made in each round.
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
class Ends:
    """What `measure_workers` measures.

    Attributes:
        workers: a row per number, the single-threaded one first.
        stages: a row per stage.
        pair_seconds: a pair in one process with one thread, its stages following each other without a wait.
        shares: of each round, what the last of the workers reached of what the stages allow; see `limit_of`.
        facts: what the driver calls itself.
    """

    workers: list[WorkersRow]
    stages: list[StageRow]
    pair_seconds: float
    shares: list[float]
    facts: dict[str, str]


@dataclass(frozen=True, slots=True)
class _Done:
    """A task of `_WholePairs`."""

    process: int
    pairs: int
    end_s: float


@dataclass(frozen=True, slots=True)
class _WholePairs:
    """A `SequenceJob` whose tasks tell who did them and when; each worker writes to a folder of its own."""

    job: SequenceJob

    @contextmanager
    def open(self) -> Iterator[Callable[[int], _Done]]:
        folder = DatasetFolder(self.job.folder.path / str(os.getpid()), overwrite=False)
        folder.open()
        with replace(self.job, folder=folder).open() as task:
            # Buffers are made and shaders compiled with the first pair.
            task(0)
            yield partial(_whole_pairs, task)


def _whole_pairs(task: Task[list[Written]], number: int) -> _Done:
    if number == _WHO:
        time.sleep(_MOMENT_S)
        return _Done(os.getpid(), 0, 0.0)
    written = task(number)
    return _Done(os.getpid(), len(written), time.perf_counter())


@dataclass(frozen=True, slots=True)
class _Staged:
    """A task of `StagedPairs`."""

    costs: Mapping[str, Costs]
    whole_seconds: float
    facts: dict[str, str]


@dataclass(frozen=True, slots=True)
class StagedPairs:
    """Makes single pairs and times their stages; the driver finishes each before the next begins.

    Attributes:
        job: the pairs.
    """

    job: SequenceJob

    @contextmanager
    def open(self) -> Iterator[Callable[[int], _Staged]]:
        """Open a renderer."""
        self.job.folder.open()
        with PairRenderer(self.job.config, self.job.seed, self.job.backend) as renderer:
            self._write(renderer, 0, None)
            yield partial(self._staged, renderer)

    def _staged(self, renderer: PairRenderer, index: int) -> _Staged:
        start = time.perf_counter()
        self._write(renderer, index, None)
        whole = time.perf_counter() - start
        seconds, processor = dict.fromkeys(PAIR_STAGES, 0.0), dict.fromkeys(PAIR_STAGES, 0.0)
        made: dict[str, int] = {}
        last = [time.perf_counter(), time.process_time()]

        def done(stage: str) -> None:
            now = [time.perf_counter(), time.process_time()]
            seconds[stage] += now[0] - last[0]
            processor[stage] += now[1] - last[1]
            last[:] = now

        made["readback"], made["write"] = self._write(renderer, index, done)
        made["encode"] = made["write"]
        costs = {stage: Costs(seconds[stage], processor[stage], made.get(stage)) for stage in PAIR_STAGES}
        return _Staged(costs, whole, renderer.facts)

    def _write(self, renderer: PairRenderer, index: int, done: Callable[[str], None] | None) -> tuple[int, int]:
        """Make a pair; return the bytes of its arrays and of its files, which are removed."""
        pair = renderer.render(index, done)
        self.job.write(pair, done)
        folder = self.job.folder.path / SCENES / scene_name(self.job.config.name, index)
        written = sum(path.stat().st_size for path in folder.iterdir())
        shutil.rmtree(folder)
        arrays = (getattr(pair.frame, name) for name in pair.frame.__slots__)
        return sum(array.nbytes for array in arrays if isinstance(array, np.ndarray)), written


def measure_workers(
    config: Config, seed: int, backend: Backend, counts: Sequence[int], pairs: int, rounds: int
) -> Ends:
    """Measure all numbers of workers and the stages, in turns.

    Args:
        config: where the pairs are from.
        seed: likewise.
        backend: "auto", "egl" or "osmesa".
        counts: numbers of workers.
        pairs: how many each number of workers makes in each round, or four for each worker, if that is more.
        rounds: how often each takes its turn.
    """
    ways: dict[str, tuple[int, str | None]] = {_SINGLE: (1, "0")}
    ways |= {str(count): (count, None) for count in sorted(set(counts))}
    rates: dict[str, list[float]] = defaultdict(list)
    staged: list[list[_Staged]] = []
    order = ["stages", *ways]
    for number in range(rounds):
        first = number % len(order)
        for name in order[first:] + order[:first]:
            if name == "stages":
                staged.append(_stages(config, seed, backend, pairs))
            else:
                count, threads = ways[name]
                rates[name].append(_rate(config, seed, backend, count, threads, _pairs_of(count, pairs)))
    single = np.array(rates[_SINGLE])
    rows = [
        WorkersRow(
            name, count, _threads_of(count, threads), _pairs_of(count, pairs), float(np.median(rates[name])),
            float(np.median(rates[name] / single)),
        )
        for name, (count, threads) in ways.items()
    ]  # fmt: skip
    facts = staged[0][0].facts
    software = is_software(facts["renderer"])
    stages = stage_rows([one.costs for part in staged for one in part], cores(), software=software)
    by_round = [stage_rows([one.costs for one in part], cores(), software=software) for part in staged]
    most = max(ways, key=lambda name: ways[name][0])
    shares = [
        rate / min(row.allows_per_second for row in allowed)
        for rate, allowed in zip(rates[most], by_round, strict=True)
    ]  # fmt: skip
    whole = float(np.mean([one.whole_seconds for part in staged for one in part]))
    return Ends(rows, stages, whole, shares, facts)


def is_software(renderer: str) -> bool:
    """Whether a driver draws on the processor, by what it calls itself."""
    return any(name in renderer.lower() for name in ("llvmpipe", "softpipe", "swrast", "software"))


@contextmanager
def worker_threads(threads: str | None) -> Iterator[None]:
    """Let processes that are started here draw with a number of threads, or as the engine decides."""
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
    """What the engine gives each worker."""
    set_by_hand = threads or os.environ.get(_THREADS)
    if set_by_hand:
        return int(set_by_hand)
    share = cores() // count
    return 0 if share < 2 else share


def _stages(config: Config, seed: int, backend: Backend, pairs: int) -> list[_Staged]:
    with tempfile.TemporaryDirectory() as scratch:
        folder = DatasetFolder(Path(scratch) / "out", overwrite=False)
        with worker_threads("0"):
            engine = LocalWorkers(StagedPairs(SequenceJob(config, seed, backend, pairs, folder)), 1)
        with engine:
            # Pairs after the first, which has been drawn on opening: the same as the workers'.
            return list(engine.run(range(1, 1 + pairs)))


def _rate(config: Config, seed: int, backend: Backend, count: int, threads: str | None, pairs: int) -> float:
    """Pairs per second once all workers are open.

    The last pairs leave some workers without work. What a long run does not notice is left out: pairs are divided by
    the mean of the times until each worker's last pair.
    """
    length = config.sequence.length
    sequences = ceil(pairs / length)
    with tempfile.TemporaryDirectory() as scratch:
        folder = DatasetFolder(Path(scratch), overwrite=False)
        job = SequenceJob(config, seed, backend, (1 + sequences) * length, folder)
        with worker_threads(threads):
            engine = LocalWorkers(_WholePairs(job), count)
        with engine:
            ready: set[int] = set()
            while len(ready) < count:
                ready |= {done.process for done in engine.run([_WHO] * count)}
            start = time.perf_counter()
            last: dict[int, float] = {}
            made = 0
            for done in engine.run(range(1, 1 + sequences)):
                made += done.pairs
                # The clock is the machine's, not the process's.
                last[done.process] = max(last.get(done.process, 0.0), done.end_s - start)
    return made / float(np.mean(list(last.values())))
