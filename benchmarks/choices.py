"""Measure what each encoding of disparities and each antialiasing mode costs and gains.

    python benchmarks/choices.py --json choices.json

A table for each; the default is bold, and a star marks alternatives that no other one dominates.
"""

import json
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from antialias_modes import DEFAULT_MODE, REFERENCE, measure_modes
from disparity_encodings import DEFAULT_DISPARITY_ENCODING, measure_encodings, offered_encodings

from semisynth_gl.bench import accuracy
from semisynth_gl.bench.accuracy import disparity_error, errors_text, headline, number_text, plain, scene_facts
from semisynth_gl.bench.scenes import cast_truth, sample_scenes
from semisynth_gl.bench.summary import machine_facts, markdown
from semisynth_gl.config import Config, load_config
from semisynth_gl.frame.camera import EYES
from semisynth_gl.render.backends import BACKENDS, Backend


def measure(config: Config, seed: int, backend: Backend, pairs: int, rays: int, repeats: int) -> dict[str, Any]:
    """Measure; the report is that of `bench accuracy` with a `section` each under "store" and "antialias"."""
    bench = sample_scenes(config, seed, pairs)
    with bench.open_renderer(backend, outputs=("instances",), truth="both") as renderer:
        frames, driver = [renderer.render(scene) for scene in bench.scenes], renderer.facts
    truths, outlines = cast_truth(bench, frames, rays, np.random.default_rng(seed))
    maps = [frame.view(eye).disparity for frame in frames for eye in EYES]
    offered = offered_encodings(signed=config.disparity.signed)
    stored = measure_encodings(maps, offered, DEFAULT_DISPARITY_ENCODING, repeats)
    modes, modes_left_out = measure_modes(bench, outlines, backend, repeats)
    return {
        **scene_facts(bench, seed, truths),
        "machine": machine_facts() | driver,
        "disparity": disparity_error(frames, truths),
        "store": section(DEFAULT_DISPARITY_ENCODING, {}, stored),
        "antialias": section(DEFAULT_MODE, modes_left_out, modes) | {"reference": REFERENCE},
    }


def section(default: str, left_out: Mapping[str, str], rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return a section of the report in JSON's types.

    Args:
        default: the name of the default alternative.
        left_out: by the name of an alternative, the reason why it could not be measured.
        rows: a row of each measured alternative.
    """
    return {"default": default, "left_out": dict(left_out), "rows": [plain(row) for row in rows]}


def table(report: Mapping[str, Any]) -> str:
    """Return a report in Markdown, with a table for each of its sections.

    A star marks the alternatives on the front, and the default is bold.
    """
    sections = [name for name in _COLUMNS if name in report]
    parts = [accuracy.table(report)] if "disparity" in report else []
    for name in sections:
        head, cells = _COLUMNS[name]
        rows = [
            (*_common_cells(row, report[name]["default"]), *cells(row), row["text"]) for row in report[name]["rows"]
        ]
        parts.append(markdown((head[0], "ms a pair", "x", *head[1:], "what it is"), rows))
    reasons = {name: reason for part in sections for name, reason in report[part]["left_out"].items()}
    return "\n\n".join([*parts, *(f"{name} left out: {reason}" for name, reason in reasons.items())])


def _common_cells(row: Mapping[str, Any], default: str) -> tuple[str, str, str]:
    name = f"**{row['name']}**" if row["name"] == default else row["name"]
    return f"{name} *" if row["on_front"] else name, f"{1e3 * row['seconds_per_pair']:.1f}", f"{row['time_ratio']:.2f}"


def _file_cost(row: Mapping[str, Any]) -> tuple[str, str]:
    return f"{1e3 * row['read_seconds_per_pair']:.1f}", f"{row['bytes_per_pair'] / 1e3:.0f}"


_Cells = Callable[[Mapping[str, Any]], tuple[str, ...]]
_ERROR_HEAD = ("median, px", "p99.9, px", "worst, px")
_FILE_HEAD = ("ms to read", "kB a pair")
# For each section: the heads of its columns, and a function that returns a row's cells. All tables also have columns
# for the name, the time and the description; the first head stands over the names.
_COLUMNS: Mapping[str, tuple[tuple[str, ...], _Cells]] = {
    "get": (("to get disparity", *_ERROR_HEAD), lambda row: errors_text(row["error"])),
    "store": (
        ("to store disparity", *_FILE_HEAD, *_ERROR_HEAD),
        lambda row: (*_file_cost(row), *errors_text(row["error"])),
    ),
    "antialias": (
        ("to antialias", "PSNR, dB", "at outlines", "inside"),
        lambda row: tuple(number_text(row[key], ".1f") for key in ("psnr_db", "psnr_outline_db", "psnr_inside_db")),
    ),
}


@click.command(help=__doc__.splitlines()[0])
@click.option("--config", "name", default="eth3d", show_default=True)
@click.option("--set", "settings", multiple=True, metavar="dotted.key=value")
@click.option("--seed", default=0, show_default=True)
@click.option("--backend", type=click.Choice(BACKENDS), default="auto", show_default=True)
@click.option("--pairs", default=3, show_default=True)
@click.option("--rays", default=20_000, show_default=True, help="Rays cast for each eye of a pair.")
@click.option("--repeats", default=7, show_default=True)
@click.option("--json", "out", type=Path, help="Also write the report here.")
def main(
    *, name: str, settings: tuple[str, ...], seed: int, backend: Backend, pairs: int, rays: int, repeats: int,
    out: Path | None,
) -> None:  # fmt: skip
    """Measure, and print the tables."""
    report = measure(load_config(name, settings), seed, backend, pairs, rays, repeats)
    report["command"] = shlex.join(["python", "benchmarks/choices.py", *sys.argv[1:]])
    if out is not None:
        out.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    print(f"{headline(report)}\n\n{table(report)}")


if __name__ == "__main__":
    main()
