"""``semisynth-gl generate``."""

import re
import sys
from collections.abc import Mapping
from contextlib import ExitStack

import click

from semisynth_gl.cli.options import read_config, scene_options
from semisynth_gl.cli.progress import Progress
from semisynth_gl.cli.stopping import asking_to_stop
from semisynth_gl.config import Config
from semisynth_gl.engines.local import LocalEngine
from semisynth_gl.engines.serial import SerialEngine
from semisynth_gl.engines.task import Engine, cores
from semisynth_gl.errors import InputError
from semisynth_gl.frame import OUTPUTS, TRUTH_VIEWS, TruthViews
from semisynth_gl.generation.generate import Generated, Listener, Written
from semisynth_gl.generation.generate import generate as make
from semisynth_gl.layouts import layout_names
from semisynth_gl.render.context import Backend
from semisynth_gl.scene.sources import Sources
from semisynth_gl.splits import SplitName

ENGINES = ("serial", "local", "ray")
_REASONS_SHOWN = 5
# Above this share of a pair's pixels, what the encoding of disparity cannot say is worth a word.
_MUCH_BEYOND = 0.01
# A worker takes about as long to start as to make a few pairs.
_PAIRS_PER_WORKER = 8
# It did what it could, and there is more to do.
_STOPPED = 2


@click.command()
@scene_options
@click.option(
    "--out",
    metavar="DIR_OR_ADDRESS",
    help="Folder to write to, or an address such as s3://bucket/name.  [default: out/ and the config's name]",
)
@click.option("--layout", metavar="NAME", help=f"Names of files: {', '.join(layout_names())}.  [default: middlebury; "
    "webdataset from 10,000 pairs on]")  # fmt: skip
@click.option("--outputs", metavar="a,b", help=f"Beside images and disparities: {', '.join(OUTPUTS)}; or none.")
@click.option(
    "--truth", type=click.Choice(TRUTH_VIEWS), help="Views to write disparity and outputs of.  [default: the config's]"
)
@click.option("--pairs", type=click.IntRange(min=0), default=24, show_default=True, help="How many pairs to train on.")
@click.option(
    "--validation", type=click.IntRange(min=0), default=0, metavar="N", help="How many besides, of other photographs."
)
@click.option("--test", type=click.IntRange(min=0), default=0, metavar="N", help="Likewise, of others again.")
@click.option(
    "--engine",
    metavar="|".join(ENGINES),
    help="What makes the shards: this process, processes of this machine, or a Ray cluster.  [default: local, where "
    "there is work for several workers]",
)
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    metavar="N",
    help="Processes of the engine local; the files are the same whatever their number.  [default: a core each, at most "
    f"one for {_PAIRS_PER_WORKER} pairs]",
)
@click.option("--gpus", metavar="A,B", help="CUDA's numbers of the GPUs that workers take turns on.")
@click.option(
    "--gpu-share", type=click.FloatRange(min=0), default=0.0, metavar="X", help="GPUs, or part of one, of a Ray task."
)
@click.option("--ray-address", metavar="ADDRESS", help="A running cluster.  [default: $RAY_ADDRESS, else a local one]")
@click.option(
    "--timeout",
    type=click.FloatRange(min=0, min_open=True),
    default=600.0,
    show_default=True,
    metavar="SECONDS",
    help="A worker of the engine local that takes longer for a pair, or to start, is replaced.",
)
@click.option(
    "--shard-pairs", type=click.IntRange(min=1), metavar="N", help="Pairs in a shard.  [default: about 1 GB]"
)  # fmt: skip
@click.option("--shards", metavar="A-B", help="Make these alone, counted from 0: a share of the work for each machine.")
@click.option("--overwrite", is_flag=True, help="Replace the dataset that is in the folder.")
def generate(
    config_name: str,
    images: tuple[str, ...],
    models: tuple[str, ...],
    seed: int,
    settings: tuple[str, ...],
    backend: Backend,
    out: str | None,
    layout: str | None,
    outputs: str | None,
    truth: TruthViews | None,
    pairs: int,
    validation: int,
    test: int,
    engine: str | None,
    workers: int | None,
    gpus: str | None,
    gpu_share: float,
    ray_address: str | None,
    timeout: float,
    shard_pairs: int | None,
    shards: str | None,
    overwrite: bool,  # noqa: FBT001 - click passes flags so
) -> None:
    """Write a dataset: left, right, both disparities, masks and calibration of each pair.

    Run it again to go on where it was stopped or killed: it makes what is missing, and nothing else. With more --pairs
    a dataset grows. Ctrl-C once finishes the pairs in hand.

    The layout decides which loaders read the files; docs/layouts.md has them all. Outputs add files; those of flow want
    sequences, which the config's section sequence makes. The config's section files chooses other encodings.
    """
    if outputs is not None:
        settings = (*settings, f"outputs=[{'' if outputs == 'none' else outputs}]")
    if truth is not None:
        settings = (*settings, f"truth={truth}")
    config = read_config(config_name, images, models, settings)
    counts: Mapping[SplitName, int] = {"train": pairs, "validation": validation, "test": test}
    runs = _engine(engine, workers, sum(counts.values()), timeout, ray_address, gpu_share)
    redrawn: list[str] = []
    beyond: list[float] = []

    with Progress() as progress, ExitStack() as signals:
        listener = Listener(noted=lambda text: click.echo(text, err=True))

        def started(sources: Mapping[SplitName, Sources], left: int) -> None:
            _show_sources(sources)
            signals.enter_context(asking_to_stop(listener.stop))
            progress.begin(left)

        def written(pair: Written) -> None:
            if pair.kept:
                progress.drop()
                return
            beyond.append(pair.share_beyond)
            redrawn.extend(f"pair {pair.index}: {reason}" for reason in pair.redrawn)
            progress.advance()

        listener.started, listener.written = started, written
        result = make(
            config,
            out if out is not None else f"out/{config.name}",
            counts,
            seed,
            layout=layout,
            backend=backend,
            engine=runs,
            gpus=_numbers(gpus) if gpus is not None else (0,) if gpu_share else (),
            shard_pairs=shard_pairs,
            shards=_range(shards) if shards is not None else None,
            overwrite=overwrite,
            listener=listener,
        )
    for reason in redrawn[:_REASONS_SHOWN]:
        click.echo(f"drawn again, {reason}", err=True)
    if redrawn:
        click.echo(
            f"{len(redrawn)} times a pair failed its checks and was drawn again (see the shards' records)", err=True
        )
    _warn_of_lost(beyond, config, result)
    _conclude(result)


