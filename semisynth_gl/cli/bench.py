"""``semisynth-gl bench``: what the choices cost and gain on this machine."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from semisynth_gl.cli.options import Command
from semisynth_gl.config import load_config
from semisynth_gl.errors import InputError
from semisynth_gl.render.context import BACKENDS, Backend


@click.group()
def bench() -> None:
    """Measure, on this machine, what the choices cost and gain."""


def _shared_options(config: str) -> Callable[[Command], Command]:
    """Add --config, --set, --seed, --backend and --json."""
    options = [
        click.option(
            "--config", "config_name", default=config, show_default=True, help="Whose scenes: a name or a YAML file."
        ),
        click.option(
            "--set", "settings", multiple=True, metavar="dotted.key=value", help="Override a key of the config."
        ),
        click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Other scenes."),
        click.option(
            "--backend", type=click.Choice(BACKENDS), default="auto", show_default=True, help="As for generate."
        ),
        click.option("--json", "json_path", type=click.Path(path_type=Path), help="Also write everything here."),
    ]

    def add(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return add


@bench.command()
@_shared_options("eth3d")
@click.option("--pairs", type=click.IntRange(min=1), default=3, show_default=True, help="How many pairs.")
@click.option(
    "--rays", type=click.IntRange(min=1), default=20_000, show_default=True, help="Rays cast for each eye of a pair."
)
@click.option(
    "--repeats", type=click.IntRange(min=1), default=7, show_default=True, help="Times each alternative is timed."
)
def accuracy(
    config_name: str,
    settings: tuple[str, ...],
    seed: int,
    backend: Backend,
    json_path: Path | None,
    pairs: int,
    rays: int,
    repeats: int,
) -> None:
    """Compare the disparity with float64 rays, and encodings and antialiasing modes with each other.

    The error of the disparity, then a table each of encodings of disparities, encodings of images and antialiasing
    modes: time, bytes and error. The default is bold; a star marks alternatives that no other one dominates.
    """
    from semisynth_gl.bench import accuracy as benchmark  # noqa: PLC0415 - other commands need no renderer

    _check_place(json_path)
    config = load_config(config_name, settings)
    report = benchmark.measure(config, seed, backend, benchmark.Effort(pairs, rays, repeats), _say)
    _publish(report, benchmark.headline(report), benchmark.table(report), json_path)


def _numbers(_: click.Context, __: click.Parameter, text: str | None) -> tuple[int, ...]:
    """Read "1,2,4"."""
    if text is None:
        return ()
    try:
        numbers = tuple(int(word) for word in text.split(","))
    except ValueError:
        numbers = (0,)
    if min(numbers) < 1:
        raise click.BadParameter(f"expected whole numbers above 0 with commas between them, got {text}")
    return numbers


@bench.command()
@_shared_options("middlebury")
@click.option(
    "--pairs",
    type=click.IntRange(min=1),
    default=8,
    show_default=True,
    help="Pairs that each number of workers makes in a round; at least four each.",
)
@click.option(
    "--repeats",
    type=click.IntRange(min=1),
    default=3,
    show_default=True,
    help="Times each alternative is timed; workers and starts half as often.",
)
@click.option(
    "--workers",
    callback=_numbers,
    metavar="N,N",
    help="Numbers of workers.  [default: powers of two up to the cores]",
)
@click.option(
    "--memory-pairs",
    type=click.IntRange(min=1),
    default=40,
    show_default=True,
    help="Pairs that memory is followed over.",
)
@click.option("--no-stress", is_flag=True, help="Leave out the pair of 10,000 instances and 5 million triangles.")
def speed(
    config_name: str,
    settings: tuple[str, ...],
    seed: int,
    backend: Backend,
    json_path: Path | None,
    pairs: int,
    repeats: int,
    workers: tuple[int, ...],
    memory_pairs: int,
    no_stress: bool,  # noqa: FBT001 - click passes flags so
) -> None:
    """Measure pairs per second, what limits them, and what they depend on.

    Each stage of a pair alone; workers, from start to end; instances, triangles, pixels, antialiasing and outputs;
    memory; the time to the first pair. Let the machine do nothing else meanwhile.
    """
    from semisynth_gl.bench import speed as benchmark  # noqa: PLC0415 - other commands need no renderer

    _check_place(json_path)
    config = load_config(config_name, settings)
    effort = benchmark.Effort(pairs, repeats, workers, memory_pairs, stress=not no_stress)
    report = benchmark.measure(config, seed, backend, effort, _say)
    _publish(report, benchmark.headline(report), benchmark.table(report), json_path)


def _say(part: str) -> None:
    click.echo(f"{part} ...", err=True)


def _check_place(json_path: Path | None) -> None:
    """Refuse a file that cannot be written before anything is measured."""
    if json_path is not None and not json_path.absolute().parent.is_dir():
        raise InputError(f"--json {json_path}: the folder {json_path.absolute().parent} does not exist")


def _publish(report: dict[str, Any], headline: str, table: str, json_path: Path | None) -> None:
    """Write the report as JSON where a path is given, and print it."""
    report["command"] = " ".join(["semisynth-gl", *sys.argv[1:]])
    if json_path is not None:
        json_path.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    click.echo(f"{headline}\n\n{table}")
