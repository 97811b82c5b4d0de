"""Histograms as SVG, written into the page: no library draws them, and they take the page's colours."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import ArrayLike, NDArray

_WIDTH, _HEIGHT = 400, 210
_LEFT, _RIGHT, _TOP, _BOTTOM = 42, 10, 10, 38
_TICKS = 6
_PERCENT_TICKS = 4
_FEWEST_BINS, _MOST_BINS = 8, 48


@dataclass(frozen=True, slots=True, eq=False)
class Bars:
    """Shares in bins.

    Attributes:
        edges: (K + 1,) float64, rising; above 0 where the axis is logarithmic.
        shares: (K,) float64.
        log: whether the axis is logarithmic.
    """

    edges: NDArray[np.float64]
    shares: NDArray[np.float64]
    log: bool = False


def bars_of(
    values: ArrayLike, *, bins: int | None = None, log: bool = False, limits: tuple[float, float] | None = None
) -> Bars:
    """Count finite values in bins of equal width, or of equal ratio.

    Args:
        values: any shape, at least one of them finite; for a logarithmic axis those above 0 count.
        bins: how many; by default about twice the root of the number of values, from 8 to 48.
        log: whether bins have equal ratios.
        limits: where the first begins and the last ends; by default at the smallest and the largest value.
    """
    array = np.asarray(values, np.float64).ravel()
    array = array[np.isfinite(array) & ((array > 0) | (not log))]
    low, high = (float(array.min()), float(array.max())) if limits is None else limits
    bins = bins or int(np.clip(2 * math.sqrt(len(array)), _FEWEST_BINS, _MOST_BINS))
    if not low < high:
        # One value alone gets a bin of its own, in the middle.
        low, high = (low / 2, high * 2) if log else (low - 0.5, high + 0.5)
    edges = np.geomspace(low, high, bins + 1) if log else np.linspace(low, high, bins + 1)
    edges[0], edges[-1] = low, high
    counts = np.histogram(np.clip(array, low, high), edges)[0]
    return Bars(edges, counts / max(len(array), 1), log)


def histogram_svg(
    bars: Bars,
    title: str,
    axis: str,
    *,
    outline: NDArray[np.float64] | None = None,
    marks: Sequence[tuple[float, str]] = (),
) -> str:
    """Draw bars as an SVG element.

    Args:
        bars: what to draw.
        title: read out in place of the picture.
        axis: what the x axis shows, with its unit.
        outline: (K,) float64, shares of another distribution in the same bins, drawn as a line over them.
        marks: places on the x axis to mark, with what each is.
    """
    highest = max(bars.shares.max(), 0.0 if outline is None else outline.max(), 1e-9)
    y_ticks = [tick for tick in linear_ticks(0, 100 * highest, _PERCENT_TICKS) if tick <= 100 * highest]
    bottom = _HEIGHT - _BOTTOM

    def x(value: float) -> float:
        ends = bars.edges[[0, -1]]
        low, high, at = (math.log(ends[0]), math.log(ends[1]), math.log(value)) if bars.log else (*ends, value)
        return float(_LEFT + (_WIDTH - _LEFT - _RIGHT) * (at - low) / (high - low))

    def y(share: float) -> float:
        return float(bottom - (bottom - _TOP) * share / highest)

    parts = [
        f'<svg class="plot" viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{escape(title)}">',
        f"<title>{escape(title)}</title>",
    ]
    for tick in y_ticks:
        at = y(tick / 100)
        parts.append(f'<line class="grid" x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{at:.1f}" y2="{at:.1f}"/>')
        parts.append(f'<text class="tick" x="{_LEFT - 5}" y="{at + 3.5:.1f}" text-anchor="end">{tick:g} %</text>')
    for low, high, share in zip(bars.edges[:-1], bars.edges[1:], bars.shares, strict=True):
        if share > 0:
            tip = f"{low:.4g} to {high:.4g}: {100 * share:.3g} %"
            parts.append(
                f'<rect class="bar" x="{x(low):.1f}" y="{y(share):.1f}" width="{max(x(high) - x(low) - 0.4, 0.6):.1f}" '
                f'height="{bottom - y(share):.1f}"><title>{tip}</title></rect>'
            )
    if outline is not None:
        points = [
            f"{x(edge):.1f},{y(share):.1f}"
            for low, high, share in zip(bars.edges[:-1], bars.edges[1:], outline, strict=True)
            for edge in (low, high)
        ]
        parts.append(f'<polyline class="outline" points="{" ".join(points)}"/>')
    for value, name in marks:
        if bars.edges[0] <= value <= bars.edges[-1]:
            parts.append(
                f'<line class="mark" x1="{x(value):.1f}" x2="{x(value):.1f}" y1="{_TOP}" y2="{bottom}">'
                f"<title>{escape(name)}</title></line>"
            )
    parts.append(f'<line class="axis" x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{bottom}" y2="{bottom}"/>')
    ends = float(bars.edges[0]), float(bars.edges[-1])
    parts += [
        f'<text class="tick" x="{x(tick):.1f}" y="{bottom + 15}" text-anchor="middle">{tick:g}</text>'
        f'<line class="axis" x1="{x(tick):.1f}" x2="{x(tick):.1f}" y1="{bottom}" y2="{bottom + 3}"/>'
        for tick in (log_ticks(*ends) if bars.log else linear_ticks(*ends, _TICKS))
    ]
    parts.append(
        f'<text class="label" x="{(_LEFT + _WIDTH - _RIGHT) / 2}" y="{_HEIGHT - 5}" text-anchor="middle">'
        f"{escape(axis)}</text></svg>"
    )
    return "".join(parts)


def linear_ticks(low: float, high: float, most: int) -> list[float]:
    """Return multiples of 1, 2 or 5 times a power of ten from ``low`` to ``high``: at most ``most``, or one more."""
    rough = (high - low) / most
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough * (1 - 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [round(number * step, 12) for number in range(first, last + 1)]


def log_ticks(low: float, high: float) -> list[float]:
    """Return 1, 2 and 5 times powers of ten from ``low`` to ``high``; powers alone where there would be too many."""
    powers = range(math.floor(math.log10(low)) - 1, math.ceil(math.log10(high)) + 2)
    for factors in ((1, 2, 5), (1, 3), (1,)):
        ticks = [factor * 10.0**power for power in powers for factor in factors]
        ticks = [float(f"{tick:.6g}") for tick in ticks if low <= tick <= high]
        if len(ticks) <= 2 * _TICKS:
            break
    return ticks if len(ticks) > 1 else linear_ticks(low, high, _TICKS)
