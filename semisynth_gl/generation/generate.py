"""Making a dataset: shards as tasks of an engine, and an index once all are there.

plan     `Plan`: which pairs, in which shards, under which names
  -> shard    `ShardJob`: what an engine runs, a pure function of the shard's number but for the disk
  -> dataset  `generate`: those that are missing, then lists, card and index
"""

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from math import ceil
from typing import Any, Literal, Self

from semisynth_gl.config import Config
from semisynth_gl.dataset.card import encode_card
from semisynth_gl.dataset.croissant import encode_croissant
from semisynth_gl.dataset.files import DatasetFiles, complete_record, read_beginning
from semisynth_gl.dataset.index import describe_dataset
from semisynth_gl.dataset.places import Place, open_place
from semisynth_gl.dataset.plan import Plan, Shard, abbreviate, differences, make_plan
from semisynth_gl.dataset.sample import encode_pair, share_beyond
from semisynth_gl.dataset.schema import CARD, CROISSANT
from semisynth_gl.dataset.shard import ShardBusyError, ShardWriter
from semisynth_gl.engines.serial import SerialEngine
from semisynth_gl.engines.task import Engine, Stop, Task, Watch
from semisynth_gl.errors import InputError
from semisynth_gl.pairs.pipeline import Pair, PairRenderer
from semisynth_gl.render.context import Backend
from semisynth_gl.render.devices import egl_index_of_worker
from semisynth_gl.scene.sources import Sources, prepare_sources
from semisynth_gl.splits import SplitName

_SECONDS_BETWEEN_LOOKS = 1.0
# From so many on, a file system is slower with files than with tars of them.
_MANY_PAIRS = 10_000


@dataclass(frozen=True, slots=True)
class Written:
    """A pair that is on disk.

    Attributes:
        split: its split.
        index: its number there.
        redrawn: what was wrong with the attempts before it; of a sequence, told of its first frame alone.
        share_beyond: share of the pixels whose disparity the encoding cannot say, of the view that has more.
        kept: whether an earlier run had made it.
    """

    split: SplitName
    index: int
    redrawn: tuple[str, ...]
    share_beyond: float = 0.0
    kept: bool = False


@dataclass(frozen=True, slots=True)
class Opened:
    """A worker has opened its renderer.

    Attributes:
        renderer: what the driver calls itself.
    """

    renderer: str


@dataclass(frozen=True, slots=True)
class Made:
    """What became of a shard.

    Attributes:
        state: ``whole``; ``stopped``, with its first pairs kept; or ``busy``, in the hands of another run.
    """

    state: Literal["whole", "stopped", "busy"]


@dataclass(frozen=True, slots=True)
class ShardJob:
    """Makes shards; what an engine runs.

    Attributes:
        plan: the dataset's.
        place: where to.
        backend: "auto", "egl" or "osmesa".
        sources: digests of patches and models, by split; a machine that finds other photographs must not take part.
        gpus: CUDA's numbers of the GPUs that workers take turns on; none for the first device of EGL.
    """

    plan: Plan
    place: Place
    backend: Backend
    sources: Mapping[SplitName, Mapping[str, str]]
    gpus: tuple[int, ...] = ()

    @contextmanager
    def open(self, worker: int) -> Iterator[Task[Made]]:
        """Open what shards need: a renderer, once the first shard says of which split."""
        with _Renderers(self, self.device_index(worker)) as renderers:
            shards = self.plan.shards
            yield lambda number, watch: self.make(renderers.of, shards[number], watch)

    def device_index(self, worker: int) -> int:
        """Return EGL's number of a worker's device."""
        return egl_index_of_worker(self.gpus, worker)

    def make(self, renderer_of: Callable[[SplitName, Watch], PairRenderer], shard: Shard, watch: Watch) -> Made:
        """Make a shard, or what an earlier run left of it to make."""
        folder, packed = self.plan.folder(shard.split), self.plan.layout.packed
        try:
            writer = ShardWriter(self.place, shard, packed=packed, folder=folder)
        except ShardBusyError:
            return Made("busy")
        with writer:
            # Another run may have ended it while this one was about to begin.
            if complete_record(self.place, shard) is not None:
                return Made("whole")
            for entry in writer.samples:
                watch.tell(
                    Written(shard.split, entry["pair"], tuple(entry["redrawn"]), entry["share_beyond"], kept=True)
                )
            for index in range(shard.first + len(writer.samples), shard.end):
                if watch.stopping:
                    return Made("stopped")
                start = time.perf_counter()
                watch.tell(self.write(renderer_of(shard.split, watch).render(index), writer, start))
            writer.finish(_facts(shard, writer.samples))
            return Made("whole")

    def write(
        self, pair: Pair, writer: ShardWriter, start: float, done: Callable[[str], None] = lambda _: None
    ) -> Written:
        """Encode a pair and add it to its shard.

        Args:
            pair: the writer's next one.
            writer: its shard's.
            start: when it was begun, by `time.perf_counter`.
            done: for measurements: called after encoding and after writing, with the stage's name.
        """
        config, layout = self.plan.config, self.plan.layout
        encodings = layout.encodings_for(config)
        split = writer.shard.split
        key, ndisp = self.plan.key(split, pair.index), ceil(config.disparity.max_px)
        files = encode_pair(layout, key, pair.frame, pair.provenance, ndisp, encodings)
        done("encode")
        # All frames of a sequence tell of the same redraws.
        redrawn = pair.provenance.get("redrawn", []) if pair.provenance["frame"] == 0 else []
        share = share_beyond(pair.frame, encodings)
        facts = {
            "redrawn": redrawn,
            "share_beyond": share,
            "renderer": pair.provenance["renderer"],
            "seconds": time.perf_counter() - start,
        }
        writer.add(files, facts)
        done("write")
        return Written(split, pair.index, tuple(redrawn), share)


