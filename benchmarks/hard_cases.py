"""Errors of the hard cases in tests/test_hard_cases.py that are compared with the oracle.

    python benchmarks/hard_cases.py --json hard-cases.json

The tests run on one backend, in a process of their own, and hand their errors over as files.
"""

import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
import numpy as np

from semisynth_gl.bench.summary import machine_facts, markdown
from semisynth_gl.render.devices import context_facts

ROOT = Path(__file__).resolve().parents[1]
# Cases that are compared with an equation.
EQUATIONS = """\
| case | bound that the test asserts |
|---|---|
| surfaces at 0.05 m and 10,000 m in one frame | 1e-4 px at 220 px; relative 1e-6 at 1.1e-3 px |
| two parallel surfaces a relative 1e-5 apart, either drawn first | all pixels show the nearer one, in both eyes |
| a scene 10^6 m from its origin | 99.9 % within 1e-5 px of the same scene at the origin |
| a watertight ball of 100k triangles | none of 100,000 pixels inside shows the wall behind |
| balls of 100k triangles, 4.5 to 15 px in radius | what they hide is hidden, but for one pixel at most |
| rods thinner, models smaller than a pixel | every pixel on one of the two depths within 1e-4 px |
| three coplanar faces | the first one wins everywhere, in both eyes and every time |
| disparity wider than the image | 150 px within 1e-4; all outside the other image |
| zero and negative disparity through doffs | invalid (inf), never clamped |
| baseline 0 | equal images, no valid disparity |
| 64x64, 941x489, 1x1, 3000x2000, 7680x4320 | a slanted plane within a relative 3e-6 |
| 200000x4 | refused, with the driver's limit |
| 0, 1 and 100,000 instances | drawn; 70,000 with 16-bit ids refused |
| patches of 1x1 and 8192x8192 | bit for bit at one texel per pixel |
| a transform of rank 0 | draws nothing, harms nothing |
| the peers' scene, 1500x1000, 100 objects | p99 within 3e-5 px, worst within 1e-3, ids as the oracle's in 99.95 % |"""


def measure(backend: str) -> list[dict[str, Any]]:
    """Run the tests and return a row of each case: errors of both eyes at all pixels that were compared."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:xdist", "-k", backend, "tests/test_hard_cases.py"]
        environment = os.environ | {"HARD_CASES_FOLDER": folder}
        code = subprocess.run(command, cwd=ROOT, env=environment, stdout=sys.stderr, check=False).returncode
        if code:
            raise SystemExit(code)
        cases: dict[str, list[Mapping[str, np.ndarray]]] = defaultdict(list)
        for path in sorted(Path(folder).iterdir()):
            with np.load(path) as arrays:
                parts = dict(arrays)
            name = re.sub(rf".*::test_(\w+)\[{backend}-?(.*)\].*", r"\1 \2", str(parts["test"]))
            cases[name.replace("_", " ").strip()].append(parts)
    return [_row(name, parts) for name, parts in cases.items()]


def _row(name: str, parts: list[Mapping[str, np.ndarray]]) -> dict[str, Any]:
    error = np.concatenate([part["error"][part["smooth"] & ~part["displaced"]] for part in parts])
    return {
        "name": name,
        "pixels": len(error),
        "median_px": float(np.median(error)),
        "p999_px": float(np.quantile(error, 0.999)),
        "worst_px": float(error.max()),
        "elsewhere": float(np.mean(np.concatenate([part["displaced"] for part in parts]))),
        "visibility": float(np.mean(np.concatenate([part["seen_alike"] for part in parts]))),
    }


def headline(report: Mapping[str, Any]) -> str:
    """Name the machine of a report."""
    machine = report["machine"]
    return f"{machine['renderer']}, {machine['opengl']}; {machine['processor']}; {machine['date']}"


def table(report: Mapping[str, Any]) -> str:
    """Lay a report out in Markdown, and below it the cases that are compared with an equation."""
    errors = markdown(
        ("case", "pixels", "median, px", "99.9 %", "worst", "elsewhere", "visibility"),
        [
            (row["name"], str(row["pixels"]), *(f"{row[key]:.1e}" for key in ("median_px", "p999_px", "worst_px")),
             f"{100 * row['elsewhere']:.3f} %", f"{100 * row['visibility']:.2f} %")
            for row in report["rows"]
        ],
        text_last=False,
    )  # fmt: skip
    return f"{errors}\n\n{EQUATIONS}"


@click.command()
@click.option("--backend", type=click.Choice(["egl", "osmesa"]), default="egl", show_default=True)
@click.option(
    "--json", "json_path", type=click.Path(dir_okay=False, path_type=Path), help="Also write everything here."
)
def main(backend: str, json_path: Path | None) -> None:
    """Run the hard cases and print their errors."""
    driver = context_facts(backend)
    report = {
        "command": shlex.join(["python", "benchmarks/hard_cases.py", *sys.argv[1:]]),
        "machine": machine_facts() | {"backend": driver.backend, "renderer": driver.renderer, "opengl": driver.version},
        "rows": measure(backend),
    }
    if json_path is not None:
        json_path.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    click.echo(f"{headline(report)}\n\n{table(report)}")


if __name__ == "__main__":
    main()
