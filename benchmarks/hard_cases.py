"""Errors of the hard cases in tests/render/test_hard_cases.py that are compared with the oracle.

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
from semisynth_gl.render.backends import is_software
from semisynth_gl.render.devices import context_facts

ROOT = Path(__file__).resolve().parents[1]


def measure(backend: str) -> list[dict[str, Any]]:
    """Run the tests and return a row of each case: errors of both eyes at all pixels that were compared."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:xdist", "-k", backend]
        command.append("tests/render/test_hard_cases.py")
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
    """Lay a report out in Markdown."""
    return markdown(
        ("case", "pixels", "median, px", "99.9 %", "worst", "elsewhere", "visibility"),
        [
            (row["name"], str(row["pixels"]), *(f"{row[key]:.1e}" for key in ("median_px", "p999_px", "worst_px")),
             f"{100 * row['elsewhere']:.3f} %", f"{100 * row['visibility']:.2f} %")
            for row in report["rows"]
        ],
        text_last=False,
    )  # fmt: skip


@click.command()
@click.option("--backend", type=click.Choice(["egl", "osmesa"]), default="egl", show_default=True)
@click.option("--gpu", is_flag=True, help="Refuse a driver that draws on the processor.")
@click.option(
    "--json", "json_path", type=click.Path(dir_okay=False, path_type=Path), help="Also write everything here."
)
def main(backend: str, json_path: Path | None, *, gpu: bool) -> None:
    """Run the hard cases and print their errors."""
    driver = context_facts(backend)
    if gpu and is_software(driver.renderer):
        raise click.ClickException(f"--gpu: expected a GPU, but {driver.renderer} draws on the processor")
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
