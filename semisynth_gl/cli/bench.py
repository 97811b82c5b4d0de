"""``semisynth-gl bench``: measures accuracy and speed on this machine."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import click

from semisynth_gl.cli.options import (
    COUNT,
    MOST_WORKERS,
    SEED,
    Callback,
    Command,
    ConfigName,
    option,
    option_group,
    set_option,
)
from semisynth_gl.cli.outputs import OutputFile, write_json
from semisynth_gl.config import load_config
from semisynth_gl.listener import Listener
from semisynth_gl.render.backends import BACKENDS, Backend


@click.group()
def bench() -> None:
    """Measure accuracy and speed on this machine."""


@dataclass(frozen=True, slots=True)
class _BenchOptions:
    """The options that ``bench accuracy`` and ``bench speed`` share."""

    config_name: str
    settings: tuple[str, ...]
    seed: int
    backend: Backend

    def run(self, benchmark: ModuleType, effort: Any, json_file: Path | None) -> None:  # noqa: ANN401 - each benchmark has its own
        """Measure with a benchmark module and its ``Effort``; print the report, and write it as JSON."""
        config = load_config(self.config_name, self.settings)
        report = benchmark.measure(config, self.seed, self.backend, effort, _Parts())
        report["command"] = " ".join(["semisynth-gl", *sys.argv[1:]])
        if json_file is not None:
            write_json(json_file, report)
        click.echo(f"{benchmark.headline(report)}\n\n{benchmark.table(report)}")


def _bench_options(config: str) -> Callable[[Callback], Callback]:
    """Return a decorator for the shared options, with a default config, and for --json of a bench command."""
    options = option_group(
        "options",
        _BenchOptions,
        option(
            "--config",
            "config_name",
            type=ConfigName(),
            default=config,
            help="Scenes to measure: a packaged config or a YAML file.",
        ),
        set_option(),
        option("--seed", type=SEED, default=0, help="Seed of the scenes; another seed makes other scenes."),
        option(
            "--backend",
            type=click.Choice(BACKENDS),
            default="auto",
            help="egl: a GPU, or llvmpipe; osmesa: Mesa's off-screen renderer; auto: the first that works.",
        ),
    )
    report = option("--json", "json_file", type=OutputFile(), help="Also write the full report to this JSON file.")
    return lambda callback: options(report(callback))


class _Parts(Listener):
    """Shows each part of a measurement as it begins."""

    def on_message(self, text: str) -> None:
        click.echo(f"{text} ...", err=True)


@bench.command(cls=Command)
@_bench_options("eth3d")
@option("--pairs", type=COUNT, default=3, help="Number of pairs to measure.")
@option("--rays", type=COUNT, default=20_000, help="Rays cast for each eye of a pair.")
def accuracy(options: _BenchOptions, json_file: Path | None, pairs: int, rays: int) -> None:
    """Compare the disparity with float64 rays, away from edges, and print its error."""
    from semisynth_gl.bench import accuracy as benchmark  # noqa: PLC0415 - other commands need no renderer

    options.run(benchmark, benchmark.Effort(pairs, rays), json_file)


def _numbers(_: click.Context, __: click.Parameter, text: str | None) -> tuple[int, ...]:
    """Read numbers of workers such as "1,2,4"; return an empty tuple where the option is not given."""
    if text is None:
        return ()
    try:
        numbers = tuple(int(word) for word in text.split(","))
    except ValueError:
        numbers = (0,)
    if not (min(numbers) >= 1 and max(numbers) <= MOST_WORKERS):
        fault = f"expected whole numbers from 1 to {MOST_WORKERS}, separated by commas, got {text}"
        raise click.BadParameter(fault)
    return numbers


@bench.command(cls=Command)
@_bench_options("middlebury")
@option(
    "--pairs", type=COUNT, default=8, help="Pairs in a round of each number of workers; at least 4 for each worker."
)
@option("--repeats", type=COUNT, default=2, help="How often the stages and each number of workers are timed.")
@option(
    "--workers", callback=_numbers, metavar="N,N", help="Numbers of workers.  [default: powers of two up to all cores]"
)
def speed(options: _BenchOptions, json_file: Path | None, pairs: int, repeats: int, workers: tuple[int, ...]) -> None:
    """Measure pairs per second, and what limits them.

    Measures each stage of a pair, and whole runs with several numbers of workers. Let the machine do nothing else
    meanwhile.
    """
    from semisynth_gl.bench import speed as benchmark  # noqa: PLC0415 - other commands need no renderer

    options.run(benchmark, benchmark.Effort(pairs, repeats, workers), json_file)
