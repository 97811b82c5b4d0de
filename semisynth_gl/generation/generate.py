"""Making a dataset: an engine makes shards as tasks, and the index follows once all shards are complete.

plan     `Plan`: the pairs, their shards and their names
  -> shard    `ShardJob`: the engine's tasks; except for the disk, each is a pure function of the shard's number
  -> dataset  `generate`: the missing shards, then lists, card and index
"""

import os
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass

from semisynth_gl.config import Config
from semisynth_gl.dataset.apart import check_apart
from semisynth_gl.dataset.begun import complete_record, read_resumed
from semisynth_gl.dataset.card import encode_card
from semisynth_gl.dataset.contents import Shard
from semisynth_gl.dataset.files import DatasetFiles
from semisynth_gl.dataset.index import describe_dataset
from semisynth_gl.dataset.places import Place, open_place
from semisynth_gl.dataset.plan import Plan, make_plan
from semisynth_gl.engines.local import LocalEngine, SerialEngine
from semisynth_gl.engines.task import Engine
from semisynth_gl.generation.shard_job import ShardJob
from semisynth_gl.inputs.arguments import check_type, to_whole
from semisynth_gl.inputs.errors import InputError, abbreviate, counted, shown
from semisynth_gl.listener import Listener
from semisynth_gl.render.backends import Backend
from semisynth_gl.render.devices import check_libraries
from semisynth_gl.scene.mix import MixSampler
from semisynth_gl.scene.sources import Sources, prepare_sources
from semisynth_gl.seeds.splits import SPLITS, SplitName

_SECONDS_BETWEEN_LOOKS = 1.0
# Number of pairs from which on file systems are slower with single files than with tars.
_MANY_PAIRS = 10_000


@dataclass(frozen=True, slots=True)
class GenerationResult:
    """The state of a dataset after a run.

    Attributes:
        place: the dataset's root.
        plan: the plan of the complete dataset.
        missing: number of shards that are still missing; 0 for a complete dataset.
        stopped: whether the listener stopped the run before it had made all shards that it was asked for.
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
) -> GenerationResult:
    """Write a dataset, or its missing part.

    The files are the same with every engine, however often the run was ended and begun again.

    Args:
        config: the config of the pairs, such as `load_config` returns.
        out: the dataset's folder, or an address that fsspec knows.
        pairs: number of training pairs, or of the pairs of each split by its name.
        seed: the dataset's seed, 0 or more.
        layout: see `semisynth_gl.layouts`; by default the layout of the unfinished dataset in ``out``, else
            the config's, else ``middlebury``, and ``webdataset`` from 10,000 pairs on.
        backend: "auto", "egl" or "osmesa".
        engine: runs the shards; by default in this process.
        gpus: CUDA's numbers of the GPUs that workers take in turn; by default all workers use the first GPU of
            CUDA_VISIBLE_DEVICES or, where that is not set, EGL's first device.
        shard_pairs: pairs in a shard; by default as in the unfinished dataset in ``out``, else about 1 GB of them.
        shards: numbers of the shards to make; by default all. Several runs may share the shards of a dataset, which is
            complete once all of them are made.
        overwrite: replace an earlier dataset of this program; an unfinished dataset of the same plan is resumed.
        listener: hears messages, the number of pairs to make and each pair, and may ask to stop.

    Raises:
        SemisynthError: where the input cannot be used, the place holds something else, or workers keep dying.
        OSError: where the disk is full or cannot be written to. Complete pairs stay; half-written pairs are removed.
    """
    check_type("config", config, Config, "load_config(NAME_OR_PATH) reads one")
    check_type("out", out, str | os.PathLike)
    check_type("engine", engine, Engine | None)
    check_type("shards", shards, range | None)
    named: Mapping[SplitName, int] = pairs if isinstance(pairs, Mapping) else {"train": pairs}
    for name in named:
        if name not in SPLITS:
            raise InputError(f"pairs of {shown(name)}: expected the splits {', '.join(SPLITS)}, got {shown(name)}")
    counts = {name: to_whole(f"pairs of {name}", count) for name, count in named.items()}
    check_type("gpus", gpus, Sequence)
    gpus = tuple(to_whole("the number of a GPU", number, least=0) for number in gpus)
    check_type("listener", listener, Listener | None)
    listener = listener or Listener()
    place = open_place(out)
    earlier = None if overwrite else read_resumed(place)
    by_number = "middlebury" if sum(counts.values()) < _MANY_PAIRS else "webdataset"
    layout = layout or (earlier and earlier.layout) or config.layout or by_number
    if shard_pairs is None and earlier is not None:
        shard_pairs = earlier.shard_pairs
    plan = make_plan(config, seed, layout, counts, shard_pairs)
    chosen = _chosen(plan.shards, shards)
    check_apart(place, plan)
    files = DatasetFiles(place, plan, overwrite=overwrite)
    if files.complete:
        return GenerationResult(place, plan, 0)
    for message in _notes(place, files):
        listener.on_message(message)
    if engine is None or isinstance(engine, SerialEngine | LocalEngine):
        check_libraries(backend)
    sources = {split: prepare_sources(plan.config, plan.split(split)) for split in plan.splits}
    digests = {split: split_sources.digests() for split, split_sources in sources.items()}
    job = ShardJob(plan, place, backend, digests, gpus)
    if files.replaces(digests):
        # Render one pair first: if the driver or the config's checks fail, the earlier dataset stays.
        with job.open_renderer(chosen[0].split) as renderer:
            renderer.render(chosen[0].first)
    elif files.begun and overwrite:
        listener.on_message(f"{place.address}: going on with what the same command began before it was ended")
    try:
        files.open(digests)
        missing = files.missing(chosen)
        _describe(plan, sources, listener)
        listener.on_total(sum(shard.end - shard.first for shard in missing))
        _make(job, missing, engine or SerialEngine(), files, listener)
        missing_count = len(files.missing(plan.shards))
        if not missing_count:
            records = [record for shard in plan.shards if (record := complete_record(place, shard)) is not None]
            index = describe_dataset(plan, sources, records)
            files.finish(index, encode_card(index))
    finally:
        files.close()
    stopped = listener.stopping and bool(files.missing(chosen, quick=True))
    return GenerationResult(place, plan, missing_count, stopped)


def _notes(place: Place, files: DatasetFiles) -> Iterator[str]:
    """Yield messages about the dataset's folder, before the run writes there."""
    if files.lost:
        yield f"{place.address}: the dataset lacks {abbreviate(files.lost, 3)}: writing it again"


