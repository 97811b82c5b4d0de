"""Draws plots with matplotlib: the contact sheet of a preview, and the histograms of a report."""

import io
from base64 import b64encode
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from semisynth_gl.frame.frame import Frame, as_rgb, finite_range
from semisynth_gl.histogram import Histogram, count_pixels, total_variation
from semisynth_gl.judge.comparison import Row
from semisynth_gl.judge.pictures import COLOUR_MAP

Shares = NDArray[np.floating]

_ACHIEVED, _WANTED = "#d98a3d", "#4a90d9"
# A grey that is visible on light and dark pages.
_INK = "#888888"
_COLUMNS, _BINS, _DISPARITY_BINS = 4, 16, 72
_WIDTH_IN, _ROW_IN, _FIRST_IN = 14.0, 1.9, 2.6
_SHEET_IN, _CHART_IN, _INVALID = 16.0, 2.8, "#4060c0"


def draw_sheet(
    frames: Sequence[Frame], target: Histogram, title: str, names: Sequence[str], weights: Sequence[float]
) -> Figure:
    """Draw a row for each pair (left, right, left disparity with its scale in px) above the histogram of all pairs.

    Args:
        frames: the pairs, at least one, with a disparity.
        target: the config's target distribution of disparity.
        title: title of the sheet.
        names: a name for each pair, below its left image.
        weights: the weight of each pair in the histogram.
    """
    first = frames[0].camera
    row_in = (_SHEET_IN / 3.15) * first.height_px / first.width_px
    figure = Figure(figsize=(_SHEET_IN, row_in * len(frames) + _CHART_IN + 0.5), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11)
    grid = figure.add_gridspec(len(frames) + 1, 3, height_ratios=[row_in] * len(frames) + [_CHART_IN])
    ranges = [finite_range(frame.left.disparity) for frame in frames]
    least, largest = min(0.0, *(low for _, low, _ in ranges)), max(high for *_, high in ranges)
    counts = np.zeros(len(target.shares))
    for row, (frame, name, weight) in enumerate(zip(frames, names, weights, strict=True)):
        axes = [figure.add_subplot(grid[row, column]) for column in range(3)]
        for axis, label in zip(axes, ("left", "right", "disparity of the left view"), strict=True):
            axis.set(xticks=[], yticks=[])
            if row == 0:
                axis.set_title(label, fontsize=9)
        axes[0].imshow(as_rgb(frame.left.image))
        axes[0].set_xlabel(name, fontsize=9)
        axes[1].imshow(as_rgb(frame.right.image))
        disparity = np.ma.masked_invalid(frame.left.disparity)
        shown = axes[2].imshow(disparity, cmap=COLOUR_MAP, vmin=least, vmax=largest, interpolation="nearest")
        axes[2].set_facecolor(_INVALID)
        bar = figure.colorbar(shown, ax=axes[2], pad=0.01, fraction=0.04)
        bar.set_label("px", fontsize=8)
        bar.ax.tick_params(labelsize=8)
        counts += weight * count_pixels(frame.left.disparity, target.edges_px)
    achieved = Histogram.from_counts(target.edges_px, counts) if counts.any() else None
    _draw_disparity(figure.add_subplot(grid[len(frames), :]), achieved, target)
    return figure


def _draw_disparity(axis: Axes, achieved: Histogram | None, target: Histogram) -> None:
    """Draw the achieved distribution of disparity (None if no pixel has a disparity), and the target's outline."""
    # Cut off the outermost 0.01 % of pixels on both sides, which would make the axis too long.
    known = [each for each in (achieved, target) if each is not None]
    low, high = ([each.quantile(share) for each in known] for share in (1e-4, 1 - 1e-4))
    edges = np.linspace(min(low), max(high), _DISPARITY_BINS + 1)
    filled, outline = (None if each is None else each.rebinned(edges).shares for each in (achieved, target))
    distance = "no pixel has one" if achieved is None else f"total variation {total_variation(target, achieved):.3f}"
    _draw_shares(axis, edges, filled, outline, f"share of pixels per disparity, px; {distance}")
    axis.legend(("achieved", "wanted by the config")[achieved is None :], fontsize=8, frameon=False)


def _draw_shares(axis: Axes, edges: Shares, filled: Shares | None, outline: Shares | None, title: str) -> None:
    """Draw two distributions, (K,) shares in bins with (K + 1,) edges: one filled, the other as an outline."""
    if filled is not None:
        axis.stairs(filled, edges, fill=True, color=_ACHIEVED)
    if outline is not None:
        axis.stairs(outline, edges, color=_WANTED, linewidth=1.5)
    axis.set_title(title, fontsize=8)
    axis.tick_params(labelsize=8)
    axis.margins(x=0)


def draw_report(achieved: Histogram | None, target: Histogram, rows: Sequence[Row]) -> str:
    """Draw the distribution of disparity, and the distributions of each measure in the dataset and in the place.

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
        _draw_disparity(figure.add_subplot(grid[0, :]), achieved, target)
        for number, row in enumerate(rows):
            edges = np.histogram_bin_edges(np.concatenate([row.dataset, row.place]), _BINS)
            ours, theirs = (
                np.histogram(values, edges)[0] / values.size if values.size else None
                for values in (row.dataset, row.place)
            )
            axis = figure.add_subplot(grid[1 + number // _COLUMNS, number % _COLUMNS])
            _draw_shares(axis, edges, ours, theirs, f"{row.measure.name}, {row.measure.unit}")
        for axis in figure.axes:
            axis.set_facecolor("none")
        data = io.BytesIO()
        figure.savefig(data, format="svg", transparent=True, metadata={"Date": None})
    return f"data:image/svg+xml;base64,{b64encode(data.getvalue()).decode('ascii')}"
