"""Parts of measurement reports: the machine, statistics of errors, tables."""

import os
import platform
import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.inputs.errors import counted

_PACKAGES = ("semisynth-gl", "moderngl", "numpy", "isal", "Pillow")


def error_stats(values: NDArray[np.floating], truth: NDArray[np.float64]) -> dict[str, Any]:
    """Compare values, px, with the truth, an array of the same shape.

    Returns "median_px", "p999_px" (the 99.9th percentile) and "worst_px" of the absolute errors where both are finite,
    or None if they never are, and "missing", the number of elements that are finite in only one of the arrays.
    """
    finite = np.isfinite(values) & np.isfinite(truth)
    error = np.abs(values[finite].astype(np.float64) - truth[finite])
    quantiles = np.quantile(error, [0.5, 0.999, 1]).tolist() if error.size else [None] * 3
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


def headline(report: Mapping[str, Any]) -> str:
    """Return a line on the scenes and the machine of a report."""
    machine = report["machine"]
    cores = counted(machine.get("usable_cores", machine["cores"]), "core")
    width, height = report["size_px"] if "size_px" in report else report["sizes_px"][0]
    return (
        f"{report['config']}, {width} x {height} px, {counted(report['pairs'], 'pair')}; {machine['renderer']}, "
        f"{machine['opengl']}; {machine['processor']}, {cores}; {machine['date']}"
    )


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]], *, text_last: bool = True) -> str:
    """Return a Markdown table that is also aligned as plain text.

    Numbers are aligned to the right: all columns but the first and, with ``text_last``, the last.
    """
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    sides = ["<", *">" * (len(head) - 1 - text_last), *"<" * text_last]
    rule = ["-" * width if side == "<" else "-" * (width - 1) + ":" for side, width in zip(sides, widths, strict=True)]
    lines = (
        " | ".join(f"{cell:{side}{width}}" for cell, side, width in zip(row, sides, widths, strict=True))
        for row in (head, rule, *rows)
    )
    return "\n".join(f"| {line} |" for line in lines)
