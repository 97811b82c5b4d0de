"""``semisynth-gl generate``."""

import re
import shlex
from typing import TYPE_CHECKING

import click

from semisynth_gl.cli.options import (
    COUNT,
    MOST_WORKERS,
    NATURAL,
    Command,
    Number,
    SceneOptions,
    option,
    scene_options,
    split,
)
from semisynth_gl.cli.progress import Progress
from semisynth_gl.config import Config
from semisynth_gl.dataset.interrupts import interrupts_end, interrupts_stop
from semisynth_gl.dataset.root import open_root
from semisynth_gl.frame.channels import OUTPUTS, TRUTH_VIEWS, TruthViews, View
from semisynth_gl.inputs.errors import InputError, counted
from semisynth_gl.layouts import layout_names
from semisynth_gl.listener import FinishedPair
from semisynth_gl.plugins import MissingPluginError

if TYPE_CHECKING:
    from semisynth_gl.dataset.engines import Engine
    from semisynth_gl.dataset.generate import GenerationResult

_REASONS_SHOWN = 5
# Share of a pair's pixels above which a message tells of disparities that the encoding cannot store.
_LARGE_SHARE_BEYOND = 0.01
# A worker takes about as long to start as to make a few pairs.
_PAIRS_PER_WORKER = 8
# The exit code of a run that was stopped.
_STOPPED = 2


def _range(_: click.Context, __: click.Parameter, text: str | None) -> range | None:
    if text is None:
        return None
    parts = re.fullmatch(r"([0-9]{1,9})(?:-([0-9]{1,9}))?", text)
    if parts is None:
        raise click.BadParameter(f"expected one number, or two such as 100-199, got {text!r}")
    return range(int(parts[1]), int(parts[2] or parts[1]) + 1)


@click.command(cls=Command)
@scene_options
@option(
    "--out",
    metavar="DIR_OR_ADDRESS",
    help="Folder to write to, or an address such as s3://bucket/name.  [default: out/ and the config's name]",
)
@option(
    "--layout",
    type=click.Choice(layout_names()),
    help="Folders, names and encodings of the files.  [default: the config's, else middlebury, or webdataset from "
    "10,000 pairs on]",
)
@option(
    "--outputs",
    callback=split(click.Choice((*OUTPUTS, "none"))),
    metavar="a,b",
    help=f"Files besides images and disparities: {', '.join(OUTPUTS)}; or none.  [default: the config's]",
)
@option(
    "--truth",
    type=click.Choice(TRUTH_VIEWS),
    help="Views whose disparity and outputs are written.  [default: the config's]",
)
@option("--pairs", type=NATURAL, default=24, help="How many training pairs to make.")
@option("--validation", type=NATURAL, default=0, help="Validation pairs to add; they share no photograph with others.")
@option("--test", type=NATURAL, default=0, help="Test pairs to add; they share no photograph with others.")
@option(
    "--engine",
    type=click.Choice(("serial", "local", "ray")),
    help="Where to make the shards: in this process, in processes of this machine, or on a Ray cluster.  "
    "[default: local where there is work for several workers, else serial]",
)
@option(
    "--workers",
    type=click.IntRange(min=1, max=MOST_WORKERS),
    help="Processes of the engine local; their number does not change the files.  [default: one for each core, "
    f"and at most one for {_PAIRS_PER_WORKER} pairs]",
)
@option(
    "--gpus",
    callback=split(click.IntRange(min=0, max=9999)),
    metavar="A,B",
    help="CUDA's numbers of the GPUs, which are given to workers in turn.",
)
@option(
    "--gpu-share",
    type=Number(min=0, max=MOST_WORKERS),
    default=0.0,
    help="GPUs for each Ray task; a fraction lets several tasks share a GPU.",
)
@option("--ray-address", help="Ray cluster to use.  [default: $RAY_ADDRESS, else a local one]")
@option("--shard-pairs", type=COUNT, help="Pairs in a shard.  [default: 64, or fewer in a small dataset]")
@option(
    "--shards",
    callback=_range,
    metavar="A-B",
    help="Make only these shards, counted from 0, to share the work among machines.",
)
@option("--overwrite", is_flag=True, help="Replace the dataset in the --out folder.")
def generate(
    scene: SceneOptions,
    out: str | None,
    layout: str | None,
    outputs: tuple[str, ...] | None,
    truth: TruthViews | None,
    pairs: int,
    validation: int,
    test: int,
    engine: str | None,
    workers: int | None,
    gpus: tuple[int, ...] | None,
    gpu_share: float,
    ray_address: str | None,
    shard_pairs: int | None,
    shards: range | None,
    overwrite: bool,
) -> None:
    """Write a dataset: left, right, both disparities, masks and calibration of each pair.

    If a run was stopped or killed, the same command makes only the missing shards. With more --pairs, the dataset
    grows. Ctrl-C stops it; complete shards stay.

    The layout decides which loaders can read the files; docs/output.md lists all layouts. Outputs add files; flow
    outputs need sequences, which the config's section sequence makes. The config's section files chooses encodings.
    """
    # Imported here: help and completion need no renderer.
    with interrupts_end():
        from semisynth_gl.dataset.generate import generate as generate_dataset  # noqa: PLC0415

    settings = [] if truth is None else [f"truth={truth}"]
    if outputs is not None:
        settings.append(f"outputs=[{', '.join(name for name in outputs if name != 'none')}]")
    try:
        config = scene.config(*settings)
    except MissingPluginError:
        if out is not None and not overwrite:
            from semisynth_gl.dataset.folder import read_plan  # noqa: PLC0415 - see above

            read_plan(open_root(out))  # the dataset in this place may name the package to install
        raise
    with _GenerationProgress() as progress:
        result = generate_dataset(
            config,
            out if out is not None else f"out/{config.name}",
            {"train": pairs, "validation": validation, "test": test},
            scene.seed,
            layout=layout,
            backend=scene.backend,
            engine=_open_engine(engine, workers, gpus, gpu_share, ray_address, pairs + validation + test),
            # Ray shows each task its GPU as number 0.
            gpus=gpus or ((0,) if gpu_share else ()),
            shard_pairs=shard_pairs,
            shards=shards,
            overwrite=overwrite,
            listener=progress,
        )
    progress.conclude(config, result)
    _conclude(result)


