"""Datasets that are made to be measured, in worker processes as `generate` makes them."""

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
# As `generate` has it.
_TIMEOUT_S = 600.0


def shard_job(config: Config, seed: int, backend: Backend, pairs: int, shard_pairs: int, folder: Path) -> ShardJob:
    """Return what makes the shards of a dataset in a folder.

    It is not for `ShardJob.open`, since it does not know the digests of patches and models: all that takes part in a
    measurement is on one machine.
    """
    plan = make_plan(config, seed, LAYOUT, {SPLIT: pairs}, shard_pairs)
    return ShardJob(plan, Folder(folder), backend, {})


def do_all(job: Job[Result], tasks: Iterable[int], workers: int) -> list[Result]:
    """Do tasks in worker processes; return their results in the order of the tasks' numbers.

    Raises:
        WorkerError: where a worker is lost, since what was measured then holds no longer.
        Exception: what a task or the opening of the job raises.
    """
    engine = LocalEngine(workers, _TIMEOUT_S)
    with closing(engine.run(job, tasks, _Undisturbed())) as results:
        by_task = dict(results)
    return [by_task[number] for number in sorted(by_task)]


def measure_pairs(
    measure: Callable[[ShardJob, PairRenderer, Shard], Result], config: Config, seed: int, backend: Backend, pairs: int
) -> list[Result]:
    """Measure a config's first pairs, one after the other in one worker process with an open renderer.

    The function, which is pickled, makes the pair of a shard in the job's folder, and removes the folder.
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
    """Refuses a measurement in which something is worth a message."""

    def on_message(self, text: str) -> NoReturn:
        raise WorkerError(f"nothing can be measured: {text}")
