"""Parts of the reports of measurements: the machine, statistics of errors, tables."""

import os
import platform
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_PACKAGES = ("semisynth-gl", "moderngl", "numpy", "isal", "Pillow")


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


def machine_facts() -> dict[str, object]:
    """Return today's date (UTC), processor, cores, system, and versions of Python and packages, in JSON's types."""
    cpuinfo = Path("/proc/cpuinfo")
    model = re.search(r"model name\s*: (.*)", cpuinfo.read_text("utf-8") if cpuinfo.exists() else "")
    return {
        "date": datetime.now(UTC).date().isoformat(),
        "processor": model[1] if model else platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": {name: version(name) for name in _PACKAGES},
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
