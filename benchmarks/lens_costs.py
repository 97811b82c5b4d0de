"""What lenses cost beside the same pairs without: drawn, seen and checked, not encoded.

What counts is the processor's time, of all threads:

    python benchmarks/lens_costs.py > benchmarks/results/lens-costs.txt
"""

import argparse
import time
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from itertools import count, islice
from typing import Any

import numpy as np

from semisynth_gl import PairRenderer, load_config
from semisynth_gl.bench.timing import alternated

_PLAIN = "without"
_FOCAL_PX = 1800.0


def lens(ratio: float, ranges: list[float]) -> dict[str, Any]:
    """Return the overrides of a lens as large as the images, with so many raw pixels to a rectified one."""
    eye = {
        "fx_px": [_FOCAL_PX * ratio * each for each in ranges],
        "distortion": [-0.25, 0.08, 0.001, 0],
        "rotation_deg": [0.2, 0.5, 0.3],
    }
    size = {"raw_width_px": round(1500 * max(ratio, 1)), "raw_height_px": round(1000 * max(ratio, 1))}
    return {"lens": size | {"left": eye, "right": eye}, "outputs": ["visibility", "valid"]}


def main() -> None:
    """Render pairs of all in turn, and print times and ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--turns", type=int, default=6)
    parser.add_argument("--pairs", type=int, default=4, help="pairs of each in a turn")
    options = parser.parse_args()
    overrides: dict[str, dict[str, Any]] = {
        _PLAIN: {"outputs": ["visibility"]},
        "one lens": lens(0.95, [1, 1]),
        "another lens for each pair": lens(0.95, [0.99, 1]),
        "one lens, 1.4 raw pixels to a rectified one": lens(1.4, [1, 1]),
    }
    with ExitStack() as stack:
        renderers = {}
        for name, values in overrides.items():
            config = load_config("middlebury", {"camera": {"focal_px": _FOCAL_PX}} | values)
            renderers[name] = stack.enter_context(PairRenderer(config, 1))
            renderers[name].render(0)  # the first one compiles shaders
        tasks = {name: partial(_render, renderer, count(1), options.pairs) for name, renderer in renderers.items()}
        times = alternated(tasks, options.turns, time.process_time)
        drawn_by = renderers[_PLAIN].renderer_name
    print(f"middlebury, {drawn_by}: {options.turns} turns of {options.pairs} pairs each, in one process")
    for name, seconds in times.items():
        ratio = seconds / times[_PLAIN]
        print(
            f"{name:45} {np.mean(seconds) / options.pairs:.3f} s of CPU a pair, {ratio.mean():.2f} "
            f"({ratio.min():.2f} to {ratio.max():.2f} in single turns)"
        )


def _render(renderer: PairRenderer, numbers: Iterator[int], pairs: int) -> None:
    for number in islice(numbers, pairs):
        renderer.render(number)


if __name__ == "__main__":
    main()
