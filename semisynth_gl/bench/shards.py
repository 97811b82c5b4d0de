"""The shards of datasets that are made only for measurements."""

from pathlib import Path

from semisynth_gl.config import Config
from semisynth_gl.dataset.make import Job
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.render.backends import Backend
from semisynth_gl.seeds.splits import SplitName

LAYOUT = "middlebury"
SPLIT: SplitName = "train"


def shard_job(config: Config, seed: int, backend: Backend, pairs: int, shard_pairs: int, folder: Path) -> Job:
    """Return the job that makes the shards of a dataset in a folder: ``pairs`` in all, ``shard_pairs`` in each shard.

    Its plan lacks the digests of patches and models, which `ShardMaker` compares between machines.
    """
    return Job(make_plan(config, seed, LAYOUT, {SPLIT: pairs}, shard_pairs), str(folder), backend)
