"""``semisynth-gl bench``."""

import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import click

from semisynth_gl.bench.summary import headline
from semisynth_gl.cli.options import COUNT, MOST_WORKERS, Callback, Command, option, options, run_options
from semisynth_gl.cli.outputs import OutputFileType, write_json
from semisynth_gl.cli.progress import Progress
from semisynth_gl.config import load_config


@click.group()
def bench() -> None:
    """Measure accuracy and speed on this machine."""


def _bench_options(config: str) -> Callable[[Callback], Callback]:
    """Return a decorator that adds the options of both commands; ``config`` is the default config."""
    return options(
        option("--config", "config_name", default=config, metavar="NAME_OR_PATH", help="A YAML or packaged config."),
        run_options,
        option("--json", "json_file", type=OutputFileType(), help="JSON file for the full report."),
    )


def _run(name: str, config_name: str, settings: tuple[str, ...], json_file: Path | None, **options: Any) -> None:  # noqa: ANN401 - of the benchmark
    """Measure with a module of `semisynth_gl.bench`; print its report, and write it as JSON."""
    benchmark = import_module(f"semisynth_gl.bench.{name}")  # imported here: help needs no renderer
    report = benchmark.measure(load_config(config_name, settings), **options, listener=Progress())
    report["command"] = " ".join(["semisynth-gl", *sys.argv[1:]])
    write_json(json_file, report)
    click.echo(f"{headline(report)}\n\n{benchmark.table(report)}")


@bench.command(cls=Command)
@_bench_options("eth3d")
@option("--pairs", type=COUNT, default=3, help="Number of pairs to measure.")
@option("--rays", type=COUNT, default=20_000, help="Number of rays for each eye of a pair.")
def accuracy(**options: Any) -> None:  # noqa: ANN401 - click's
    """Compare disparities with float64 rays, except beside edges."""
    _run("accuracy", **options)


@bench.command(cls=Command)
@_bench_options("middlebury")
@option("--pairs", type=COUNT, default=8, help="Number of pairs to time, but at least 4 for each worker.")
@option(
    "--workers",
    type=click.IntRange(1, MOST_WORKERS),
    multiple=True,
    help="Number of workers. May be repeated.  [default: powers of two, and the number of cores]",
)
def speed(**options: Any) -> None:  # noqa: ANN401 - click's
    """Time the stages of a pair, and runs by number of workers. The machine should be idle."""
    _run("speed", **options)
