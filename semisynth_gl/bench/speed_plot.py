"""The plot of a report of `semisynth_gl.bench.speed`."""

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from semisynth_gl.bench.plot import label_axis
from semisynth_gl.bench.stages import PROCESSOR

_MAIN, _OTHER, _QUIET = "#1f5fa8", "#b5521b", "#8a8f98"


def draw_plot(report: Mapping[str, Any]) -> Figure:
    """Draw six panels: stages, workers, what scenes, pixels, antialiasing and outputs cost."""
    figure = Figure(figsize=(15.0, 8.2), dpi=80, layout="constrained")
    FigureCanvasAgg(figure)
    (stages, workers, scenes), (pixels, antialias, outputs) = figure.subplots(2, 3)
    machine, (width, height) = report["machine"], report["size_px"]
    figure.suptitle(
        f"{report['config']}, {width} x {height} px, {machine['renderer']}, {machine['processor']}, "
        f"{machine['usable_cores']} cores",
        fontsize=10,
    )
    own = [row for row in report["stages"]["rows"] if row["name"] != PROCESSOR]
    _bars(stages, [row["name"] for row in own], [1e3 * row["seconds"] for row in own])
    label_axis(stages, "stages alone, one thread", "ms a pair", "")

    _draw_workers(workers, report)
    scaling = report["scaling"]
    for name, colour in (("instances", _MAIN), ("triangles", _OTHER), ("outside", _QUIET)):
        rows = scaling[name]["rows"]
        text = {"instances": "more instances", "triangles": "more triangles each", "outside": "more out of view"}[name]
        # What is out of view adds to none of the triangles in view: shown by how many there are.
        x = [row["instances"] * row["triangles"] / rows[0]["instances"] if name == "outside" else row["triangles"]
             for row in rows]  # fmt: skip
        scenes.plot(x, [1e3 * row["seconds_per_pair"] for row in rows], "o-", color=colour, label=text)
    scenes.set_xscale("log")
    scenes.set_ylim(bottom=0)
    scenes.legend(fontsize=8)
    label_axis(scenes, "balls that cover 0.8 images", "triangles of the scene", "ms a pair")

    rows = scaling["resolution"]["rows"]
    pixels.plot(
        [row["pixels"] / 1e6 for row in rows], [1e3 * row["seconds_per_pair"] for row in rows], "o-", color=_MAIN
    )
    pixels.set_xlim(left=0)
    pixels.set_ylim(bottom=0)
    label_axis(pixels, scaling["resolution"]["text"], "megapixels", "ms a pair")
    for axis, name in ((antialias, "antialias"), (outputs, "outputs")):
        rows = scaling[name]["rows"]
        _bars(axis, [row["name"] for row in rows], [1e3 * row["seconds_per_pair"] for row in rows])
        label_axis(axis, f"{name}, {scaling[name]['text']}", "ms a pair", "")
    return figure


def _draw_workers(axis: Axes, report: Mapping[str, Any]) -> None:
    single, *rows = report["workers"]["rows"]
    counts = [row["workers"] for row in rows]
    axis.plot(
        counts, [row["pairs_per_second"] for row in rows], "o-", color=_MAIN, label="workers, all cores shared out"
    )
    axis.scatter([1], [single["pairs_per_second"]], color=_OTHER, label="one worker, one thread", zorder=3)
    limit = report["limit"]["allows_per_second"]
    axis.axhline(limit, color=_QUIET, linestyle="--", label=f"what the {report['limit']['by']} allows")
    axis.set_ylim(0, 1.15 * max(limit, *(row["pairs_per_second"] for row in rows)))
    axis.set_xticks(counts)
    axis.legend(fontsize=8, loc="lower right")
    label_axis(axis, "from start to end, files written", "workers", "pairs/s")


def _bars(axis: Axes, names: Sequence[str], values: Sequence[float]) -> None:
    bars = axis.barh(list(names), list(values), color=_MAIN)
    axis.bar_label(bars, fmt="%.0f", padding=3, fontsize=8)
    axis.invert_yaxis()
    axis.margins(x=0.12)
