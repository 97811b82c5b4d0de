"""Plot the JSON of alternatives.py: error against time.

python benchmarks/plot.py alternatives.json --out accuracy.png
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

_FRONT, _OFF, _DEFAULT = "#b5521b", "#8a8f98", "#1f5fa8"


def draw(report: Mapping[str, Any]) -> Figure:
    """Return a figure with a panel for the ways to get disparity, and a panel for antialiasing."""
    figure = Figure(figsize=(10.0, 4.6), dpi=80, layout="constrained")
    FigureCanvasAgg(figure)
    machine, (width, height) = report["machine"], report["sizes_px"][0]
    figure.suptitle(
        f"{report['config']}, {width} x {height} px, {machine['renderer']}, {machine['processor']}; "
        "blue: the default, orange: not dominated",
        fontsize=10,
    )
    get, antialias = figure.subplots(1, 2)
    panels = (
        (get, "get", "disparity", "error at p99.9, px", lambda row: row["error"]["p999_px"]),
        (antialias, "antialias", "antialiasing", "PSNR against 64 samples a pixel, dB", lambda row: row["psnr_db"]),
    )
    for axis, part, title, label, value in panels:
        for number, row in enumerate(report[part]):
            colour = _DEFAULT if row["default"] else _FRONT if row["on_front"] else _OFF
            point = row["time_ratio"], value(row)
            axis.scatter(*point, s=60 if row["default"] else 30, color=colour)
            # Alternately right and left of the points, since successive points are often close.
            offset, side = ((6, 4), "left") if number % 2 == 0 else ((-6, 4), "right")
            axis.annotate(row["name"], point, offset, textcoords="offset points", fontsize=8, color=colour, ha=side)
        axis.set(title=title, xlabel="time / the default's", ylabel=label)
        axis.set_xlim(0, 1.3 * max(row["time_ratio"] for row in report[part]))
        axis.grid(alpha=0.25)
    get.set_yscale("log")
    return figure


@click.command()
@click.argument("report", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--out", required=True, type=click.Path(dir_okay=False, path_type=Path), help="A name that ends in .png.")
def main(report: Path, out: Path) -> None:
    """Plot REPORT."""
    draw(json.loads(report.read_text(encoding="utf-8"))).savefig(out, format="png")


if __name__ == "__main__":
    main()
