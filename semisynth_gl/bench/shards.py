"""Datasets that are made only for measurements, in worker processes as by `generate`."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

from semisynth_gl.config import Config
from semisynth_gl.dataset.documents import Shard
from semisynth_gl.dataset.engines import THREADS, keep_freed_memory, threads_each
from semisynth_gl.dataset.make import Job, open_renderer
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.render.backends import Backend
from semisynth_gl.seeds.splits import SplitName

LAYOUT = "middlebury"
SPLIT: SplitName = "train"

Argument = TypeVar("Argument")
Result = TypeVar("Result")


def shard_job(config: Config, seed: int, backend: Backend, pairs: int, shard_pairs: int, folder: Path) -> Job:
    """Return the job that makes the shards of a dataset in a folder: ``pairs`` in all, ``shard_pairs`` in each shard.

    Its plan lacks the digests of patches and models, which `ShardMaker` compares between machines.
    """
    return Job(make_plan(config, seed, LAYOUT, {SPLIT: pairs}, shard_pairs), str(folder), backend)


def in_processes(
    function: Callable[[Argument], Result], arguments: Sequence[Argument], begin: Callable[[], object] | None = None
) -> list[Result]:
    """Call a function with each argument, all at once in processes as `LocalEngine` has them; return the results.

    All must be picklable. ``begin`` is called first in each process, which inherits what it holds.

    Raises:
        BrokenProcessPool: where a process dies, which makes the measurement worthless.
        Exception: any error of the function.
    """
    count = len(arguments)
    with ProcessPoolExecutor(count, get_context("spawn"), _begin, (threads_each(count), begin)) as pool:
        return list(pool.map(function, arguments))


def _begin(threads: int, begin: Callable[[], object] | None) -> None:
    os.environ.setdefault(THREADS, str(threads))
    keep_freed_memory()
    if begin is not None:
        begin()


def measure_pairs(
    measure: Callable[[Job, PairRenderer, Shard], Result], config: Config, seed: int, backend: Backend, pairs: int
) -> list[Result]:
    """Measure a config's first pairs, one after the other in one worker process with an open renderer.

    Args:
        measure: makes the pair of a shard in the job's folder, removes the folder and returns the measurement; the
            function and its result must be picklable.
        config: the config.
        seed: the dataset's seed.
        backend: as of `Renderer`.
        pairs: number of pairs.

    Returns:
        The result of ``measure`` for each pair, in order.
    """
    with TemporaryDirectory() as scratch:
        job = shard_job(config, seed, backend, pairs, 1, Path(scratch) / "out")
        return in_processes(partial(_measure_pairs, measure), [job])[0]


def _measure_pairs(measure: Callable[[Job, PairRenderer, Shard], Result], job: Job) -> list[Result]:
    with open_renderer(job, SPLIT) as renderer:
        return [measure(job, renderer, shard) for shard in job.plan.shards]
