"""Plots with matplotlib: the contact sheet of `preview`, and the histograms of `report`."""

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
from semisynth_gl.judge.comparison import MeasureComparison
from semisynth_gl.judge.pictures import COLOUR_MAP

Shares = NDArray[np.floating]

_FILLED, _OUTLINE, _INVALID = "#d98a3d", "#4a90d9", "#4060c0"
# A grey that is visible on light and dark pages.
_TEXT = "#888888"
_DISPARITY_BINS, _MEASURE_BINS, _MEASURES_IN_ROW = 72, 16, 4
# Inches.
_SHEET_WIDTH, _SHEET_HISTOGRAM_HEIGHT = 16.0, 2.8
_REPORT_WIDTH, _DISPARITY_HEIGHT, _MEASURES_HEIGHT = 14.0, 2.6, 1.9


def plot_sheet(
    frames: Sequence[Frame], target: Histogram, title: str, names: Sequence[str], weights: Sequence[float]
) -> Figure:
    """Plot a row for each pair (left, right, left disparity with its scale in px) above the histogram of all pairs.

    ``frames`` has at least one pair. The sheet shows each of the ``names`` below a left image, and counts each pair in
    the histogram with its entry of ``weights``; ``target`` is the config's target distribution of disparity.
    """
    first = frames[0].camera
    # Three images and a colour bar share the width.
    pair_height = (_SHEET_WIDTH / 3.15) * first.height_px / first.width_px
    heights = [*[pair_height] * len(frames), _SHEET_HISTOGRAM_HEIGHT]
    figure = Figure(figsize=(_SHEET_WIDTH, sum(heights) + 0.5), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11)
    grid = figure.add_gridspec(len(heights), 3, height_ratios=heights)
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
    _plot_disparity(figure.add_subplot(grid[len(frames), :]), achieved, target)
    return figure


def _plot_disparity(axis: Axes, achieved: Histogram | None, target: Histogram) -> None:
    """Plot the achieved distribution of disparity (None if no pixel has a disparity), and the target's outline."""
    # The axis ends where 0.01 % of the pixels lie beyond it: a few extreme pixels would make it too long.
    known = [target] if achieved is None else [achieved, target]
    low, high = ([each.quantile(share) for each in known] for share in (1e-4, 1 - 1e-4))
    edges = np.linspace(min(low), max(high), _DISPARITY_BINS + 1)
    if achieved is None:
        shares, distance = None, "no pixel has a disparity"
    else:
        shares, distance = achieved.rebinned(edges).shares, f"total variation {total_variation(target, achieved):.3f}"
    _plot_shares(axis, edges, shares, target.rebinned(edges).shares, f"share of pixels per disparity, px; {distance}")
    axis.legend(fontsize=8, frameon=False)


def _plot_shares(axis: Axes, edges: Shares, filled: Shares | None, outline: Shares | None, title: str) -> None:
    """Plot two distributions, (K,) shares in bins with (K + 1,) edges: one filled, the other as an outline."""
    if filled is not None:
        axis.stairs(filled, edges, fill=True, color=_FILLED, label="achieved")
    if outline is not None:
        axis.stairs(outline, edges, color=_OUTLINE, linewidth=1.5, label="wanted by the config")
    axis.set_title(title, fontsize=8)
    axis.tick_params(labelsize=8)
    axis.margins(x=0)


def plot_report(achieved: Histogram | None, target: Histogram, rows: Sequence[MeasureComparison]) -> str:
    """Plot the distribution of disparity, and each measure's distributions in the dataset and in the place's pictures.

    Returns:
        The plots, an SVG, as a data URI. Equal arguments give equal bytes.
    """
    measure_rows = -(-len(rows) // _MEASURES_IN_ROW)
    style: dict[Any, Any] = {"svg.hashsalt": "report", "svg.fonttype": "none"}
    style |= dict.fromkeys(("text.color", "axes.edgecolor", "axes.titlecolor", "xtick.color", "ytick.color"), _TEXT)
    with mpl.rc_context(style):
        heights = [_DISPARITY_HEIGHT, *[_MEASURES_HEIGHT] * measure_rows]
        # The solver of a constrained layout is not reproducible to the last bit.
        figure = Figure(figsize=(_REPORT_WIDTH, sum(heights)), layout="tight")
        FigureCanvasAgg(figure)
        grid = figure.add_gridspec(len(heights), _MEASURES_IN_ROW, height_ratios=heights)
        _plot_disparity(figure.add_subplot(grid[0, :]), achieved, target)
        for number, row in enumerate(rows):
            edges = np.histogram_bin_edges(np.concatenate([row.dataset, row.place]), _MEASURE_BINS)
            shares_of_dataset, shares_of_place = (
                np.histogram(values, edges)[0] / values.size if values.size else None
                for values in (row.dataset, row.place)
            )
            axis = figure.add_subplot(grid[1 + number // _MEASURES_IN_ROW, number % _MEASURES_IN_ROW])
            title = f"{row.measure.name}, {row.measure.unit}"
            _plot_shares(axis, edges, shares_of_dataset, shares_of_place, title)
        for axis in figure.axes:
            axis.set_facecolor("none")
        data = io.BytesIO()
        figure.savefig(data, format="svg", transparent=True, metadata={"Date": None})
    return f"data:image/svg+xml;base64,{b64encode(data.getvalue()).decode('ascii')}"
