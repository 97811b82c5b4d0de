"""Figures as a table for the terminal, with each benchmark's own decimals."""

from collections.abc import Sequence

import numpy as np

from semisynth_gl.metrics.evaluate import Evaluated, figures_of
from semisynth_gl.metrics.protocol import Protocol

_COMMON = ("bad-0.5", "bad-1", "bad-2", "bad-4", "D1-all", "rms", "A50", "A90", "A95", "A99")
_ORDER = (
    *("bad-0.5", "bad-1", "bad-2", "bad-4", "D1-bg", "D1-fg", "D1-all", "D1-est", "avgerr", "epe", "rms"),
    *("A50", "A90", "A95", "A99", "coverage", "invalid"),
)


def table_of(evaluated: Sequence[Evaluated], region: str, protocol: Protocol) -> list[str]:
    """Return the lines of a table: a row for each pair, and the last for all together.

    Args:
        evaluated: at least one pair.
        region: one that a pair has.
        protocol: by which.
    """
    together = figures_of(evaluated, region)
    columns = [name for name in _ORDER if name in together and (name in _COMMON or name in protocol.columns)]
    headings = [protocol.columns.get(name, name) for name in columns]
    last = "pooled" if protocol.pooled else "mean"
    rows = [
        (name, [_shown(figures.get(column), protocol) for column in columns])
        for name, figures in [*((each.name, figures_of([each], region)) for each in evaluated), (last, together)]
    ]
    first = max(len(name) for name, _ in rows)
    widths = [max(len(text) for text in column) for column in zip(headings, *(cells for _, cells in rows), strict=True)]
    unit = "%" if protocol.percent else "fractions"
    lines = [f"{region} pixels; shares in {unit}, errors in px"]
    lines += [
        "  ".join([name.ljust(first), *(cell.rjust(width) for cell, width in zip(cells, widths, strict=True))])
        for name, cells in [("", headings), *rows]
    ]
    return lines


def _shown(value: float | None, protocol: Protocol) -> str:
    if value is None or np.isnan(value):
        return "-" if value is None else "nan"
    # The evaluator prints a float32: what it rounds to decides the last digit.
    printed = float(np.float32(value)) if protocol.single else value
    return format(printed, protocol.decimals)