def _engine(
    name: str | None, workers: int | None, pairs: int, timeout: float, address: str | None, gpu_share: float
) -> Engine:
    if name is not None and name not in ENGINES:
        raise InputError(f"--engine: expected one of {', '.join(ENGINES)}, got {name}")
    if name == "ray":
        # Loaded with the engine that needs it.
        from semisynth_gl.engines.cluster import RayEngine  # noqa: PLC0415

        return RayEngine(address, gpus=gpu_share)
    if address is not None or gpu_share:
        raise InputError("--ray-address and --gpu-share are for --engine ray")
    count = workers or max(1, min(cores(), pairs // _PAIRS_PER_WORKER))
    if name == "serial" and workers not in (None, 1):
        raise InputError(f"--engine serial works in this process alone: leave --workers {workers} out, or take local")
    if name == "serial" or (name is None and count == 1):
        return SerialEngine()
    return LocalEngine(count, timeout)


def _numbers(text: str) -> tuple[int, ...]:
    if not re.fullmatch(r"\d+(,\d+)*", text):
        raise InputError(f"--gpus: expected numbers such as 0,1,3, got {text!r}")
    return tuple(int(number) for number in text.split(","))


def _range(text: str) -> range:
    parts = re.fullmatch(r"(\d+)(?:-(\d+))?", text)
    if parts is None:
        raise InputError(f"--shards: expected one number, or two such as 100-199, got {text!r}")
    first, last = int(parts[1]), int(parts[2] or parts[1])
    if last < first:
        raise InputError(f"--shards {text}: the second number must not be below the first")
    return range(first, last + 1)


def _show_sources(sources: Mapping[SplitName, Sources]) -> None:
    for name, each in sources.items():
        begin = f"{name}: " if len(sources) > 1 else ""
        click.echo(begin + each.atlas.report.summary(), err=True)
        for skipped in each.model_library.skipped:
            click.echo(f"model left out: {skipped}", err=True)
        click.echo(f"{begin}{len(each.model_library.models)} models", err=True)


def _warn_of_lost(shares: list[float], config: Config, result: Generated) -> None:
    """Say of how many pairs the encoding loses much; ``shares`` has those of its pixels."""
    much = [share for share in shares if share > _MUCH_BEYOND]
    if much:
        encoding = result.plan.layout.encodings_for(config).disparity.name
        click.echo(
            f"in {len(much)} pairs more than {_MUCH_BEYOND:.0%} of the pixels have a disparity that {encoding} cannot "
            f"hold, at worst {max(much):.1%}: they are invalid (disparity_beyond counts them); "
            "files.disparity=pfm or tiff holds them, in a layout that lets you choose",
            err=True,
        )


def _conclude(result: Generated) -> None:
    plan, total = result.plan, sum(result.plan.pairs.values())
    if result.stopped:
        click.echo("Stopped. Whole pairs stay on disk; the same command goes on where it ended.", err=True)
        sys.exit(_STOPPED)
    if result.missing:
        click.echo(
            f"{result.missing} of {len(plan.shards)} shards are not there yet: the dataset is complete, and gets its "
            "index, with the run that makes the last one",
            err=True,
        )
        click.echo(f"the shards asked for are in {result.place.address}")
        return
    for split in plan.splits:
        for advice in plan.layout.advice(plan.pairs[split], plan.config, split):
            click.echo(f"note: {advice}", err=True)
    click.echo(f"{total} pairs in {result.place.address}")
