"""``semisynth-gl generate``."""

import re
import shlex
from typing import TYPE_CHECKING, Any

import click

from semisynth_gl.cli.options import COUNT, MOST_WORKERS, NATURAL, Command, option, scene_config, scene_options, split
from semisynth_gl.cli.progress import Progress
from semisynth_gl.frame.channels import OUTPUTS
from semisynth_gl.inputs.errors import InputError, counted
from semisynth_gl.plugins import BUILT_IN
from semisynth_gl.seeds.splits import SplitName

if TYPE_CHECKING:
    from semisynth_gl.dataset.engines import Engine

# Starting a worker takes as long as making a few pairs.
_PAIRS_PER_WORKER = 8


def _range(_: click.Context, __: click.Parameter, text: str | None) -> range | None:
    if text is None:
        return None
    parts = re.fullmatch(r"([0-9]{1,9})(?:-([0-9]{1,9}))?", text)
    shards = range(int(parts[1]), int(parts[2] or parts[1]) + 1) if parts else range(0)
    if not shards:
        raise click.BadParameter(f"expected a number, or two in ascending order such as 100-199, got {text!r}")
    return shards


@click.command(cls=Command)
@scene_options
@option(
    "--out",
    metavar="DIR_OR_ADDRESS",
    help="Folder to write to, or an address such as s3://bucket/name.  [default: out/CONFIG_NAME]",
)
@option(
    "--layout",
    metavar="NAME",
    help=f"Folders, names and encodings of the files: {', '.join(BUILT_IN['layouts'])}, or a plug-in's.  "
    "[default: the config's, else middlebury, or webdataset from 10,000 pairs on]",
)
@option(
    "--outputs",
    callback=split(click.Choice((*OUTPUTS, "none"))),
    metavar="a,b",
    help=f"What to write besides images and disparities: {', '.join(OUTPUTS)}; or none.  [default: the config's]",
)
@option("--pairs", type=NATURAL, default=24, help="Number of training pairs.")
@option(
    "--validation", type=NATURAL, default=0, help="Number of validation pairs; no other split has their photographs."
)
@option("--test", type=NATURAL, default=0, help="Number of test pairs; no other split has their photographs.")
@option(
    "--engine",
    type=click.Choice(("serial", "local", "ray")),
    help="Where to make the shards. serial: in this process; local: in processes of this machine; ray: on the Ray "
    "cluster of $RAY_ADDRESS, or a local one.  [default: local if there is work for several workers, else serial]",
)
@option(
    "--workers",
    type=click.IntRange(min=1, max=MOST_WORKERS),
    help="Number of processes of the engine local; it does not change the files.  [default: one for each core, but "
    f"at most one for every {_PAIRS_PER_WORKER} pairs, and at least one for each of --gpus]",
)
@option(
    "--gpus",
    callback=split(click.IntRange(min=0, max=9999)),
    metavar="A,B",
    help="CUDA's numbers of the GPUs. Each worker uses one of them, in turn.",
)
@option(
    "--gpu-share",
    type=click.FloatRange(min=0, max=MOST_WORKERS),
    default=0.0,
    help="Number of GPUs for each Ray task; with a fraction, several tasks share a GPU.",
)
@option(
    "--shard-pairs",
    type=COUNT,
    help="Number of pairs in a shard.  [default: 64, or fewer in a small dataset; rounded up to whole sequences]",
)
@option(
    "--shards",
    callback=_range,
    metavar="A-B",
    help="Make only these shards, counted from 0, to share the work among machines.",
)
@option("--overwrite", is_flag=True, help="Replace the dataset in --out, with all files in its folders.")
def generate(
    config_name: str,
    images: tuple[str, ...],
    models: tuple[str, ...],
    settings: tuple[str, ...],
    out: str | None,
    outputs: tuple[str, ...] | None,
    pairs: int,
    validation: int,
    test: int,
    engine: str | None,
    workers: int | None,
    gpus: tuple[int, ...] | None,
    gpu_share: float,
    **options: Any,  # noqa: ANN401 - of the function that generates
) -> None:
    """Write a dataset: images, disparities, masks and calibration.

    Ctrl-C stops the run; complete shards stay. After that, or if the run was killed, the same command makes only the
    missing shards. With more --pairs, the dataset grows.

    The layout decides which loaders can read the files; docs/output.md lists all layouts. In the config, the section
    "files" chooses encodings. Flow leads to the next frame, which is a pair of the dataset only if sequence.length is 2
    or more.
    """
    # Imported here: help and completion need no renderer.
    from semisynth_gl.dataset.generate import generate as generate_dataset  # noqa: PLC0415

    names = ", ".join(name for name in outputs or () if name != "none")
    config = scene_config(config_name, images, models, settings, *[f"outputs=[{names}]"] * (outputs is not None))
    counts: dict[SplitName, int] = {"train": pairs, "validation": validation, "test": test}
    with Progress() as progress:
        result = generate_dataset(
            config,
            out if out is not None else f"out/{config.name}",
            counts,
            engine=_open_engine(engine, workers, gpus, gpu_share, sum(counts.values())),
            # In each Ray task, its GPU has the number 0.
            gpus=gpus or ((0,) if gpu_share else ()),
            listener=progress,
            **options,
        )
    if result.missing:
        shards = counted(len(result.plan.shards), "shard")
        click.echo(
            f"{result.missing} of {shards} still missing. The run that makes the last one finishes the dataset.",
            err=True,
        )
        click.echo(f"the requested shards are in {result.root}")
        return
    click.echo(f"{counted(sum(result.plan.pairs.values()), 'pair')} in {result.root}")
    click.echo(f"To look at the images: semisynth-gl report {shlex.quote(str(result.root))}", err=True)


def _open_engine(
    name: str | None, workers: int | None, gpus: tuple[int, ...] | None, gpu_share: float, pairs: int
) -> "Engine":
    """Return the engine for a total number of pairs; refuse options that it would ignore."""
    # Imported here: help and completion need no renderer.
    from semisynth_gl.dataset.cluster import RayEngine  # noqa: PLC0415
    from semisynth_gl.dataset.engines import LocalEngine, SerialEngine, cores  # noqa: PLC0415

    if name == "ray":
        if workers is not None or gpus:
            raise InputError("--workers and --gpus are for --engine local; for ray, use --gpu-share")
        return RayEngine(gpus=gpu_share)
    if gpu_share:
        raise InputError("--gpu-share is for --engine ray")
    if name == "serial" and (workers or 1) > 1:
        raise InputError("--workers is for --engine local, not for serial")
    least = len(gpus or (0,))
    count = 1 if name == "serial" else workers or max(least, min(cores(), pairs // _PAIRS_PER_WORKER))
    if count < least:
        raise InputError(f"--gpus: expected one GPU per worker at most, got {least} for {counted(count, 'worker')}")
    return SerialEngine() if name == "serial" or (name is None and count == 1) else LocalEngine(count)