def _open_engine(
    name: str | None,
    workers: int | None,
    gpus: tuple[int, ...] | None,
    gpu_share: float,
    ray_address: str | None,
    pairs: int,
) -> "Engine":
    """Return the engine that makes a number of pairs in all; refuse options that it does not take."""
    # Imported here: help and completion need no renderer.
    from semisynth_gl.dataset.cluster import RayEngine  # noqa: PLC0415
    from semisynth_gl.dataset.engines import LocalEngine, SerialEngine, cores  # noqa: PLC0415

    if workers is not None and (name == "ray" or (name == "serial" and workers > 1)):
        raise InputError(f"--workers is for --engine local, and not for {name}")
    if name == "ray" and gpus:
        raise InputError("--gpus is for --engine local: Ray chooses the GPUs of its processes, with --gpu-share")
    if name == "ray":
        return RayEngine(ray_address, gpus=gpu_share)
    if ray_address is not None or gpu_share:
        raise InputError("--ray-address and --gpu-share are for --engine ray")
    count = workers or max(1, min(cores(), pairs // _PAIRS_PER_WORKER))
    return SerialEngine() if name == "serial" or (name is None and count == 1) else LocalEngine(count)


class _GenerationProgress(Progress):
    """Progress that stops the run at Ctrl-C, and collects redrawn and unencodable pairs for messages at the end."""

    def __init__(self) -> None:
        super().__init__()
        self._redrawn: list[str] = []
        self._shares_beyond: list[float] = []

    def on_total(self, pairs: int) -> None:
        self._open.enter_context(interrupts_stop(self))
        super().on_total(pairs)

    def on_pair(self, pair: FinishedPair) -> None:
        super().on_pair(pair)
        self._redrawn.extend(f"pair {pair.index}: {reason}" for reason in pair.redrawn)
        if pair.share_beyond > _LARGE_SHARE_BEYOND:
            self._shares_beyond.append(pair.share_beyond)

    def conclude(self, config: Config, result: "GenerationResult") -> None:
        for reason in self._redrawn[:_REASONS_SHOWN]:
            self.on_message(f"rendered anew, {reason}")
        if self._redrawn:
            count = len(self._redrawn)
            self.on_message(f"pairs rendered anew after they failed their checks: {count} (see the shards' records)")
        if self._shares_beyond:
            encoding = result.plan.layout.encodings_for(config).disparity.name
            self.on_message(
                f"in {counted(len(self._shares_beyond), 'pair')} more than {_LARGE_SHARE_BEYOND:.0%} of the pixels "
                f"have a disparity that {encoding} cannot hold, at worst {max(self._shares_beyond):.1%}: they are "
                f"invalid ({View.disparity.beyond_key} counts them)"
            )


def _conclude(result: "GenerationResult") -> None:
    plan, total = result.plan, sum(result.plan.pairs.values())
    if result.stopped:
        click.echo("Stopped. Complete shards stay on disk; the same command makes the others.", err=True)
        click.get_current_context().exit(_STOPPED)
    if result.missing:
        click.echo(
            f"{result.missing} of {counted(len(plan.shards), 'shard')} still missing. The run that makes the last one "
            "completes the dataset and writes its index.",
            err=True,
        )
        click.echo(f"the requested shards are in {result.root}")
        return
    address = str(result.root)
    click.echo(f"{counted(total, 'pair')} in {address}")
    click.echo(f"To look at the images: semisynth-gl report {shlex.quote(address)}", err=True)
