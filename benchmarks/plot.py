"""Draw the JSON that `semisynth-gl bench speed`, `choices.py` and `alternatives.py` write.

    python benchmarks/plot.py alternatives.json accuracy.json --out accuracy.png
    python benchmarks/plot.py speed.json --out speed.png

Of accuracy, a panel is drawn for each table that the files hold; of a table that two files hold, the first file's. Of
speed, two panels: stages and workers.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Annotation

# Places of a label beside its point, in points.
_OFFSETS = [(x, y) for y in (5, -12, 16, -23, 27, -34) for x in (6, -6)]
_FRONT, _OFF, _DEFAULT = "#b5521b", "#8a8f98", "#1f5fa8"

# From a row to its place in a panel; the reference of antialiasing has none.
_Place = Callable[[Mapping[str, Any]], tuple[float, float | None]]


def draw_accuracy(report: Mapping[str, Any]) -> Figure:
    """Draw error against cost, a panel for each of "get", "store" and "antialias" that the report holds."""
    names = [name for name in ("get", "store", "antialias") if name in report]
    figure = Figure(figsize=(5.0 * len(names), 4.6), dpi=80, layout="constrained")
    FigureCanvasAgg(figure)
    axes = dict(zip(names, figure.subplots(1, len(names), squeeze=False)[0], strict=True))
    machine, (width, height) = report["machine"], report["sizes_px"][0]
    figure.suptitle(
        f"{report['config']}, {width} x {height} px, {machine['renderer']}, {machine['processor']}; "
        "blue: the default, orange: not dominated",
        fontsize=10,
    )
    if "get" in axes:
        axis = axes["get"]
        _draw(axis, report["get"], lambda row: (row["time_ratio"], row["error"]["p999_px"]))
        _label_axis(axis, "to get the disparity", "time of the disparities / the default's", "error at p99.9, px")
        axis.set_yscale("log")
    if "store" in axes:
        axis = axes["store"]
        _draw(axis, report["store"], lambda row: (row["bytes_per_pair"] / 1e6, row["error"]["worst_px"]), timed=True)
        _label_axis(axis, "to store it (ms to write)", "MB per pair", "worst error, px")
        # Lossless encodings have no place on a logarithm: the scale is linear below the errors of all others.
        axis.set_yscale("symlog", linthresh=1e-4)
        axis.set_ylim(bottom=-3e-5)
    if "antialias" in axes:
        axis = axes["antialias"]
        _draw(axis, report["antialias"], lambda row: (row["time_ratio"], row["psnr_db"]), upwards=True)
        against = f"PSNR against {report['antialias']['reference']}, dB"
        _label_axis(axis, "to antialias", "time of a pair / the default's", against)
    # Places are known once everything else has been laid out.
    figure.canvas.draw()
    for axis in axes.values():
        _part_labels(axis)
    return figure


def _draw(axis: Axes, part: Mapping[str, Any], place: _Place, *, timed: bool = False, upwards: bool = False) -> None:
    """Draw a point per row and a line along the front of the two quantities shown."""
    placed = [(row, *place(row)) for row in part["rows"]]
    points = [(row, x, y) for row, x, y in placed if y is not None]
    line: list[tuple[float, float]] = []
    for _, x, y in sorted(points, key=lambda point: point[1]):
        if not line or (y > line[-1][1] if upwards else y < line[-1][1]):
            line.append((x, y))
    axis.plot([x for x, _ in line], [y for _, y in line], color=_FRONT, linewidth=1, alpha=0.5, zorder=1)
    axis.margins(y=0.15)
    axis.set_xlim(0, 1.25 * max(x for _, x, _ in points))
    for row, x, y in points:
        default = row["name"] == part["default"]
        colour = _DEFAULT if default else _FRONT if row["on_front"] else _OFF
        axis.scatter([x], [y], s=60 if default else 30, color=colour, zorder=2)
        name = f"{row['name']} ({1e3 * row['seconds_per_pair']:.1f})" if timed else row["name"]
        axis.annotate(name, (x, y), xytext=_OFFSETS[0], textcoords="offset points", fontsize=8, color=colour)


def _part_labels(axis: Axes) -> None:
    """Move labels that would lie on each other, or outside the panel, to another place beside their points."""
    placed = [axis.title.get_window_extent()]
    frame = axis.get_window_extent()
    for label in (child for child in axis.get_children() if isinstance(child, Annotation)):
        for offset in _OFFSETS:
            label.set_position(offset)
            label.set_horizontalalignment("left" if offset[0] > 0 else "right")
            box = label.get_window_extent()
            if not box.count_overlaps(placed) and frame.x0 < box.x0 and box.x1 < frame.x1 and box.y1 < frame.y1:
                break
        placed.append(label.get_window_extent())


def draw_speed(report: Mapping[str, Any]) -> Figure:
    """Draw two panels: stages and workers."""
    figure = Figure(figsize=(10.0, 4.1), dpi=80, layout="constrained")
    FigureCanvasAgg(figure)
    stages, workers = figure.subplots(1, 2)
    machine, (width, height) = report["machine"], report["size_px"]
    figure.suptitle(
        f"{report['config']}, {width} x {height} px, {machine['renderer']}, {machine['processor']}, "
        f"{machine['usable_cores']} cores",
        fontsize=10,
    )
    _bars(stages, [row["name"] for row in report["stages"]], [1e3 * row["seconds"] for row in report["stages"]])
    _label_axis(stages, "stages alone, one thread", "ms a pair", "")
    _draw_workers(workers, report)
    return figure


def _draw_workers(axis: Axes, report: Mapping[str, Any]) -> None:
    rows = report["workers"]
    counts = [row["workers"] for row in rows]
    axis.plot(counts, [row["pairs_per_second"] for row in rows], "o-", color=_DEFAULT)
    axis.set_ylim(0, 1.15 * max(row["pairs_per_second"] for row in rows))
    axis.set_xticks(counts)
    _label_axis(axis, "from start to end, files written", "workers", "pairs/s")


def _bars(axis: Axes, names: Sequence[str], values: Sequence[float]) -> None:
    bars = axis.barh(list(names), list(values), color=_DEFAULT)
    axis.bar_label(bars, fmt="%.0f", padding=3, fontsize=8)
    axis.invert_yaxis()
    axis.margins(x=0.12)


def _label_axis(axis: Axes, title: str, x: str, y: str) -> None:
    """Give a panel its title, the names of its axes, and a grid."""
    axis.set_title(title, fontsize=10)
    axis.set_xlabel(x, fontsize=9)
    axis.set_ylabel(y, fontsize=9)
    axis.tick_params(labelsize=8)
    axis.grid(alpha=0.25)


@click.command()
@click.argument("reports", nargs=-1, required=True, type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--out", required=True, type=click.Path(dir_okay=False, path_type=Path), help="A name that ends in .png.")
def main(reports: tuple[Path, ...], out: Path) -> None:
    """Draw JSON of `bench speed`, `choices.py` or `alternatives.py`."""
    report: dict[str, Any] = {}
    for path in reports:
        report = json.loads(path.read_text(encoding="utf-8")) | report
    draw = draw_speed if "stages" in report else draw_accuracy
    draw(report).savefig(out, format="png")


if __name__ == "__main__":
    main()