def _describe(plan: Plan, sources: Mapping[SplitName, Sources], listener: Listener) -> None:
    """Report the patches and models of each split; raises InputError for a target that the scenes cannot meet."""
    for split, split_sources in sources.items():
        prefix = f"{split}: " if len(sources) > 1 else ""
        listener.on_message(prefix + split_sources.atlas.report.summary())
        for reason in split_sources.skipped_models:
            listener.on_message(f"model left out: {reason}")
        listener.on_message(f"{prefix}{counted(len(split_sources.models), 'model')}{_of_the_user(split_sources)}")
    first = plan.splits[0]
    seed, patches = plan.split(first).seed, sources[first].atlas.patches
    # Before any worker starts, so that all workers find the result in the cache.
    MixSampler(plan.config, seed, sources[first].libraries, patches).expected()


def _of_the_user(sources: Sources) -> str:
    """Return a text on the user's models and how often they are drawn; "" without such models."""
    count = max(library.user_count for library in sources.libraries)
    if not count:
        return ""
    shares = [library.user_share for library in sources.libraries]
    low, high = f"{min(shares):.1%}", f"{max(shares):.1%}"
    spread = low if low == high else f"{low} to {high}, by recipe,"
    return f", {count} of them yours: {spread} of the falling objects (models.user)"


def _make(job: ShardJob, missing: list[Shard], engine: Engine, files: DatasetFiles, listener: Listener) -> None:
    """Make shards until none is missing or the listener asks to stop."""
    waiting = False
    while missing and not listener.stopping:
        with closing(engine.run(job, [shard.number for shard in missing], listener)) as states:
            busy = sum(state == "busy" for _, state in states)
        missing = files.missing(missing)
        if missing and not listener.stopping:
            if not busy:
                raise InputError(
                    f"{job.place.address}: {counted(len(missing), 'shard')} made but still not complete, "
                    f"{missing[0].name} is the first: does something else write there?"
                )
            if not waiting:
                listener.on_message(f"another run is making {busy} of the shards: waiting for it")
                waiting = True
            time.sleep(_SECONDS_BETWEEN_LOOKS)


def _chosen(shards: list[Shard], numbers: range | None) -> list[Shard]:
    if numbers is None:
        return shards
    if not numbers or numbers.start < 0 or numbers.stop > len(shards):
        raise InputError(
            f"`shards` {numbers.start}-{numbers.stop - 1}: the dataset has the shards 0-{len(shards) - 1} "
            f"({len(shards)} of up to {counted(max(shard.end - shard.first for shard in shards), 'pair')})"
        )
    return [shards[number] for number in numbers]
