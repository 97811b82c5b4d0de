"""Pairs per second of the engine with several numbers of workers, and the time of each stage of a pair.

Everything runs in worker processes and writes files, as the making of a dataset does.
"""

import os
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from math import ceil
from multiprocessing import get_context
from multiprocessing.synchronize import Barrier
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from semisynth_gl.bench.shards import SPLIT, in_processes, measure_pairs, shard_job
from semisynth_gl.bench.stages import PairTimes, pass_rows, speed_limit, stage_rows, time_pair
from semisynth_gl.config import Config
from semisynth_gl.dataset.engines import THREADS, cores, threads_each
from semisynth_gl.dataset.make import Job, open_renderer, write_pairs
from semisynth_gl.listener import Listener
from semisynth_gl.render.backends import Backend, is_software

# Smallest number of pairs for each worker in a round.
_PAIRS_EACH = 4
_SINGLE = "1, one thread"


def turns(names: Sequence[str], rounds: int) -> Iterator[tuple[int, str]]:
    """Yield (round, name) for all names in each round; each round begins one name later than the round before."""
    for number in range(rounds):
        for k in range(len(names)):
            yield number, names[(number + k) % len(names)]


class _Share(NamedTuple):
    """The shards that one worker makes in a round, in its own folder."""

    job: Job
    worker: int
    workers: int


class _ShareTimes(NamedTuple):
    """The times of a worker, s, which are comparable between processes; ``start`` is when all workers were open."""

    pairs: int
    start_s: float
    end_s: float


# Passed by all workers of a round once they are open.
_opened: Barrier


def _set_barrier(opened: Barrier) -> None:
    global _opened  # noqa: PLW0603 - a barrier is inherited, and never pickled
    _opened = opened


def _make_share(share: _Share) -> _ShareTimes:
    """Make every shard of a worker's share."""
    job = replace(share.job, address=str(Path(share.job.address, str(share.worker))))
    untimed, *timed = job.plan.shards
    shards = timed[share.worker :: share.workers]
    with open_renderer(job, SPLIT) as renderer:
        # An untimed sequence first, since the first pair makes the buffers and compiles the shaders.
        write_pairs(job, untimed, renderer, Listener())
        _opened.wait()
        start = time.perf_counter()
        for shard in shards:
            write_pairs(job, shard, renderer, Listener())
        return _ShareTimes(sum(shard.end - shard.first for shard in shards), start, time.perf_counter())


def measure_workers(
    config: Config, seed: int, backend: Backend, counts: Sequence[int], pairs: int, rounds: int
) -> tuple[dict[str, Any], dict[str, str]]:
    """Measure the stages of a pair, and the pairs per second of each number of workers, in turns.

    In each round, ``counts`` workers make ``pairs`` pairs, or four for each worker if that is more.

    Returns:
        Four sections of the report, and `Renderer.facts`. The sections are

        - "stages": in "rows" the `stage_rows` of pairs in one process with one thread,
        - "passes": in "rows" the `pass_rows` of the same pairs, and in "queries" whether timer queries timed them,
        - "limit": the `speed_limit` of the largest number of "workers",
        - "workers": in "rows" a row for one single-threaded worker, and then one for each number of workers. "threads"
          are those of llvmpipe in each worker, 0 if it draws in the calling thread; "pairs_per_second" includes writing
          the files, and "ratio" is relative to the first row; both are medians over the rounds.
    """
    settings: dict[str, tuple[int, str | None]] = {_SINGLE: (1, "0")}
    settings |= {str(count): (count, None) for count in sorted(set(counts))}
    pair_counts = {name: max(pairs, _PAIRS_EACH * count) for name, (count, _) in settings.items()}
    rates: dict[str, list[float]] = defaultdict(list)
    times_by_round: list[list[PairTimes]] = []
    for _, name in turns(["stages", *settings], rounds):
        if name == "stages":
            # The first pair is left out, since it compiles the shaders; the others are also the workers' pairs.
            with worker_threads("0"):
                times_by_round.append(measure_pairs(time_pair, config, seed, backend, 1 + pairs)[1:])
        else:
            rates[name].append(_rate(config, seed, backend, *settings[name], pair_counts[name]))
    rows: list[dict[str, Any]] = [
        {
            "name": name,
            "workers": count,
            # As the engine sets it for each worker.
            "threads": int(threads or os.environ.get(THREADS) or threads_each(count)),
            "pairs": pair_counts[name],
            "pairs_per_second": float(np.median(rates[name])),
            "ratio": float(np.median(np.divide(rates[name], rates[_SINGLE]))),
        }
        for name, (count, threads) in settings.items()
    ]
    times = [pair for by_pair in times_by_round for pair in by_pair]
    facts = times[0].facts
    rows_of = partial(stage_rows, cores=cores(), software=is_software(facts["renderer"]))
    stages = rows_of([pair.costs for pair in times])
    limits = [
        min(row["allows_per_second"] for row in rows_of([pair.costs for pair in by_pair])) for by_pair in times_by_round
    ]
    most = max(rows, key=lambda row: row["workers"])
    shares = np.divide(rates[most["name"]], limits).tolist()
    sections = {
        "stages": {"rows": stages},
        "passes": {"queries": times[0].queries, "rows": pass_rows([pair.passes for pair in times])},
        "limit": {"workers": most["workers"]} | speed_limit(stages, cores(), most["pairs_per_second"], shares),
        "workers": {"rows": rows},
    }
    return sections, facts


@contextmanager
def worker_threads(threads: str | None) -> Iterator[None]:
    """Let llvmpipe in processes that start in the block have a number of threads; None leaves it to the engine."""
    before = os.environ.get(THREADS)
    if threads is not None:
        os.environ[THREADS] = threads
    try:
        yield
    finally:
        os.environ.pop(THREADS, None)
        if before is not None:
            os.environ[THREADS] = before


def _rate(config: Config, seed: int, backend: Backend, count: int, threads: str | None, pairs: int) -> float:
    """Return the pairs per second of ``count`` workers, counted from when all are open.

    At the end, some workers have no work while others make the last pairs. This does not matter in a long run, so the
    number of pairs is divided by the mean of the times until each worker's last pair.
    """
    length = config.sequence_pairs
    # At least a sequence for each worker.
    sequences = max(count, ceil(pairs / length))
    with tempfile.TemporaryDirectory() as scratch, worker_threads(threads):
        job = shard_job(config, seed, backend, (1 + sequences) * length, length, Path(scratch))
        # Workers are spawned, so the barrier must come from the same multiprocessing context.
        begin = partial(_set_barrier, get_context("spawn").Barrier(count))
        times = in_processes(_make_share, [_Share(job, worker, count) for worker in range(count)], begin)
    return sum(share.pairs for share in times) / float(np.mean([share.end_s - share.start_s for share in times]))
