"""Making shards: one process renders, encodes and writes the pairs of one shard after the other."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from math import ceil
from typing import Any

from semisynth_gl.dataset.documents import Plan, Shard
from semisynth_gl.dataset.plan import differences, used_plugins
from semisynth_gl.dataset.root import open_root
from semisynth_gl.dataset.sample import EncodedPair, encode_pair
from semisynth_gl.dataset.shard import write_shard
from semisynth_gl.inputs.errors import InputError, abbreviate
from semisynth_gl.listener import Listener
from semisynth_gl.pairs.pipeline import Pair, PairRenderer
from semisynth_gl.render.backends import Backend
from semisynth_gl.render.devices import egl_index_of_worker
from semisynth_gl.seeds.splits import SplitName


@dataclass(frozen=True, slots=True)
class Job:
    """What every process that makes shards of a dataset is told.

    Attributes:
        plan: the dataset's plan.
        address: the dataset's root, as `open_root` takes it.
        backend: of the renderer.
        gpus: CUDA's numbers of the GPUs that processes take in turn; empty for the default of `egl_index_of_worker`.
    """

    plan: Plan
    address: str
    backend: Backend
    gpus: tuple[int, ...] = ()


class ShardMaker:
    """Makes shards in this process; it keeps the renderer of the latest shard's split open until it is closed.

    ``worker`` is the number of the process, from 0, by which it takes its GPU.
    """

    def __init__(self, job: Job, worker: int = 0) -> None:
        self._job = job
        self._worker = worker
        self._resources = ExitStack()
        self._renderer: PairRenderer | None = None

    def close(self) -> None:
        """Close the renderer."""
        self._resources.close()

    def make_shard(self, number: int, listener: Listener) -> bool:
        """Render, encode and write the pairs of a shard of this number, then its record.

        The listener hears each pair once its files are written, and may ask to stop between two pairs. Return whether
        the shard is complete.

        Raises:
            InputError: where this process has other plug-ins, photographs or models than the plan says, or pairs keep
                failing the config's checks.
            ContextLostError: where the driver was reset; this process can render no more.
            OSError: where the disk is full or cannot be written to.
        """
        plan, shard = self._job.plan, self._job.plan.shards[number]
        renderer = self._renderer_of(shard.split, listener)

        def pairs() -> Iterator[EncodedPair]:
            for index in range(shard.first, shard.end):
                if listener.stopping:
                    return
                yield encode(plan, shard, renderer.render(index))

        return write_shard(open_root(self._job.address), plan, shard, pairs(), listener)

    def _renderer_of(self, split: SplitName, listener: Listener) -> PairRenderer:
        if self._renderer is None or self._renderer.split.name != split:
            self._renderer = None  # if opening fails below, no closed renderer stays
            self._resources.close()
            plan = self._job.plan
            _check_same("plug-ins", plan.plugins, used_plugins(plan.config, plan.layout_name))
            renderer = self._resources.enter_context(open_renderer(self._job, split, self._worker))
            _check_same("photographs or models", plan.sources[split], renderer.sources.digests())
            renderer.forget_pixels()
            listener.on_renderer(renderer.renderer_name)
            self._renderer = renderer
        return self._renderer


def _check_same(what: str, there: Mapping[str, Any], here: Mapping[str, Any]) -> None:
    """Raise InputError where this process finds something else than the process that began the dataset."""
    if changed := differences(there, here):
        raise InputError(
            f"this process finds other {what} than the one that began the dataset: {abbreviate(changed)}. Give all "
            "machines the same files and the same versions of packages"
        )


def open_renderer(job: Job, split: SplitName, worker: int = 0) -> PairRenderer:
    """Open the renderer of a split, on the device of a worker; workers are numbered from 0."""
    return PairRenderer(job.plan.config, job.plan.split(split), job.backend, egl_index_of_worker(job.gpus, worker))


def encode(plan: Plan, shard: Shard, pair: Pair) -> EncodedPair:
    """Return a pair as files."""
    ndisp = max(1, ceil(plan.config.disparity.max_px))
    key = plan.key(shard.split, pair.index)
    return encode_pair(plan.layout, key, pair.frame, pair.provenance, ndisp, plan.encodings)
