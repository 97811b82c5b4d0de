"""The contact sheet: pairs with their disparity, and the disparity's histogram beside its target."""

from collections.abc import Sequence

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from semisynth_gl.frame.frame import Frame, as_rgb, finite_range
from semisynth_gl.histogram import Histogram, PixelCount
from semisynth_gl.judge.charts import draw_disparity
from semisynth_gl.judge.pictures import COLOUR_MAP

_INVALID = "#4060c0"
_WIDTH_IN, _CHART_IN = 16.0, 2.8


def draw_sheet(
    frames: Sequence[Frame], target: Histogram, title: str, names: Sequence[str], weights: Sequence[float]
) -> Figure:
    """Draw a row for each pair (left, right, left disparity with its scale in px) above the histogram of all pairs.

    Args:
        frames: the pairs, at least one, with a disparity.
        target: the distribution of disparity that the config asks for.
        title: title of the sheet.
        names: a name for each pair, below its left image.
        weights: how much each pair counts in the histogram.
    """
    first = frames[0].camera
    row_in = (_WIDTH_IN / 3.15) * first.height_px / first.width_px
    figure = Figure(figsize=(_WIDTH_IN, row_in * len(frames) + _CHART_IN + 0.5), dpi=100, layout="constrained")
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
        count = PixelCount(target.edges_px)
        count.add(frame.left.disparity)
        counts += weight * count.counts
    achieved = Histogram.from_counts(target.edges_px, counts) if counts.any() else None
    draw_disparity(figure.add_subplot(grid[len(frames), :]), achieved, target)
    return figure
