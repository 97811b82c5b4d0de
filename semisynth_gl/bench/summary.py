"""Parts of every report of measurements: the machine, statistics of errors, the front, tables."""

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

_PACKAGES = ("semisynth-gl", "moderngl", "numpy", "isal", "Pillow", "imagecodecs", "blosc2")


def error_stats(values: NDArray[np.floating], truth: NDArray[np.float64]) -> dict[str, Any]:
    """Compare values of any shape, px, with the truth.

    Returns:
        "median_px", "p999_px" (the 99.9th percentile) and "worst_px" of the absolute errors of pixels that are finite
        in both, NaN without such pixels; "missing", the number of pixels that are finite in one of both.
    """
    finite = np.isfinite(values) & np.isfinite(truth)
    error = np.abs(values[finite].astype(np.float64) - truth[finite])
    quantiles = np.quantile(error, [0.5, 0.999, 1]).tolist() if error.size else [np.nan] * 3
    missing = int((np.isfinite(values) != np.isfinite(truth)).sum())
    return dict(zip(("median_px", "p999_px", "worst_px", "missing"), (*quantiles, missing), strict=True))


def front(points: Mapping[str, Sequence[float]], tolerance: float = 0.05) -> set[str]:
    """Return the names of the points that no point dominates.

    A point dominates another where it is smaller in some value by more than the tolerance, and larger in none by more
    than the tolerance.

    Args:
        points: equally many values under each name; smaller is better.
        tolerance: relative; 5 % is what repeated timings differ by.
    """

    def dominates(point: Sequence[float], rival: Sequence[float]) -> bool:
        pairs = list(zip(point, rival, strict=True))
        return all(a <= b * (1 + tolerance) for a, b in pairs) and any(a * (1 + tolerance) < b for a, b in pairs)

    return {name for name, own in points.items() if not any(dominates(point, own) for point in points.values())}


def machine_facts() -> dict[str, object]:
    """Return processor, cores, system, versions and today's date, in JSON's types."""
    return {
        "date": datetime.now(UTC).date().isoformat(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": _versions(),
    }


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]], *, text_last: bool = True) -> str:
    """Lay out a Markdown table whose columns line up in plain text too.

    Args:
        head: names of the columns.
        rows: cells of each row.
        text_last: the last column is text and stands to the left, as the first column does; numbers stand to the right.
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
