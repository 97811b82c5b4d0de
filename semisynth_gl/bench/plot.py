"""The plot of a report of `semisynth_gl.bench.accuracy`: error against cost, with the front."""

from collections.abc import Callable, Mapping
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Annotation

# Where a label may stand beside its point, in points.
_OFFSETS = [(x, y) for y in (5, -12, 16, -23, 27, -34) for x in (6, -6)]
_FRONT, _OFF, _DEFAULT = "#b5521b", "#8a8f98", "#1f5fa8"

# A row's place in a panel; the reference of the images has none.
_Place = Callable[[Mapping[str, Any]], tuple[float, float | None]]


def draw_plot(report: Mapping[str, Any]) -> Figure:
    """Draw three panels: ways to get the disparity, to store it and to antialias."""
    figure = Figure(figsize=(15.0, 4.6), dpi=80, layout="constrained")
    FigureCanvasAgg(figure)
    get, store, antialias = figure.subplots(1, 3)
    machine, (width, height) = report["machine"], report["sizes_px"][0]
    figure.suptitle(
        f"{report['config']}, {width} x {height} px, {machine['renderer']}, {machine['processor']}; "
        "blue: the default, orange: beaten by none",
        fontsize=10,
    )
    _draw(get, report["get"], lambda row: (row["time_ratio"], row["error"]["p999_px"]))
    label_axis(get, "to get the disparity", "time of the disparities / the default's", "error at p99.9, px")
    get.set_yscale("log")

    _draw(store, report["store"], lambda row: (row["bytes_per_pair"] / 1e6, row["error"]["worst_px"]), timed=True)
    label_axis(store, "to store it (ms to write)", "MB per pair", "worst error, px")
    # Lossless ways have no place on a logarithm: the scale is linear below what any of the others reaches.
    store.set_yscale("symlog", linthresh=1e-4)
    store.set_ylim(bottom=-3e-5)

    _draw(antialias, report["antialias"], lambda row: (row["time_ratio"], row["psnr_db"]), upwards=True)
    label_axis(
        antialias,
        "to antialias",
        "time of a pair / the default's",
        f"PSNR against {report['antialias']['reference']}, dB",
    )
    # Places are known once everything else has been laid out.
    figure.canvas.draw()
    for axis in (get, store, antialias):
        _part_labels(axis)
    return figure


def _draw(axis: Axes, part: Mapping[str, Any], place: _Place, *, timed: bool = False, upwards: bool = False) -> None:
    """Draw a point per row and a line along what is best in the two quantities shown."""
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


def label_axis(axis: Axes, title: str, x: str, y: str) -> None:
    """Give a panel its title, the names of its axes, and a grid."""
    axis.set_title(title, fontsize=10)
    axis.set_xlabel(x, fontsize=9)
    axis.set_ylabel(y, fontsize=9)
    axis.tick_params(labelsize=8)
    axis.grid(alpha=0.25)
