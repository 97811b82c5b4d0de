"""Histograms as SVG elements, drawn by matplotlib in the colours of the page."""

import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import Locator, LogLocator, MaxNLocator, NullLocator
from numpy.typing import ArrayLike, NDArray

COLOUR_MAP = "inferno"
"""The colour map of disparities: perceptually uniform, and dark at small disparities."""

# Width and height of a drawing: in SVG, matplotlib has 72 pixels in an inch.
_SIZE_IN = (400 / 72, 210 / 72)
_AXES = (0.105, 0.18, 0.87, 0.77)
_FEWEST_BINS, _MOST_BINS = 8, 48
# Width of a bar as a share of its bin's width; the rest is the gap between bars.
_BAR_WIDTH = 0.94
# Ticks stand at these multiples of powers of ten. Logarithmic axes whose ends have a ratio of _MOST_RATIO or more have
# ticks only at the powers; those with a ratio below _LEAST_RATIO have evenly spaced ticks.
_ROUND = (1, 2, 5, 10)
_LEAST_RATIO, _MOST_RATIO = 7.0, 1e4

# matplotlib knows no CSS variables, so these colours and this font stand for them until the drawing is text.
_BAR, _OUTLINE, _LINE, _SOFT, _FONT = "#5b8fd6", "#b3470f", "#d5d9e0", "#5c6270", "DejaVu Sans"
_IN_PAGE = {
    _BAR: "var(--bar)",
    _OUTLINE: "var(--outline)",
    _LINE: "var(--line)",
    _SOFT: "var(--soft)",
    f"'{_FONT}'": "system-ui, sans-serif",
}
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "font.family": _FONT,
    "font.size": 12,
    "axes.facecolor": "none",
    "axes.axisbelow": True,
    "grid.color": _LINE,
    "xtick.major.size": 3,
    "ytick.major.size": 0,
    **dict.fromkeys(("axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"), _SOFT),
    **dict.fromkeys(("axes.spines.left", "axes.spines.right", "axes.spines.top"), False),
}


@dataclass(frozen=True, slots=True, eq=False)
class Bars:
    """The bars of a histogram.

    Attributes:
        edges: (K + 1,), rising edges of the bins; above 0 on a logarithmic axis.
        shares: (K,), share of the values in each bin, as a fraction of 1.
        log: whether the axis is logarithmic.
    """

    edges: NDArray[np.float64]
    shares: NDArray[np.float64]
    log: bool = False


def count_bars(values: ArrayLike, *, log: bool = False, limits: tuple[float, float] | None = None) -> Bars:
    """Count values in 8 to 48 bins; within these limits, the number of bins is twice the root of the number of values.

    Args:
        values: numbers; NaN and infinite ones are ignored. Without ``limits``, at least one must remain.
        log: whether the axis is logarithmic. Bins then have equal ratios instead of equal widths, and values of 0 and
            below are ignored.
        limits: the outer edges, by default the smallest and the largest value; values beyond them count in the outer
            bins.
    """
    array = np.asarray(values, np.float64).ravel()
    array = array[np.isfinite(array) & ((array > 0) | (not log))]
    low, high = (float(array.min()), float(array.max())) if limits is None else limits
    bins = int(np.clip(2 * math.sqrt(len(array)), _FEWEST_BINS, _MOST_BINS))
    if not low < high:
        # A single value stands in the middle of the axis.
        low, high = (low / 2, high * 2) if log else (low - 0.5, high + 0.5)
    edges = np.geomspace(low, high, bins + 1) if log else np.linspace(low, high, bins + 1)
    edges[0], edges[-1] = low, high
    counts = np.histogram(np.clip(array, low, high), edges)[0]
    return Bars(edges, counts / max(len(array), 1), log)


def draw_histogram(
    name: str,
    bars: Bars,
    label: str,
    *,
    outline: NDArray[np.float64] | None = None,
    marks: Sequence[tuple[float, str]] = (),
) -> str:
    """Return bars as an SVG element with tooltips.

    Args:
        name: decides the ids in the element, so drawings of one page need different names.
        bars: the bars.
        label: label of the x axis.
        outline: (K,), shares of another distribution in the same bins, drawn as a line over the bars.
        marks: values on the x axis to mark, each with its tooltip; values outside the axis are ignored.
    """
    file = io.StringIO()
    with mpl.rc_context(_STYLE | {"svg.hashsalt": name}):
        figure = Figure(figsize=_SIZE_IN, frameon=False)
        axes = figure.add_axes(_AXES)
        low, high = bars.edges[[0, -1]]
        highest = max(bars.shares.max(), 0.0 if outline is None else outline.max(), 1e-9)
        axes.set(xscale="log" if bars.log else "linear", xlim=(low, high), ylim=(0, 100 * highest), xlabel=label)
        axes.xaxis.set_major_locator(_ticks(high / low) if bars.log else MaxNLocator(6, steps=_ROUND))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_major_locator(MaxNLocator(5, steps=_ROUND))
        axes.yaxis.set_major_formatter("{x:g} %")
        # Clip paths would need ids that are unique in the page; nothing extends beyond the axes anyway.
        axes.grid(axis="y", clip_on=False)
        tooltips: dict[str, str] = {}
        for low_edge, high_edge, share in zip(bars.edges[:-1], bars.edges[1:], bars.shares, strict=True):
            if share > 0:
                gid = f"bar-{len(tooltips)}"
                tooltips[gid] = f"{low_edge:.4g} to {high_edge:.4g}: {100 * share:.3g} %"
                width = _BAR_WIDTH * (high_edge - low_edge)
                axes.bar(low_edge, 100 * share, width, align="edge", color=_BAR, clip_on=False, gid=gid)
        if outline is not None:
            axes.stairs(100 * outline, bars.edges, baseline=None, color=_OUTLINE, linewidth=1.6, clip_on=False)
        for value, tooltip in marks:
            if low <= value <= high:
                gid = f"mark-{len(tooltips)}"
                tooltips[gid] = tooltip
                axes.axvline(value, color=_OUTLINE, linewidth=1.2, linestyle=(0, (3, 2)), clip_on=False, gid=gid)
        figure.savefig(file, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    return _for_page(file.getvalue(), tooltips)


def _ticks(ratio: float) -> Locator:
    """Return the ticks of a logarithmic axis whose end is ``ratio`` times its beginning."""
    if ratio < _LEAST_RATIO:
        return MaxNLocator(6, steps=_ROUND)
    return LogLocator(subs=_ROUND[:-1] if ratio < _MOST_RATIO else _ROUND[:1])


def _for_page(svg: str, tooltips: Mapping[str, str]) -> str:
    """Cut a drawing out of its file, and give it the page's colours and its tooltips."""
    svg = svg[svg.index("<svg") :]
    # The style would apply to the whole page, and all drawings have groups with the same ids.
    svg = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>", "", svg, flags=re.DOTALL)
    svg = re.sub(
        r'<g id="((bar|mark)-\d+)">', lambda tag: f'<g class="{tag[2]}"><title>{escape(tooltips[tag[1]])}</title>', svg
    )
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)
    for value, in_page in _IN_PAGE.items():
        svg = svg.replace(value, in_page)
    return re.sub(r"\s*\n\s*", " ", svg)
