"""``semisynth-gl bench``: measures accuracy, costs and speed on this machine."""

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
    """Measure accuracy and speed on this machine, and the cost of each choice."""


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
@option("--repeats", type=COUNT, default=7, help="How often each alternative is timed.")
def accuracy(options: _BenchOptions, json_file: Path | None, pairs: int, rays: int, repeats: int) -> None:
    """Compare the disparity with float64 rays, and encodings and antialiasing modes with each other.

    Prints the error of the disparity, then the time, size and error of disparity encodings, image encodings and
    antialiasing modes, in one table each. The default is bold; a star marks alternatives that no other one dominates.
    """
    from semisynth_gl.bench import accuracy as benchmark  # noqa: PLC0415 - other commands need no renderer

    options.run(benchmark, benchmark.Effort(pairs, rays, repeats), json_file)


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
@option(
    "--repeats", type=COUNT, default=3, help="How often each alternative is timed; workers and starts: half as often."
)
@option(
    "--workers", callback=_numbers, metavar="N,N", help="Numbers of workers.  [default: powers of two up to all cores]"
)
@option("--memory-pairs", type=COUNT, default=40, help="Number of pairs over which memory is measured.")
@option(
    "--no-stress", is_flag=True, help="Leave out the stress test: a pair of 10,000 instances and 5 million triangles."
)
def speed(
    options: _BenchOptions,
    json_file: Path | None,
    pairs: int,
    repeats: int,
    workers: tuple[int, ...],
    memory_pairs: int,
    no_stress: bool,
) -> None:
    """Measure pairs per second, what limits them, and what they depend on.

    Measures each stage of a pair; each drawing pass, by the GPU's own clock where a GPU draws; whole runs with several
    numbers of workers; the effect of instances, triangles, pixels, antialiasing and outputs; memory; and the time to
    the first pair. Let the machine do nothing else meanwhile.
    """
    from semisynth_gl.bench import speed as benchmark  # noqa: PLC0415 - other commands need no renderer

    effort = benchmark.Effort(pairs, repeats, workers, memory_pairs, stress=not no_stress)
    options.run(benchmark, effort, json_file)
