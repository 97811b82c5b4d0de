"""Errors and costs of the rendered disparity, of the encodings of disparity, and of antialiasing.

config -> scenes -> {truth, encodings, antialiasing} -> report, a dictionary of JSON's types -> table
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from math import isfinite
from typing import Any

import numpy as np

from semisynth_gl.bench.antialias import DEFAULT_MODE, REFERENCE, measure_modes
from semisynth_gl.bench.encodings import DEFAULT_DISPARITY_ENCODING, measure_encodings, offered_encodings
from semisynth_gl.bench.scenes import BenchScenes, SampledTruth, cast_truth, sample_scenes
from semisynth_gl.bench.summary import error_stats, machine_facts, markdown
from semisynth_gl.config import Config
from semisynth_gl.frame.camera import EYES
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.errors import counted
from semisynth_gl.listener import Listener
from semisynth_gl.render.backends import Backend


@dataclass(frozen=True, slots=True)
class Effort:
    """How many pairs are measured, with how many rays for each eye, and how often each alternative is timed."""

    pairs: int = 3
    rays: int = 20_000
    repeats: int = 7


def measure(
    config: Config, seed: int, backend: Backend, effort: Effort, listener: Listener | None = None
) -> dict[str, Any]:
    """Measure everything; the listener hears a message at the start of each part.

    Returns:
        A report in JSON's types: the keys of `scene_facts`; "machine", a dictionary; "disparity", the renderer's error
        as of `error_stats`; and in "store" and "antialias" a `section` each, on encodings of disparities and
        antialiasing modes.

    Raises:
        SemisynthError: where the config or OpenGL cannot be used.
    """
    listener = listener or Listener()
    listener.on_message(f"making {counted(effort.pairs, 'scene')} of {config.name}")
    bench = sample_scenes(config, seed, effort.pairs)
    with bench.open_renderer(backend, outputs=("instances",), truth="both") as renderer:
        frames, driver = [renderer.render(scene) for scene in bench.scenes], renderer.facts
    listener.on_message(f"casting {counted(effort.rays, 'ray')} for each eye of each pair")
    truths, outlines = cast_truth(bench, frames, effort.rays, np.random.default_rng(seed))
    drawn = [frames[part.scene].view(part.eye).disparity[part.row, part.column] for part in truths]
    error = error_stats(np.concatenate(drawn), np.concatenate([part.disparity_px for part in truths]))
    listener.on_message("encodings of disparities")
    maps = [frame.view(eye).disparity for frame in frames for eye in EYES]
    offered = offered_encodings(signed=config.disparity.signed)
    stored = measure_encodings(maps, offered, DEFAULT_DISPARITY_ENCODING, effort.repeats)
    listener.on_message("antialiasing")
    modes, modes_left_out = measure_modes(bench, outlines, backend, effort.repeats)
    return {
        **scene_facts(bench, seed, effort, frames, truths),
        "machine": machine_facts() | driver,
        "disparity": plain(error),
        "store": section(DEFAULT_DISPARITY_ENCODING, {}, stored),
        "antialias": section(DEFAULT_MODE, modes_left_out, modes) | {"reference": REFERENCE},
    }


def scene_facts(
    bench: BenchScenes, seed: int, effort: Effort, frames: Sequence[Frame], truths: Sequence[SampledTruth]
) -> dict[str, Any]:
    """Describe the measured scenes: config, seed, effort, sizes, disparities, and how many pixels met the oracle.

    Sizes are (width, height), without repetition. "pixels_left_out" counts the chosen pixels that were not compared.
    """
    disparity = np.concatenate([frame.view(eye).disparity.ravel() for frame in frames for eye in EYES])
    disparity = disparity[np.isfinite(disparity)]
    return {
        "config": bench.config.name,
        "config_sha256": bench.config.digest(),
        "seed": seed,
        **asdict(effort),
        "sizes_px": sorted({(scene.camera.width_px, scene.camera.height_px) for scene in bench.scenes}),
        "disparity_px": {
            "median": float(np.median(disparity)) if disparity.size else None,
            "largest": float(disparity.max()) if disparity.size else None,
        },
        "pixels_compared": sum(len(part.disparity_px) for part in truths),
        "pixels_left_out": sum(part.dropped for part in truths),
    }


def section(default: str, left_out: Mapping[str, str], rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return a section of the report in JSON's types.

    Args:
        default: the name of the default alternative.
        left_out: by the name of an alternative, the reason why it could not be measured.
        rows: a row of each measured alternative.
    """
    return {"default": default, "left_out": dict(left_out), "rows": [plain(row) for row in rows]}


