"""Parts of the reports of measurements: the machine, statistics of errors, the Pareto front, tables."""

import os
import platform
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.bench.timing import Timing

_PACKAGES = ("semisynth-gl", "moderngl", "numpy", "isal", "Pillow", "blosc2")


def error_stats(values: NDArray[np.floating], truth: NDArray[np.float64]) -> dict[str, Any]:
    """Compare values, px, with the truth, an array of the same shape.

    Returns:
        "median_px", "p999_px" (the 99.9th percentile) and "worst_px": absolute errors over the pixels that are finite
        in both arrays, NaN if there are none. "missing": the number of pixels that are finite in only one of them.
    """
    finite = np.isfinite(values) & np.isfinite(truth)
    error = np.abs(values[finite].astype(np.float64) - truth[finite])
    quantiles = np.quantile(error, [0.5, 0.999, 1]).tolist() if error.size else [np.nan] * 3
    missing = int((np.isfinite(values) != np.isfinite(truth)).sum())
    return dict(zip(("median_px", "p999_px", "worst_px", "missing"), (*quantiles, missing), strict=True))


def front(points: Mapping[str, Sequence[float]], tolerance: float = 0.05) -> set[str]:
    """Return the names of the points on the Pareto front, which no other point dominates; smaller values are better.

    A point dominates another if at least one of its values is smaller by more than the tolerance, and none is larger by
    more than that. All points have equally many values. The tolerance is relative: repeated timings differ by 5 %.
    """

    def dominates(point: Sequence[float], rival: Sequence[float]) -> bool:
        pairs = list(zip(point, rival, strict=True))
        return all(a <= b * (1 + tolerance) for a, b in pairs) and any(a * (1 + tolerance) < b for a, b in pairs)

    return {name for name, own in points.items() if not any(dominates(point, own) for point in points.values())}


def alternative_rows(
    texts: Mapping[str, str],
    times: Mapping[str, Timing],
    figures: Mapping[str, Mapping[str, Any]],
    weighed: Mapping[str, Sequence[float]],
) -> list[dict[str, Any]]:
    """Return a row for each alternative, in the order of ``texts``.

    All arguments go by the names of the alternatives.

    Args:
        texts: descriptions.
        times: times for a pair, relative to the default's.
        figures: further keys and values of the row.
        weighed: the values besides time that decide about the Pareto front, smaller being better. An alternative
            without such values is never on the front.

    Returns:
        Rows with "name", "text", "seconds_per_pair", "time_ratio", the keys of ``figures``, and "on_front".
    """
    best = front({name: (times[name].ratio, *values) for name, values in weighed.items()})
    return [
        {
            "name": name,
            "text": text,
            "seconds_per_pair": times[name].seconds,
            "time_ratio": times[name].ratio,
            **figures[name],
            "on_front": name in best,
        }
        for name, text in texts.items()
    ]


def machine_facts() -> dict[str, object]:
    """Return today's date (UTC), processor, cores, system, and versions of Python and packages, in JSON's types."""
    return {
        "date": datetime.now(UTC).date().isoformat(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": _versions(),
    }


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]], *, text_last: bool = True) -> str:
    """Return a Markdown table whose columns line up in plain text too.

    The first column, and with ``text_last`` the last one, are aligned to the left, the others, which are numbers, to
    the right. Each row has as many cells as the head.
    """
    to_left = (0, len(head) - 1) if text_last else (0,)
    widths = [max(len(row[column]) for row in (head, *rows)) for column in range(len(head))]

    def line(cells: Sequence[str]) -> str:
        padded = [
            cell.ljust(width) if column in to_left else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(cells, widths, strict=True))
        ]
        return f"| {' | '.join(padded)} |"

    rule = ["-" * width if column in to_left else "-" * (width - 1) + ":" for column, width in enumerate(widths)]
    return "\n".join([line(head), line(rule), *(line(row) for row in rows)])


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def _versions() -> dict[str, str]:
    versions = {}
    for package in _PACKAGES:
        with suppress(PackageNotFoundError):
            versions[package] = version(package)
    return versions
