"""``semisynth-gl bench``."""

import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import click

from semisynth_gl.bench.summary import headline
from semisynth_gl.cli.options import (
    COUNT,
    MOST_WORKERS,
    SEED,
    Callback,
    Command,
    backend_option,
    option,
    options,
    set_option,
)
from semisynth_gl.cli.outputs import OutputFileType, write_json
from semisynth_gl.cli.progress import Progress
from semisynth_gl.config import load_config


@click.group()
def bench() -> None:
    """Measure accuracy and speed on this machine."""


def _bench_options(config: str) -> Callable[[Callback], Callback]:
    """Return a decorator that adds the options of both commands; ``config`` is the default config."""
    return options(
        option("--config", "config_name", default=config, help="A packaged config or a YAML file."),
        set_option,
        option("--seed", type=SEED, default=0, help="Seed of the scenes; each seed makes different scenes."),
        backend_option,
        option("--json", "json_file", type=OutputFileType(), help="JSON file for the full report."),
    )


def _run(name: str, config_name: str, settings: tuple[str, ...], json_file: Path | None, **options: Any) -> None:  # noqa: ANN401 - of the benchmark
    """Measure with a module of `semisynth_gl.bench`; print its report, and write it as JSON."""
    benchmark = import_module(f"semisynth_gl.bench.{name}")  # other commands need no renderer
    report = benchmark.measure(load_config(config_name, settings), **options, listener=Progress())
    report["command"] = " ".join(["semisynth-gl", *sys.argv[1:]])
    write_json(json_file, report)
    click.echo(f"{headline(report)}\n\n{benchmark.table(report)}")


@bench.command(cls=Command)
@_bench_options("eth3d")
@option("--pairs", type=COUNT, default=3, help="Number of pairs to measure.")
@option("--rays", type=COUNT, default=20_000, help="Rays cast for each eye of a pair.")
def accuracy(**options: Any) -> None:  # noqa: ANN401 - click's
    """Compare the disparity with float64 rays, away from edges, and print its error."""
    _run("accuracy", **options)


@bench.command(cls=Command)
@_bench_options("middlebury")
@option("--pairs", type=COUNT, default=8, help="Pairs to time with each number of workers; at least 4 for each worker.")
@option(
    "--workers",
    type=click.IntRange(1, MOST_WORKERS),
    multiple=True,
    help="Number of workers. May be repeated.  [default: powers of two up to all cores]",
)
def speed(**options: Any) -> None:  # noqa: ANN401 - click's
    """Time each stage of a pair, and count pairs per second by number of workers. Run it on an idle machine."""
    _run("speed", **options)
