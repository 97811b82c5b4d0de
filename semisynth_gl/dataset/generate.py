"""Making a dataset: an engine makes the missing shards; when none is missing, the index is written."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from upath import UPath

from semisynth_gl.config import Config
from semisynth_gl.dataset import folder
from semisynth_gl.dataset.documents import INDEX, DatasetPlan, Shard
from semisynth_gl.dataset.engines import Engine, LocalEngine, SerialEngine
from semisynth_gl.dataset.make import DatasetJob
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.dataset.root import is_local, open_root
from semisynth_gl.inputs.arguments import to_whole
from semisynth_gl.inputs.errors import InputError, counted
from semisynth_gl.listener import Listener
from semisynth_gl.render import Backend
from semisynth_gl.render.context import check_libraries
from semisynth_gl.scene.mix import RecipeMixSampler
from semisynth_gl.scene.sources import SceneSources, prepare_sources
from semisynth_gl.seeds.splits import SplitName
from semisynth_gl.textures.image_files import reaching_source


@dataclass(frozen=True, slots=True)
class GenerationResult:
    """A dataset after a run: its folder or address, the plan of all its pairs, and the number of missing shards."""

    root: UPath
    plan: DatasetPlan
    missing: int


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
    """Write a dataset, or its missing part. The files do not depend on the engine, nor on interruptions.

    Args:
        config: the config of the pairs, such as `load_config` returns.
        out: the dataset's folder, or an address that fsspec knows.
        pairs: number of training pairs, or number of pairs by split.
        seed: the dataset's seed, 0 or more.
        layout: see `semisynth_gl.layouts`; by default the layout of the dataset in ``out``, else the config's, else
            ``middlebury``, and ``webdataset`` from 10,000 pairs on.
        backend: "auto", "egl" or "osmesa".
        engine: makes the shards; by default in this process.
        gpus: CUDA's numbers of the GPUs that workers take in turn; by default the first GPU of CUDA_VISIBLE_DEVICES
            or, where that is not set, EGL's first device.
        shard_pairs: pairs in a shard; by default as in the dataset in ``out``, else 64 or fewer, see `make_plan`.
        shards: numbers of the shards to make; by default all. Runs on several machines may make different shards of a
            dataset; the run that makes the last missing shard writes the index.
        overwrite: replace an earlier dataset of this program, with all files in the folders of its layout; but resume
            an unfinished dataset with the same arguments.
        listener: receives messages, the number of pairs to make and each pair.

    Raises:
        SemisynthError: where the input cannot be used, ``out`` holds something else, or workers keep dying.
        OSError: where the disk is full or cannot be written to. Complete shards stay.
    """
    counts: Mapping[SplitName, int] = pairs if isinstance(pairs, Mapping) else {"train": pairs}
    gpus = tuple(to_whole("the number of a GPU", number, least=0) for number in gpus)
    listener, engine, root = listener or Listener(), engine or SerialEngine(), open_root(out)
    stored = folder.read_plan(root)
    resumed = None if overwrite or folder.holds_only_plan(root) else stored
    if resumed is not None:
        layout = layout or resumed.layout_name
        shard_pairs = resumed.shard_pairs if shard_pairs is None else shard_pairs
    plan = make_plan(config, seed, layout, counts, shard_pairs)
    numbers = _shard_numbers(plan.shards, shards)
    check_outside_sources(root, plan.config)
    if resumed is not None:
        folder.check_resumable(root, resumed, plan)
        if resumed.pairs == plan.pairs and (root / INDEX).exists() and not folder.missing(root, resumed):
            return GenerationResult(root, resumed, 0)
    if isinstance(engine, SerialEngine | LocalEngine):
        check_libraries(backend)
    sources = {split: prepare_sources(plan.config, plan.split(split)) for split in plan.splits}
    digests = {split: dict(split_sources.digests()) for split, split_sources in sources.items()}
    plan = plan.model_copy(update={"sources": digests})
    job = DatasetJob(plan, str(root.absolute()), backend, gpus)
    _describe(plan, sources, listener)
    replaces = resumed is None and stored is not None and (stored != plan or (root / INDEX).exists())
    with folder.locked(root, shared=shards is not None and not replaces) as alone:
        # Only a run that is alone may replace a plan: the runs of other machines may have begun to make its shards.
        folder.begin(root, plan, overwrite=overwrite or (alone and folder.holds_only_plan(root)))
        wanted = [shard for shard in folder.missing(root, plan) if shard.number in numbers]
        listener.on_total(sum(shard.end - shard.first for shard in wanted))
        if wanted:
            engine.run(job, [shard.number for shard in wanted], listener)
        still_missing = folder.missing(root, plan)
        redraws = 0 if still_missing else folder.finish(root, plan, sources)["redraws"]
    if redraws:
        attempts = counted(redraws, "attempt")
        listener.on_message(f"{attempts} failed the checks and were rendered anew; the pairs' JSON files say why")
    return GenerationResult(root, plan, len(still_missing))


def check_outside_sources(root: UPath, config: Config) -> None:
    """Raise InputError if the dataset's folder is inside a folder of photographs or models."""
    images = config.textures.images if config.textures.source == "images" else ()
    if is_local(root) and (source := reaching_source(Path(root), (*images, *config.models.folders))):
        raise InputError(
            f"{root}: is inside {source}, from which the dataset is made. Its files would be used as photographs or "
            "models: choose a folder elsewhere",
            argument="out",
        )


def _describe(plan: DatasetPlan, sources: Mapping[SplitName, SceneSources], listener: Listener) -> None:
    """Report the patches and models of each split; raises InputError if the scenes cannot meet the target."""
    for split, split_sources in sources.items():
        prefix = f"{split}: " if len(sources) > 1 else ""
        listener.on_message(prefix + split_sources.atlas.report.summary())
        for reason in split_sources.skipped_models:
            listener.on_message(f"model left out: {reason}")
        of_user = max(library.user_count for library in split_sources.libraries)
        yours = f", {of_user} of them yours" if of_user else ""
        listener.on_message(f"{prefix}{counted(len(split_sources.models), 'model')}{yours}")
    codec, section = plan.encodings.disparity, plan.config.disparity
    for side, sign, end_px in (("above", 1, section.max_px), ("below", -1, section.min_px)):
        if sign * end_px > codec.limit_px:
            limit = f"{side} {sign * codec.limit_px:.0f} px, of up to {end_px:g} px,"
            listener.on_message(f"disparities {limit} become invalid: {codec.description} cannot hold them")
    first = plan.splits[0]
    seed, patches = plan.split(first).seed, sources[first].atlas.patches
    # Solve the scenes before workers start, so that all workers find the result in the cache.
    RecipeMixSampler(plan.config, seed, sources[first].libraries, patches).expected()


def _shard_numbers(shards: Sequence[Shard], numbers: range | None) -> range:
    """Return ``numbers``, or all shard numbers if it is None. Raises InputError for a number that no shard has."""
    if numbers is None:
        return range(len(shards))
    if not numbers or numbers.start < 0 or numbers.stop > len(shards):
        raise InputError(
            f"{numbers.start}-{numbers.stop - 1}: the dataset has the shards 0-{len(shards) - 1} "
            f"({len(shards)} of up to {counted(max(shard.end - shard.first for shard in shards), 'pair')})",
            argument="shards",
        )
    return numbers
