"""Histograms as SVG elements in the colours of the page."""

import math
from collections.abc import Sequence
from html import escape

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Size of a drawing, and the margins of its axes: left, top, right, bottom.
_WIDTH, _HEIGHT = 400, 210
_LEFT, _TOP, _RIGHT, _BOTTOM = 42, 10, 10, 38
_FEWEST_BINS, _MOST_BINS = 8, 48
# Ticks stand at multiples of these times a power of ten; there are at most this many.
_STEPS, _MOST_TICKS = (1, 2, 5, 10), 6


def count_bars(
    values: ArrayLike, edges: NDArray[np.float64] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Count values in 8 to 48 bins; within these limits, the number of bins is twice the root of the number of values.

    Args:
        values: numbers; NaN and infinite ones are ignored. Without ``edges``, at least one must remain.
        edges: other bins, whose outer ones also count the values beyond them.

    Returns:
        The rising edges (K + 1,), and the share of the values in each bin (K,), from 0 to 1.
    """
    array = np.asarray(values, np.float64).ravel()
    array = array[np.isfinite(array)]
    if edges is None:
        low, high = float(array.min()), float(array.max())
        # A single value stands in the middle of the axis.
        low, high = (low, high) if low < high else (low - 0.5, high + 0.5)
        bins = int(np.clip(2 * math.sqrt(len(array)), _FEWEST_BINS, _MOST_BINS))
        edges = np.linspace(low, high, bins + 1)
    counts = np.histogram(np.clip(array, edges[0], edges[-1]), edges)[0]
    return edges, counts / max(len(array), 1)


def draw_histogram(
    edges: NDArray[np.float64],
    shares: NDArray[np.float64],
    label: str,
    *,
    outline: NDArray[np.float64] | None = None,
    marks: Sequence[tuple[float, str]] = (),
) -> str:
    """Return the bars of a histogram as an SVG element with tooltips.

    Args:
        edges: (K + 1,), the rising edges of the bins.
        shares: (K,), the share of the values in each bin, from 0 to 1.
        label: label of the x axis.
        outline: (K,), shares of another distribution in the same bins, drawn as a line over the bars.
        marks: values on the x axis to mark, each with its tooltip; values outside the axis are ignored.
    """
    low, high = map(float, edges[[0, -1]])
    highest = 100 * max(float(shares.max()), 0.0 if outline is None else float(outline.max()), 1e-9)

    def across(value: float) -> str:
        return f"{_LEFT + (value - low) / (high - low) * (_WIDTH - _LEFT - _RIGHT):.2f}"

    def down(percent: float) -> str:
        return f"{_HEIGHT - _BOTTOM - percent / highest * (_HEIGHT - _TOP - _BOTTOM):.2f}"

    floor, parts = _HEIGHT - _BOTTOM, list[str]()
    for percent in _ticks(0, highest):
        parts.append(f'<path class="grid" d="M{_LEFT} {down(percent)}H{_WIDTH - _RIGHT}"/>')
        parts.append(f'<text x="{_LEFT - 5}" y="{down(percent)}" dy="4" text-anchor="end">{percent:g} %</text>')
    for value in _ticks(low, high):
        parts.append(f'<text x="{across(value)}" y="{floor + 16}" text-anchor="middle">{value:g}</text>')
    parts.append(f'<text x="{(_LEFT + _WIDTH) / 2}" y="{_HEIGHT - 6}" text-anchor="middle">{escape(label)}</text>')
    for start, end, share in zip(edges[:-1], edges[1:], shares, strict=True):
        if share > 0:
            title = f"{start:.4g} to {end:.4g}: {100 * share:.3g} %"
            shape = f"M{across(start)} {floor}V{down(100 * share)}H{across(end)}V{floor}Z"
            parts.append(f'<path class="bar" d="{shape}"><title>{title}</title></path>')
    if outline is not None:
        steps = "".join(f"V{down(100 * share)}H{across(end)}" for share, end in zip(outline, edges[1:], strict=True))
        parts.append(f'<path class="outline" d="M{_LEFT} {floor}{steps}V{floor}"/>')
    for value, tooltip in marks:
        if low <= value <= high:
            title = f"<title>{escape(tooltip)}</title>"
            parts.append(f'<path class="outline mark" d="M{across(value)} {_TOP}V{floor}">{title}</path>')
    return f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}">{"".join(parts)}</svg>'


def _ticks(low: float, high: float) -> list[float]:
    """Return round numbers between two ends."""
    scale = 10.0 ** math.floor(math.log10((high - low) / _MOST_TICKS))
    step = next(scale * each for each in _STEPS if (high - low) / (scale * each) <= _MOST_TICKS)
    return [number * step for number in range(math.ceil(low / step), math.floor(high / step) + 1)]
