"""What lenses and a projector cost beside the same pairs without: drawn, seen and checked, not encoded.

What counts is the processor's time, of all threads:

    python benchmarks/rig_costs.py > benchmarks/results/rig-costs.txt
"""

import argparse
from typing import Any

from recipe_costs import compare

from semisynth_gl import load_config

_FOCAL_PX = 1800.0
PROJECTOR = {"power": 2, "ambient": 0.5, "field_of_view_deg": 55, "position_m": [0.1, 0, 0]}


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
        "none": {"outputs": ["visibility"]},
        "one lens": lens(0.95, [1, 1]),
        "another lens for each pair": lens(0.95, [0.99, 1]),
        "one lens, 1.4 raw pixels to a rectified one": lens(1.4, [1, 1]),
        "a projector of 1280 x 800 px": {"outputs": ["visibility"], "projector": PROJECTOR},
    }
    focal = {"camera": {"focal_px": _FOCAL_PX}}
    configs = {name: load_config("middlebury", focal | values) for name, values in overrides.items()}
    compare("middlebury", configs, options.turns, options.pairs)


if __name__ == "__main__":
    main()
