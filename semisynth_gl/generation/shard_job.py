"""Shards as tasks of an engine."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import takewhile
from math import ceil
from typing import Any, Literal

from semisynth_gl.dataset.contents import Shard
from semisynth_gl.dataset.places import Place
from semisynth_gl.dataset.plan import Plan, differences, used_plugins
from semisynth_gl.dataset.sample import LatestFiles, encode_pair
from semisynth_gl.dataset.shard import ShardBusyError, ShardWriter
from semisynth_gl.engines.task import Task
from semisynth_gl.generation.in_flight import encoded
from semisynth_gl.inputs.errors import InputError, abbreviate
from semisynth_gl.listener import FinishedPair, Listener
from semisynth_gl.pairs.pipeline import Pair, PairRenderer
from semisynth_gl.render.backends import Backend, is_software
from semisynth_gl.render.devices import egl_index_of_worker
from semisynth_gl.seeds.splits import SplitName

# Threads of each worker that encode pairs while a GPU draws the next one.
_ENCODERS = 1

ShardState = Literal["complete", "stopped", "busy"]
"""The state of a shard after its task: complete, stopped with its first pairs kept, or locked by another run."""


@dataclass(frozen=True, slots=True)
class ShardJob:
    """Makes shards, each as a task of an engine; see `semisynth_gl.engines.task.Job`.

    Attributes:
        sources: digests of patches and models, by split; workers with other photographs or models are refused.
        gpus: CUDA's numbers of the GPUs that workers take in turn; empty for the default of `egl_index_of_worker`.
    """

    plan: Plan
    place: Place
    backend: Backend
    sources: Mapping[SplitName, Mapping[str, str]]
    gpus: tuple[int, ...] = ()

    @contextmanager
    def open(self, worker: int) -> Iterator[Task[ShardState]]:
        """Yield the function that makes the shard with a number; it opens a split's renderer when a shard needs it.

        Raises:
            InputError: where the worker finds other plug-ins, photographs or models than those of the dataset.
        """
        shards = self.plan.shards
        changed = differences(self.plan.plugins, used_plugins(self.plan.config, self.plan.layout_name))
        if changed:
            raise InputError(
                f"this process finds other plug-ins than the one that began the dataset: {abbreviate(changed)}. "
                "Install the same versions on all machines"
            )
        renderer: PairRenderer | None = None
        with ExitStack() as resources:

            def renderer_of_split(listener: Listener, split: SplitName) -> PairRenderer:
                nonlocal renderer
                if renderer is None or renderer.split.name != split:
                    resources.close()
                    renderer = resources.enter_context(self.open_renderer(split, worker))
                    changes = differences(self.sources[split], renderer.sources.digests())
                    if changes:
                        raise InputError(
                            f"this process finds other photographs or models than the one that began the dataset: "
                            f"{abbreviate(changes)}. Give all machines the same files and the same versions of packages"
                        )
                    renderer.forget_pixels()
                    listener.on_renderer(renderer.renderer_name)
                return renderer

            yield lambda number, listener: self.make(shards[number], partial(renderer_of_split, listener), listener)

    def open_renderer(self, split: SplitName, worker: int = 0) -> PairRenderer:
        """Open the renderer of a split, on the device of a worker; workers are numbered from 0."""
        device_index = egl_index_of_worker(self.gpus, worker)
        return PairRenderer(self.plan.config, self.plan.split(split), self.backend, device_index)

    def make(
        self, shard: Shard, renderer_of_split: Callable[[SplitName], PairRenderer], listener: Listener
    ) -> ShardState:
        """Make a shard, or the pairs of it that an earlier run did not write.

        ``renderer_of_split`` is called only if pairs are missing. The listener hears each pair of the shard, and may
        ask to stop between two pairs.
        """
        try:
            folder = self.plan.folder(shard.split)
            writer = ShardWriter(self.place, shard, packed=self.plan.layout.packed, folder=folder)
        except ShardBusyError:
            return "busy"
        with writer:
            if writer.complete:
                return "complete"
            for entry in writer.samples:
                listener.on_pair(_finished_pair(shard.split, entry.pair, entry.values, kept=True))
            left = range(shard.first + len(writer.samples), shard.end)
            if left and not listener.stopping:
                self._add_pairs(writer, left, shard.split, renderer_of_split(shard.split), listener)
            if shard.first + len(writer.samples) < shard.end:
                return "stopped"
            writer.finish(
                {
                    "split": shard.split,
                    "first": shard.first,
                    "end": shard.end,
                    "redraws": sum(len(entry.redrawn) for entry in writer.samples),
                    "renderers": sorted({entry.renderer for entry in writer.samples}),
                    **({"plugins": self.plan.plugins} if self.plan.plugins else {}),
                },
                {"seconds": round(sum(entry.seconds for entry in writer.samples), 3)},
            )
            return "complete"

    def _add_pairs(
        self, writer: ShardWriter, indices: range, split: SplitName, renderer: PairRenderer, listener: Listener
    ) -> None:
        """Draw, encode and add pairs until the listener asks to stop."""
        drawn = (renderer.render(index) for index in takewhile(lambda _: not listener.stopping, indices))
        threads = 0 if is_software(renderer.renderer_name) else _ENCODERS
        latest: LatestFiles | None = {} if self.plan.config.views > 1 else None
        with closing(encoded(drawn, partial(self.encode, split=split, latest=latest), threads)) as pairs:
            start = time.perf_counter()
            for index, (files, facts) in zip(indices, pairs, strict=False):
                writer.add(files, facts | {"seconds": time.perf_counter() - start})
                listener.on_pair(_finished_pair(split, index, facts, kept=False))
                start = time.perf_counter()

    def encode(
        self, pair: Pair, split: SplitName, latest: LatestFiles | None = None
    ) -> tuple[dict[str, bytes], dict[str, Any]]:
        """Return a pair's files by path, and the facts for its shard's journal; see `encode_pair` on ``latest``."""
        plan, config = self.plan, self.plan.config
        key, ndisp = plan.key(split, pair.index), max(1, ceil(config.disparity.max_px))
        encoded = encode_pair(plan.layout, key, pair.frame, pair.provenance, ndisp, plan.encodings, latest)
        return encoded.files, {
            # All pairs of a sequence carry the same redraws.
            "redrawn": pair.provenance.get("redrawn", []) if pair.index % config.sequence_pairs == 0 else [],
            "share_beyond": encoded.share_beyond,
            "renderer": pair.provenance["renderer"],
        }


def _finished_pair(split: SplitName, index: int, facts: Mapping[str, Any], *, kept: bool) -> FinishedPair:
    return FinishedPair(split, index, tuple(facts["redrawn"]), facts["share_beyond"], kept)
