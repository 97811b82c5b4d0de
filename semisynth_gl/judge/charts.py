"""Histograms of disparity and of measures, drawn by matplotlib."""

import io
from base64 import b64encode
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from semisynth_gl.histogram import Histogram, total_variation
from semisynth_gl.judge.comparison import Row

_ACHIEVED, _WANTED = "#d98a3d", "#4a90d9"
# Visible on a light and on a dark page.
_INK = "#888888"
_COLUMNS, _BINS, _DISPARITY_BINS = 4, 16, 72
_WIDTH_IN, _ROW_IN, _FIRST_IN = 14.0, 1.9, 2.6


def draw_disparity(axis: Axes, achieved: Histogram | None, target: Histogram) -> None:
    """Draw the achieved distribution of disparity, None where no pixel has a disparity, and the target's outline."""
    if achieved is None:
        axis.set_title("no pixel has a disparity", fontsize=9)
        return
    # The outermost 0.01 % of pixels on either side would make the axis too long.
    low, high = ([each.quantile(share) for each in (achieved, target)] for share in (1e-4, 1 - 1e-4))
    edges = np.linspace(min(low), max(high), _DISPARITY_BINS + 1)
    axis.stairs(achieved.rebinned(edges).shares, edges, fill=True, color=_ACHIEVED, label="achieved")
    axis.stairs(target.rebinned(edges).shares, edges, color=_WANTED, linewidth=1.5, label="wanted by the config")
    distance = total_variation(target, achieved)
    axis.set_title(f"share of pixels per disparity, px; total variation {distance:.3f}", fontsize=9)
    axis.tick_params(labelsize=8)
    axis.margins(x=0)
    axis.legend(fontsize=8, frameon=False)


def draw_report(achieved: Histogram | None, target: Histogram, rows: Sequence[Row]) -> str:
    """Draw the distributions of disparity, and of each measure in the dataset and in the place.

    Returns:
        The drawing, an SVG, as a data URI. Equal arguments give equal drawings.
    """
    below = -(-len(rows) // _COLUMNS)
    style: dict[Any, Any] = {"svg.hashsalt": "report", "svg.fonttype": "none"}
    style |= dict.fromkeys(("text.color", "axes.edgecolor", "axes.titlecolor", "xtick.color", "ytick.color"), _INK)
    with mpl.rc_context(style):
        # The solver of a constrained layout is not reproducible to the last bit.
        figure = Figure(figsize=(_WIDTH_IN, _FIRST_IN + below * _ROW_IN), layout="tight")
        FigureCanvasAgg(figure)
        grid = figure.add_gridspec(1 + below, _COLUMNS, height_ratios=[_FIRST_IN, *[_ROW_IN] * below])
        draw_disparity(figure.add_subplot(grid[0, :]), achieved, target)
        for number, row in enumerate(rows):
            _draw_measure(figure.add_subplot(grid[1 + number // _COLUMNS, number % _COLUMNS]), row)
        for axis in figure.axes:
            axis.set_facecolor("none")
        data = io.BytesIO()
        figure.savefig(data, format="svg", transparent=True, metadata={"Date": None})
    return f"data:image/svg+xml;base64,{b64encode(data.getvalue()).decode('ascii')}"


def _draw_measure(axis: Axes, row: Row) -> None:
    edges = np.histogram_bin_edges(np.concatenate([row.dataset, row.place]), _BINS)
    for values, options in ((row.dataset, {"fill": True, "color": _ACHIEVED}), (row.place, {"color": _WANTED})):
        if values.size:
            axis.stairs(np.histogram(values, edges)[0] / values.size, edges, **options)
    axis.set_title(f"{row.measure.name}, {row.measure.unit}", fontsize=8)
    axis.tick_params(labelsize=7)
    axis.margins(x=0)
