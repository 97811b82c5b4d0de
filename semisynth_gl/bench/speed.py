"""Pairs per second, by stages of a pair and by number of workers."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from semisynth_gl.bench.summary import machine_facts, markdown
from semisynth_gl.bench.workers import measure_workers
from semisynth_gl.config import Config
from semisynth_gl.dataset.engines import cores
from semisynth_gl.inputs.errors import counted
from semisynth_gl.listener import Listener
from semisynth_gl.render.backends import Backend


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is measured: the options of ``bench speed``. Empty ``workers`` stand for `usual_workers`."""

    pairs: int = 8
    repeats: int = 3
    workers: tuple[int, ...] = ()


def usual_workers() -> tuple[int, ...]:
    """Return the powers of two up to the number of usable cores, and that number, in ascending order."""
    most = cores()
    return tuple(sorted({2**power for power in range(most.bit_length()) if 2**power <= most} | {most}))


def measure(
    config: Config, seed: int, backend: Backend, effort: Effort, listener: Listener | None = None
) -> dict[str, Any]:
    """Measure; the listener hears what is measured.

    Returns:
        A report in JSON's types: config, seed, effort, "machine", and "stages", "passes", "limit" and "workers" as of
        `measure_workers`.

    Raises:
        SemisynthError: where the config or OpenGL cannot be used.
    """
    counts = effort.workers or usual_workers()
    rounds = (effort.repeats + 1) // 2
    if listener is not None:
        listener.on_message(f"stages, and {', '.join(map(str, counts))} workers, in {counted(rounds, 'round')}")
    sections, facts = measure_workers(config, seed, backend, counts, effort.pairs, rounds)
    return {
        "config": config.name,
        "config_sha256": config.digest(),
        "seed": seed,
        "size_px": [config.camera.width_px, config.camera.height_px],
        "pairs": effort.pairs,
        "repeats": effort.repeats,
        "rounds": rounds,
        "machine": machine_facts() | {"usable_cores": cores()} | facts,
        **sections,
    }


def headline(report: Mapping[str, Any]) -> str:
    """Return a line that names the scenes and the machine of a report."""
    machine, (width, height) = report["machine"], report["size_px"]
    return (
        f"{report['config']}, {width} x {height} px; {machine['renderer']}, {machine['opengl']}; "
        f"{machine['processor']}, {counted(machine['usable_cores'], 'core')}; Python {machine['python']}; "
        f"{machine['date']}"
    )


def table(report: Mapping[str, Any]) -> str:
    """Return a report in Markdown: tables, and sentences where a table would have only one row."""
    stages, workers = (report[name]["rows"] for name in ("stages", "workers"))
    parts = [
        markdown(
            ("stage", "ms a pair", "ms of CPU", "share", "MB a pair", "pairs/s alone", "what it is"),
            [
                (row["name"], f"{1e3 * row['seconds']:.1f}", f"{1e3 * row['cpu_seconds']:.1f}",
                 f"{100 * row['share']:.0f} %", _megabytes(row["bytes_per_pair"]), f"{row['allows_per_second']:.3g}",
                 row["text"])
                for row in stages
            ],
        ),
        *(_passes(report["passes"]) if "passes" in report else []),
        limit_text(report),
        markdown(
            ("workers", "threads each", "pairs", "pairs/s", "x"),
            [
                (row["name"], str(row["threads"]), str(row["pairs"]), f"{row['pairs_per_second']:.2f}",
                 f"{row['ratio']:.2f}")
                for row in workers
            ],
            text_last=False,
        ),
    ]  # fmt: skip
    return "\n\n".join(parts)


def limit_text(report: Mapping[str, Any]) -> str:
    """Return sentences on the slowest stage, the limit of pairs per second, and the share of it that was reached."""
    limit = report["limit"]
    workers = f"{limit['workers']} workers make" if limit["workers"] > 1 else "1 worker makes"
    text = (
        f"The narrowest stage is {limit['narrowest_stage']}: alone, {counted(limit['cores'], 'core')} would do it for "
        f"{limit['narrowest_allows_per_second']:.3g} pairs/s. The limit is set by the {limit['by']}: "
        f"{limit['allows_per_second']:.3g} pairs/s. {workers} {limit['reached_per_second']:.3g} pairs/s from start to "
        f"end"
    )
    shares = [100 * share for share in limit["shares"]]
    if len(shares) == 1:
        return f"{text}. One round is too rough to compare that with the limit: measure with --repeats 3 or more."
    return (
        f"{text}, {100 * limit['share']:.0f} % of the limit (median of {len(shares)} rounds, from {min(shares):.0f} to "
        f"{max(shares):.0f} %)."
    )


def _passes(passes: Mapping[str, Any]) -> list[str]:
    rows = [(f"{row['name']}, {row['eye']}", f"{1e3 * row['seconds']:.2f}", row["text"]) for row in passes["rows"]]
    clock = "by the GPU's own clock (timer queries), without a wait between them."
    if not passes["queries"]:
        clock = "in CPU time, each finished before the next begins: timer queries of software are not to be trusted."
    return [markdown(("pass", "ms a pair", "what it is"), rows), f"Passes {clock}"]


def _megabytes(count: float | None) -> str:
    return "-" if count is None else f"{count / 1e6:.1f}"
