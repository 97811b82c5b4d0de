"""``semisynth-gl generate``."""

import re
import shlex
from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from semisynth_gl.cli.completion import one_of, some_of
from semisynth_gl.cli.options import (
    COUNT,
    MOST_WORKERS,
    NATURAL,
    Command,
    FilesType,
    Number,
    SceneOptions,
    option,
    option_group,
    scene_options,
)
from semisynth_gl.cli.progress import Progress
from semisynth_gl.cli.streams import say
from semisynth_gl.config import Config
from semisynth_gl.dataset.interrupts import interrupts_end, interrupts_stop
from semisynth_gl.dataset.root import open_root
from semisynth_gl.frame.channels import OUTPUTS, TRUTH_VIEWS, TruthViews, View
from semisynth_gl.inputs.errors import InputError, counted, did_you_mean, near, shown
from semisynth_gl.layouts import layout_names
from semisynth_gl.listener import FinishedPair
from semisynth_gl.plugins import MissingPluginError
from semisynth_gl.seeds.splits import SplitName

if TYPE_CHECKING:
    from semisynth_gl.dataset.engines import Engine
    from semisynth_gl.dataset.generate import GenerationResult

ENGINES = ("serial", "local", "ray")
_REASONS_SHOWN = 5
# Share of a pair's pixels above which a message tells of disparities that the encoding cannot store.
_LARGE_SHARE_BEYOND = 0.01
# A worker takes about as long to start as to make a few pairs.
_PAIRS_PER_WORKER = 8
# The exit code of a run that was stopped.
_STOPPED = 2


@dataclass(frozen=True, slots=True)
class _DatasetOptions:
    """The options that say what to write and where."""

    out: str | None
    layout: str | None
    outputs: str | None
    truth: TruthViews | None
    pairs: int
    validation: int
    test: int

    def settings(self) -> list[str]:
        """Return the options that override keys of the config, as --set takes them."""
        settings = [] if self.truth is None else [f"truth={self.truth}"]
        if self.outputs is None:
            return settings
        names = [] if self.outputs == "none" else [name.strip() for name in self.outputs.split(",")]
        for name in names:
            if name not in OUTPUTS:
                hint = did_you_mean(near(name, OUTPUTS), f"expected some of {', '.join(OUTPUTS)}, or none")
                raise InputError(f"--outputs: unknown output {shown(name)}; {hint}")
        return [*settings, f"outputs=[{', '.join(names)}]"]


def _lasting(_: click.Context, __: click.Parameter, address: str | None) -> str | None:
    """Refuse fsspec's memory, which ends with this process; only callers in Python can use it."""
    if address is not None and re.match(r"(.*::)?memory://", address):
        raise InputError(f"--out {address}: would be gone when this command ends; name a folder or a store")
    return address


_dataset_options = option_group(
    "dataset",
    _DatasetOptions,
    option(
        "--out",
        type=FilesType(),
        callback=_lasting,
        metavar="DIR_OR_ADDRESS",
        help="Folder to write to, or an address such as s3://bucket/name.  [default: out/ and the config's name]",
    ),
    option(
        "--layout",
        shell_complete=one_of(layout_names()),
        metavar="NAME",
        help=f"Folders, names and encodings of the files: {', '.join(layout_names())}.  [default: the config's, else "
        "middlebury, or webdataset from 10,000 pairs on]",
    ),
    option(
        "--outputs",
        shell_complete=some_of((*OUTPUTS, "none")),
        metavar="a,b",
        help=f"Files besides images and disparities: {', '.join(OUTPUTS)}; or none.  [default: the config's]",
    ),
    option(
        "--truth",
        type=click.Choice(TRUTH_VIEWS),
        help="Views whose disparity and outputs are written.  [default: the config's]",
    ),
    option("--pairs", type=NATURAL, default=24, help="How many training pairs to make."),
    click.option(
        "--validation",
        type=NATURAL,
        default=0,
        metavar="N",
        help="Validation pairs to add; they share no photograph with training pairs.",
    ),
    click.option(
        "--test",
        type=NATURAL,
        default=0,
        metavar="N",
        help="Test pairs to add; they share no photograph with training and validation pairs.",
    ),
)


