"""A wanted histogram from a file: a target of form ``file`` becomes one of form ``histogram`` when a config is read.

So the config holds all that makes its pairs, and a file that changes later changes no dataset that was begun.
"""

import math
from pathlib import Path
from typing import Any

from semisynth_gl.errors import InputError

# Bins of different widths are cut into equal ones of their common measure, up to this many.
_MOST_BINS = 4096
_RESOLUTION_PX = 1e-3
_COLUMNS = 3


def histogram_of_file(path: Path) -> dict[str, Any]:
    """Read a histogram: lines ``low_px,high_px,share``, rising and without gaps; a heading and # comments may stand.

    Raises:
        InputError: where the file cannot be read or a line is wrong, with its number.
    """
    try:
        lines = path.read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: the wanted histogram cannot be read: {error}") from None
    bins: list[tuple[float, float, float]] = []
    for number, line in enumerate(lines, 1):
        text = line.partition("#")[0].strip()
        if not text or (not bins and text.replace(" ", "") == "low_px,high_px,share"):
            continue
        try:
            low, high, share = (float(part) for part in text.split(","))
        except ValueError:
            raise InputError(f"{path}:{number}: expected three numbers, low_px,high_px,share, got {text!r}") from None
        if not (math.isfinite(low) and math.isfinite(high) and low < high and 0 <= share < math.inf):
            raise InputError(f"{path}:{number}: expected low_px < high_px and a share of 0 or more, got {text!r}")
        if bins and abs(bins[-1][1] - low) > _RESOLUTION_PX:
            raise InputError(f"{path}:{number}: expected the bin to begin at {bins[-1][1]:g} px, where the last ends")
        bins.append((low, high, share))
    if not bins:
        raise InputError(f"{path}: no bins: expected lines low_px,high_px,share")
    widths = [max(1, round((high - low) / _RESOLUTION_PX)) for low, high, _ in bins]
    common = math.gcd(*widths)
    if sum(widths) // common > _MOST_BINS:
        raise InputError(
            f"{path}: the bins' widths have no common measure of at least 1/{_MOST_BINS} of the range: "
            "expected widths such as 5 and 10"
        )
    parts = [width // common for width in widths]
    shares = [share / part for (_, _, share), part in zip(bins, parts, strict=True) for _ in range(part)]
    return {
        "form": "histogram",
        "bin_px": round(common * _RESOLUTION_PX, 6),
        "first_px": bins[0][0],
        "shares": shares,
    }
