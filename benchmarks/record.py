"""Repeat measurements that docs/accuracy.md and docs/performance.md quote, and write them to benchmarks/results.

    python benchmarks/record.py alternatives   # measure again, write results/alternatives.json and .md
    python benchmarks/record.py --pages        # write all pages again from the JSON in results

Run it on an idle machine.
"""

import json
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import alternatives
import click

from semisynth_gl.bench import speed
from semisynth_gl.bench.summary import headline

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
sys.path.append(str(ROOT / "benchmarks" / "peers"))

import run as peers  # noqa: E402 - needs the path above


@dataclass(frozen=True, slots=True)
class Result:
    """A measurement.

    Attributes:
        title: heading of the page.
        text: description of the measurement and of the columns.
        command: arguments of Python, without ``--json FILE``.
        headline: returns a line on scenes and machine of a report.
        table: returns a report as Markdown.
    """

    title: str
    text: str
    command: tuple[str, ...]
    headline: Callable[[Mapping[str, Any]], str]
    table: Callable[[Mapping[str, Any]], str]


def _peers_headline(report: Mapping[str, Any]) -> str:
    machine, scene = report["machine"], report["scene"]
    width, height = scene["size_px"]
    return (
        f"{width} x {height} px, {scene['instances']} instances of {scene['triangles_per_instance']} triangles each, "
        f"{report['rounds']} rounds of {scene['frames']} pairs; {machine['processor']}, {machine['cores']} cores; "
        f"{machine['date']}"
    )


_ALTERNATIVES = """\
The default is bold. A star marks the Pareto front of time and error, where differences up to 5 % are ties. Times are
medians over the turns. The column x is the median ratio to the default's time in the same turn.

Errors of the disparity are measured against float64 rays away from edges; the stars use the error at 99.9 %.
Antialiasing is timed on pairs with both disparities, without masks. PSNR is against 64 samples per pixel: over all
pixels, over pixels within 1 px of a different instance, and over the rest."""
_SPEED = """\
Stages: one thread, and the driver finishes each one before the next begins.

Workers: whole runs with files, while all workers are busy. *threads each* is the number of llvmpipe's threads in each
worker; with 0, it draws in the calling thread."""
_PEERS = """\
Each renderer writes left and right PNG and the left float32 disparity. The renderers take turns, each with its fastest
numbers of processes and threads. Times are medians over the rounds. Details: [peers/README.md](../peers/README.md)."""
_PEER_ROWS = ("--variants", "edges,msaa4,ssaa2,all,none,workbench")
MEASUREMENTS: Mapping[str, Result] = {
    "alternatives": Result(
        "Speed against error", _ALTERNATIVES, ("benchmarks/alternatives.py",), headline, alternatives.table
    ),
    "alternatives-middlebury": Result(
        "Speed against error, `middlebury`", _ALTERNATIVES,
        ("benchmarks/alternatives.py", "--config", "middlebury", "--pairs", "2"), headline, alternatives.table,
    ),
    "speed": Result(
        "Speed", _SPEED, ("-m", "semisynth_gl", "bench", "speed", "--pairs", "24"), headline, speed.table
    ),
    "peers": Result(
        "Renderers side by side", _PEERS, ("benchmarks/peers/run.py", *_PEER_ROWS), _peers_headline, peers.table
    ),
}  # fmt: skip


def page(name: str, report: Mapping[str, Any]) -> str:
    """Return the page of a measurement, given its report."""
    result = MEASUREMENTS[name]
    parts = [
        f"# {result.title}",
        "The command repeats the measurements and rewrites this page. Run no other program while it measures:",
        f"    python benchmarks/record.py {name}",
        f"All numbers are in [{name}.json]({name}.json); they were measured with `{report['command']}`.",
        *([report["note"]] if "note" in report else []),
        f"{result.headline(report)}.",
        result.text,
        result.table(report),
    ]
    return "\n\n".join(parts) + "\n"


@click.command()
@click.argument("names", nargs=-1, type=click.Choice(list(MEASUREMENTS)))
@click.option("--pages", is_flag=True, help="Write all pages from the JSON in results.")
def main(names: tuple[str, ...], *, pages: bool) -> None:
    """Repeat the measurements NAMES, and write their JSON and pages."""
    for name in names:
        command = [sys.executable, *MEASUREMENTS[name].command, "--json", f"benchmarks/results/{name}.json"]
        subprocess.run(command, cwd=ROOT, check=True)
    for name in MEASUREMENTS if pages else names:
        report = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
        (RESULTS / f"{name}.md").write_text(page(name, report), encoding="utf-8")


if __name__ == "__main__":
    main()