@dataclass(frozen=True, slots=True)
class _WorkerOptions:
    """The options that say which processes and devices make the shards."""

    engine: str | None
    workers: int | None
    gpus: str | None
    gpu_share: float
    ray_address: str | None

    def open_engine(self, pairs: int) -> "Engine":
        """Return the engine that makes a number of pairs in all; refuse options that it does not take."""
        # Imported here: help and completion need no renderer.
        from semisynth_gl.dataset.cluster import RayEngine  # noqa: PLC0415
        from semisynth_gl.dataset.engines import LocalEngine, SerialEngine, cores  # noqa: PLC0415

        if self.engine is not None and self.engine not in ENGINES:
            raise InputError(f"--engine: expected one of {', '.join(ENGINES)}, got {self.engine}")
        if self.engine == "ray" and self.workers is not None:
            raise InputError("--workers is for --engine local: Ray has as many as the cluster has room for")
        if self.engine == "serial" and self.workers not in (None, 1):
            raise InputError("--engine serial works in this process only: leave --workers out, or use --engine local")
        if self.engine == "ray":
            return RayEngine(self.ray_address, gpus=self.gpu_share)
        if self.ray_address is not None or self.gpu_share:
            raise InputError("--ray-address and --gpu-share are for --engine ray")
        count = self.workers or max(1, min(cores(), pairs // _PAIRS_PER_WORKER))
        if self.engine == "serial" or (self.engine is None and count == 1):
            return SerialEngine()
        return LocalEngine(count)

    def gpu_numbers(self) -> tuple[int, ...]:
        """Return CUDA's numbers of the GPUs; none leaves the choice to EGL. Ray shows each task its GPU as number 0."""
        if self.gpus is None:
            return (0,) if self.gpu_share else ()
        if not re.fullmatch(r"[0-9]{1,4}(,[0-9]{1,4})*", self.gpus):
            raise InputError(f"--gpus: expected numbers such as 0,1,3, got {self.gpus!r}")
        return tuple(int(number) for number in self.gpus.split(","))


_worker_options = option_group(
    "workers",
    _WorkerOptions,
    option(
        "--engine",
        shell_complete=one_of(ENGINES),
        metavar="|".join(ENGINES),
        help="Where to make the shards: in this process, in processes of this machine, or on a Ray cluster.  "
        "[default: local where there is work for several workers, else serial]",
    ),
    option(
        "--workers",
        type=click.IntRange(min=1, max=MOST_WORKERS),
        metavar="N",
        help="Processes of the engine local; their number does not change the files.  [default: one for each core, "
        f"and at most one for {_PAIRS_PER_WORKER} pairs]",
    ),
    option("--gpus", metavar="A,B", help="CUDA's numbers of the GPUs, which are given to workers in turn."),
    click.option(
        "--gpu-share",
        type=Number(min=0, max=MOST_WORKERS),
        default=0.0,
        metavar="X",
        help="GPUs for each Ray task; a fraction lets several tasks share a GPU.",
    ),
    option("--ray-address", metavar="ADDRESS", help="Ray cluster to use.  [default: $RAY_ADDRESS, else a local one]"),
)


@click.command(cls=Command)
@scene_options
@_dataset_options
@_worker_options
@option("--shard-pairs", type=COUNT, metavar="N", help="Pairs in a shard.  [default: 64, or fewer in a small dataset]")
@option("--shards", metavar="A-B", help="Make only these shards, counted from 0, to share the work among machines.")
@option("--overwrite", is_flag=True, help="Replace the dataset in the --out folder.")
def generate(
    scene: SceneOptions,
    dataset: _DatasetOptions,
    workers: _WorkerOptions,
    shard_pairs: int | None,
    shards: str | None,
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

    try:
        config = scene.config(*dataset.settings())
    except MissingPluginError:
        if dataset.out is not None and not overwrite:
            from semisynth_gl.dataset.folder import read_plan  # noqa: PLC0415 - see above

            read_plan(open_root(dataset.out))  # the dataset in this place may name the package to install
        raise
    counts: dict[SplitName, int] = {"train": dataset.pairs, "validation": dataset.validation, "test": dataset.test}
    engine = workers.open_engine(sum(counts.values()))
    with _GenerationProgress() as progress:
        result = generate_dataset(
            config,
            dataset.out if dataset.out is not None else f"out/{config.name}",
            counts,
            scene.seed,
            layout=dataset.layout,
            backend=scene.backend,
            engine=engine,
            gpus=workers.gpu_numbers(),
            shard_pairs=shard_pairs,
            shards=_range(shards) if shards is not None else None,
            overwrite=overwrite,
            listener=progress,
        )
    progress.conclude(config, result)
    _conclude(result)


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
            self.on_message(f"drawn again, {reason}")
        if self._redrawn:
            count = len(self._redrawn)
            self.on_message(f"pairs drawn again after they failed their checks: {count} (see the shards' records)")
        if self._shares_beyond:
            encoding = result.plan.layout.encodings_for(config).disparity.name
            self.on_message(
                f"in {counted(len(self._shares_beyond), 'pair')} more than {_LARGE_SHARE_BEYOND:.0%} of the pixels "
                f"have a disparity that {encoding} cannot hold, at worst {max(self._shares_beyond):.1%}: they are "
                f"invalid ({View.disparity.beyond_key} counts them); files.disparity=pfm holds them, in a "
                "layout that lets you choose"
            )


def _range(text: str) -> range:
    parts = re.fullmatch(r"([0-9]{1,9})(?:-([0-9]{1,9}))?", text)
    if parts is None:
        raise InputError(f"--shards: expected one number, or two such as 100-199, got {text!r}")
    first, last = int(parts[1]), int(parts[2] or parts[1])
    if last < first:
        raise InputError(f"--shards {text}: the second number must not be smaller than the first")
    return range(first, last + 1)


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
        say(f"the requested shards are in {result.root}")
        return
    address = str(result.root)
    say(f"{counted(total, 'pair')} in {address}")
    click.echo(f"To look at the images: semisynth-gl report {shlex.quote(address)}", err=True)
