"""The contact sheet: pairs with their disparity, and the disparity's histogram beside its target."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from semisynth_gl.frame.frame import Frame, as_rgb
from semisynth_gl.histogram import Histogram, PixelCount, total_variation
from semisynth_gl.judge.pictures import COLOUR_MAP

_INVALID = "#4060c0"
_WIDTH_IN = 16.0


def draw_sheet(
    frames: Sequence[Frame],
    target: Histogram,
    title: str,
    names: Sequence[str] = (),
    weights: Sequence[float] | None = None,
) -> Figure:
    """Draw a row for each pair (left, right, left disparity with its scale in px) above the histogram of all pairs.

    Args:
        frames: the pairs, at least one, with a disparity.
        target: the distribution of disparity that the config asks for.
        title: title of the sheet.
        names: a name for each pair, below its left image; () for no names.
        weights: how much each pair counts in the histogram; by default all count the same.
    """
    first = frames[0].camera
    row_in = (_WIDTH_IN / 3.15) * first.height_px / first.width_px
    chart_in = 2.8
    figure = Figure(figsize=(_WIDTH_IN, row_in * len(frames) + chart_in + 0.5), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11)
    grid = figure.add_gridspec(len(frames) + 1, 3, height_ratios=[row_in] * len(frames) + [chart_in])
    valid = [frame.left.disparity[np.isfinite(frame.left.disparity)] for frame in frames]
    largest = max((float(values.max()) for values in valid if values.size), default=1.0)
    least = min((float(values.min()) for values in valid if values.size), default=0.0)
    for row, frame in enumerate(frames):
        axes = [figure.add_subplot(grid[row, column]) for column in range(3)]
        for axis, label in zip(axes, ("left", "right", "disparity of the left view"), strict=True):
            axis.set(xticks=[], yticks=[])
            if row == 0:
                axis.set_title(label, fontsize=9)
        axes[0].imshow(as_rgb(frame.left.image))
        axes[1].imshow(as_rgb(frame.right.image))
        disparity = np.ma.masked_invalid(frame.left.disparity)
        low = min(0.0, least)
        shown = axes[2].imshow(disparity, cmap=COLOUR_MAP, vmin=low, vmax=largest, interpolation="nearest")
        axes[2].set_facecolor(_INVALID)
        bar = figure.colorbar(shown, ax=axes[2], pad=0.01, fraction=0.04)
        bar.set_label("px", fontsize=8)
        bar.ax.tick_params(labelsize=8)
        if names:
            axes[0].set_xlabel(names[row], fontsize=9)
    counts = np.zeros(len(target.shares))
    for disparity_px, weight in zip(valid, [1.0] * len(frames) if weights is None else weights, strict=True):
        count = PixelCount(target.edges_px)
        count.add(disparity_px)
        counts += weight * count.counts
    achieved = Histogram.from_counts(target.edges_px, counts) if counts.any() else None
    _draw_histogram(figure.add_subplot(grid[len(frames), :]), achieved, target)
    return figure


def _draw_histogram(axis: Axes, achieved: Histogram | None, target: Histogram) -> None:
    if achieved is None:
        axis.set_title("no pixel has a disparity", fontsize=9)
        return
    axis.stairs(achieved.shares, achieved.edges_px, fill=True, color="#d98a3d", label="achieved")
    axis.stairs(target.shares, target.edges_px, color="black", linewidth=1.5, label="wanted by the config")
    distance = total_variation(target, achieved)
    axis.set_title(f"share of pixels per disparity; total variation {distance:.3f}", fontsize=9)
    axis.set_xlabel("disparity, px", fontsize=8)
    axis.tick_params(labelsize=8)
    axis.margins(x=0)
    axis.legend(fontsize=8, frameon=False)