def _facts(shard: Shard, samples: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What a shard's record says beside its files."""
    return {
        "split": shard.split,
        "first": shard.first,
        "end": shard.end,
        "redraws": sum(len(sample["redrawn"]) for sample in samples),
        "renderers": sorted({sample["renderer"] for sample in samples}),
        "seconds": round(sum(sample["seconds"] for sample in samples), 3),
    }


class _Renderers:
    """The renderer of one split at a time."""

    def __init__(self, job: ShardJob, device_index: int) -> None:
        self._job = job
        self._device_index = device_index
        self._open = ExitStack()
        self._renderer: PairRenderer | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def of(self, name: SplitName, watch: Watch) -> PairRenderer:
        if self._renderer is None or self._renderer.split.name != name:
            self._open.close()
            job = self._job
            self._renderer = self._open.enter_context(
                PairRenderer(job.plan.config, job.plan.seed, job.backend, job.plan.split(name), self._device_index)
            )
            changed = differences(job.sources[name], self._renderer.sources.digests())
            if changed:
                raise InputError(
                    f"this process finds other photographs or models than the one that began the dataset: "
                    f"{abbreviate(changed)}. Give all machines the same files, and the same versions of all packages"
                )
            watch.tell(Opened(self._renderer.renderer_name))
        return self._renderer


@dataclass(slots=True)
class Listener:
    """Who is told how a dataset comes on.

    Attributes:
        started: once patches and models are read, by split, and how many pairs are still to make.
        written: of each pair that is on disk.
        noted: a sentence for the user.
        stop: the wish to stop soon; set it from a signal handler, for example.
    """

    started: Callable[[Mapping[SplitName, Sources], int], None] = lambda *_: None
    written: Callable[[Written], None] = lambda _: None
    noted: Callable[[str], None] = lambda _: None
    stop: Stop = field(default_factory=Stop)


@dataclass(frozen=True, slots=True)
class Generated:
    """What a run has come to.

    Attributes:
        place: where the dataset lies.
        plan: what it shall be.
        missing: how many of its shards are not there; 0 for a dataset that is complete.
        stopped: whether it was stopped before it had done all that it was asked for.
    """

    place: Place
    plan: Plan
    missing: int
    stopped: bool = False


def generate(
    config: Config,
    out: str | os.PathLike[str],
    pairs: int | Mapping[SplitName, int],
    seed: int = 0,
    *,
    layout: str | None = None,
    backend: Backend = "auto",
    engine: Engine | None = None,
    gpus: Sequence[int] = (),
    shard_pairs: int | None = None,
    shards: range | None = None,
    overwrite: bool = False,
    listener: Listener | None = None,
) -> Generated:
    """Write a dataset, or what is missing of it.

    The files are the same whatever the engine, however often the run was ended and begun again.

    Args:
        config: the configuration.
        out: a folder, or an address that fsspec knows.
        pairs: how many, to train on or of each split.
        seed: 0 or more.
        layout: see `semisynth_gl.layouts`; by default the dataset's that is there, else ``middlebury``, and
            ``webdataset`` from 10,000 pairs on.
        backend: "auto", "egl" or "osmesa".
        engine: what runs the shards; by default this process.
        gpus: CUDA's numbers of the GPUs that workers take turns on; none for the first device of EGL.
        shard_pairs: pairs in a shard; by default as many as the dataset has already, or as give about 1 GB.
        shards: make these alone, by number; the dataset is complete once all were made, by whichever runs.
        overwrite: replace an earlier dataset of this program.
        listener: who is told how it comes on.

    Raises:
        SemisynthError: where the input cannot be used, the place holds something else, or workers keep dying.
        OSError: where the disk is full or refuses. Whole pairs stay, nothing half-written does.
    """
    listener = listener or Listener()
    place = open_place(out)
    counts: Mapping[SplitName, int] = pairs if isinstance(pairs, Mapping) else {"train": pairs}
    there = {} if overwrite else read_beginning(place) or {}
    layout = layout or there.get("layout") or ("middlebury" if sum(counts.values()) < _MANY_PAIRS else "webdataset")
    plan = make_plan(config, seed, layout, counts, shard_pairs or there.get("shard_pairs"))
    wanted = _chosen(plan.shards, shards)
    files = DatasetFiles(place, plan, overwrite=overwrite)
    if files.complete:
        return Generated(place, plan, 0)
    sources = {name: prepare_sources(plan.config, seed, plan.split(name)) for name in plan.splits}
    digests = {name: each.digests() for name, each in sources.items()}
    job = ShardJob(plan, place, backend, digests, tuple(gpus))
    if files.replaces:
        # What the driver or the checks refuse costs nobody an earlier dataset.
        first = wanted[0]
        with PairRenderer(plan.config, seed, backend, plan.split(first.split), job.device_index(0)) as renderer:
            renderer.render(first.first)
    try:
        files.open(digests)
        missing = files.missing(wanted)
        listener.started(sources, sum(shard.end - shard.first for shard in missing))
        _make(job, missing, engine or SerialEngine(), files, listener)
        left = len(files.missing(plan.shards))
        if not left:
            _finish(files, sources)
    finally:
        files.close()
    return Generated(place, plan, left, stopped=bool(listener.stop.asked and files.missing(wanted, quick=True)))


def _make(job: ShardJob, missing: list[Shard], engine: Engine, files: DatasetFiles, listener: Listener) -> None:
    """Make shards until none of them is missing, or a stop is asked for."""
    renderers: set[str] = set()

    def told(message: object) -> None:
        if isinstance(message, Written):
            listener.written(message)
        elif isinstance(message, Opened) and message.renderer not in renderers:
            renderers.add(message.renderer)
            listener.noted(f"rendering with {message.renderer}")

    waiting = False
    while missing and not listener.stop.asked:
        busy = 0
        tasks = [shard.number for shard in missing]
        with closing(engine.run(job, tasks, told=told, noted=listener.noted, stop=listener.stop)) as results:
            for _, made in results:
                busy += made.state == "busy"
        missing = files.missing(missing)
        if missing and not listener.stop.asked:
            if not busy:
                raise InputError(
                    f"{job.place.address}: {len(missing)} shards were made and are not whole, "
                    f"{missing[0].name} is the first: does something else write there?"
                )
            if not waiting:
                listener.noted(f"another run is making {busy} of the shards: waiting for it")
                waiting = True
            time.sleep(_SECONDS_BETWEEN_LOOKS)


def _finish(files: DatasetFiles, sources: Mapping[SplitName, Sources]) -> None:
    plan = files.plan
    records = [record for shard in plan.shards if (record := files.record(shard)) is not None]
    index = describe_dataset(plan, sources, records)
    files.finish(index, {CARD: encode_card(index), CROISSANT: encode_croissant(index)})


def _chosen(shards: list[Shard], numbers: range | None) -> list[Shard]:
    if numbers is None:
        return shards
    if not numbers or numbers.start < 0 or numbers.stop > len(shards):
        raise InputError(
            f"--shards {numbers.start}-{numbers.stop - 1}: the dataset has the shards 0-{len(shards) - 1} "
            f"({len(shards)} of up to {max(shard.end - shard.first for shard in shards)} pairs)"
        )
    return [shards[number] for number in numbers]