def plain(value: Any) -> Any:  # noqa: ANN401 - any of JSON's types
    """Replace NaN and infinity, which JSON lacks, by None, in a number or in the values of nested mappings."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    return None if isinstance(value, float) and not isfinite(value) else value


def headline(report: Mapping[str, Any]) -> str:
    """Return a line that names the scenes and the machine of a report."""
    machine, (width, height) = report["machine"], report["sizes_px"][0]
    return (
        f"{report['config']}, {width} x {height} px, {counted(report['pairs'], 'pair')}; {machine['renderer']}, "
        f"{machine['opengl']}; {machine['processor']}, {counted(machine['cores'], 'core')}; {machine['date']}"
    )


def table(report: Mapping[str, Any]) -> str:
    """Return a report in Markdown, with a table for each of its sections.

    A star marks the alternatives on the front, and the default is bold.
    """
    sections = [name for name in _COLUMNS if name in report]
    parts = [_disparity_text(report)] if "disparity" in report else []
    for name in sections:
        head, cells = _COLUMNS[name]
        rows = [
            (*_common_cells(row, report[name]["default"]), *cells(row), row["text"]) for row in report[name]["rows"]
        ]
        parts.append(markdown((head[0], "ms a pair", "x", *head[1:], "what it is"), rows))
    reasons = {name: reason for part in sections for name, reason in report[part]["left_out"].items()}
    return "\n\n".join([*parts, *(f"{name} left out: {reason}" for name, reason in reasons.items())])


def _disparity_text(report: Mapping[str, Any]) -> str:
    median, p999, worst = _errors(report["disparity"])
    return (
        f"Disparity against float64 rays, {report['pixels_compared']} pixels ({report['pixels_left_out']} more lie "
        f"near an edge): median error {median} px, 99.9 % {p999} px, worst {worst} px."
    )


def _common_cells(row: Mapping[str, Any], default: str) -> tuple[str, str, str]:
    name = f"**{row['name']}**" if row["name"] == default else row["name"]
    return f"{name} *" if row["on_front"] else name, f"{1e3 * row['seconds_per_pair']:.1f}", f"{row['time_ratio']:.2f}"


def _file_cost(row: Mapping[str, Any]) -> tuple[str, str]:
    return f"{1e3 * row['read_seconds_per_pair']:.1f}", f"{row['bytes_per_pair'] / 1e3:.0f}"


def _errors(error: Mapping[str, Any]) -> tuple[str, str, str]:
    median, p999, worst = (_number(error[key], ".1e") for key in ("median_px", "p999_px", "worst_px"))
    return median, p999, f"{worst}, {error['missing']} missing" if error["missing"] else worst


def _number(value: float | None, style: str) -> str:
    if value is None:
        return "-"
    return "0" if value == 0 else format(value, style)


_Cells = Callable[[Mapping[str, Any]], tuple[str, ...]]
_ERROR_HEAD = ("median, px", "p99.9, px", "worst, px")
_FILE_HEAD = ("ms to read", "kB a pair")
# By section, the heads of its own columns and a function that returns their cells. All tables also have columns for the
# name, the time and the description; the first head stands over the names.
_COLUMNS: Mapping[str, tuple[tuple[str, ...], _Cells]] = {
    "get": (("to get disparity", *_ERROR_HEAD), lambda row: _errors(row["error"])),
    "store": (
        ("to store disparity", *_FILE_HEAD, *_ERROR_HEAD),
        lambda row: (*_file_cost(row), *_errors(row["error"])),
    ),
    "antialias": (
        ("to antialias", "PSNR, dB", "at outlines", "inside"),
        lambda row: tuple(_number(row[key], ".1f") for key in ("psnr_db", "psnr_outline_db", "psnr_inside_db")),
    ),
}
