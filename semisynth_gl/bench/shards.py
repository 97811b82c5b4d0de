"""Datasets that are made only for measurements, in worker processes as by `generate`."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Generic, NoReturn

from semisynth_gl.config import Config
from semisynth_gl.dataset.contents import Shard
from semisynth_gl.dataset.places import Folder
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.engines.local import LocalEngine
from semisynth_gl.engines.task import Job, Result, Task
from semisynth_gl.generation.shard_job import ShardJob
from semisynth_gl.inputs.errors import WorkerError
from semisynth_gl.listener import Listener
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.render.backends import Backend
from semisynth_gl.seeds.splits import SplitName

LAYOUT = "middlebury"
SPLIT: SplitName = "train"
# The default of ``generate --timeout``.
_TIMEOUT_S = 600.0


def shard_job(config: Config, seed: int, backend: Backend, pairs: int, shard_pairs: int, folder: Path) -> ShardJob:
    """Return the job that makes the shards of a dataset in a folder: ``pairs`` in all, ``shard_pairs`` in each shard.

    Do not call `ShardJob.open` on it. It lacks the digests of patches and models that `open` compares between machines,
    and a measurement runs on one machine.
    """
    plan = make_plan(config, seed, LAYOUT, {SPLIT: pairs}, shard_pairs)
    return ShardJob(plan, Folder(folder), backend, {})


def do_all(job: Job[Result], tasks: Iterable[int], workers: int) -> list[Result]:
    """Do tasks in worker processes; return their results in the order of the tasks' numbers.

    Raises:
        WorkerError: where a worker is lost, which makes the measurement worthless.
        Exception: any error of a task or of the opening of the job.
    """
    engine = LocalEngine(workers, _TIMEOUT_S)
    with closing(engine.run(job, tasks, _Undisturbed())) as results:
        by_task = dict(results)
    return [by_task[number] for number in sorted(by_task)]


def measure_pairs(
    measure: Callable[[ShardJob, PairRenderer, Shard], Result], config: Config, seed: int, backend: Backend, pairs: int
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
        return do_all(_MeasuredPairs(job, measure), range(pairs), 1)


@dataclass(frozen=True, slots=True)
class _MeasuredPairs(Generic[Result]):
    job: ShardJob
    measure: Callable[[ShardJob, PairRenderer, Shard], Result]

    @contextmanager
    def open(self, worker: int) -> Iterator[Task[Result]]:
        with self.job.open_renderer(SPLIT, worker) as renderer:
            yield lambda number, _: self.measure(self.job, renderer, self.job.plan.shards[number])


class _Undisturbed(Listener):
    """Refuses a measurement during which a message comes, since that means that something went wrong."""

    def on_message(self, text: str) -> NoReturn:
        raise WorkerError(f"nothing can be measured: {text}")
