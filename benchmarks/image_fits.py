"""How well `verify` finds the images of good datasets to fit, whose rigs have imperfections and lenses.

Run it as ``python benchmarks/image_fits.py > benchmarks/results/image-fits.txt``.
"""

import argparse
import tempfile
from pathlib import Path
from typing import Any

from semisynth_gl import generate, load_config, verify

CONFIGS = ("sceneflow", "middlebury", "kitti", "eth3d", "zero-shot")
# As in docs/rigs.md, and as much as two cameras of one rig may differ.
IMPERFECTIONS: dict[str, dict[str, Any]] = {
    "usual": {
        "exposure_stops": [-0.3, 0.3],
        "noise": [1, 4],
        "gamma": [0.9, 1.1],
        "vignetting": [0.1, 0.4],
        "blur_px": [0, 0.6],
        "jpeg_quality": [75, 95],
        "sharpening": [0, 1],
        "white_balance": [-0.1, 0.1],
    },
    "strong": {
        "exposure_stops": [-0.5, 0.5],
        "noise": [1, 6],
        "gamma": [0.7, 1.4],
        "vignetting": [0, 0.5],
        "blur_px": [0, 1.5],
        "jpeg_quality": [60, 95],
        "sharpening": [0, 2],
        "white_balance": [-0.3, 0.3],
    },
}


def lens(config: str) -> dict[str, Any]:
    """Return the overrides of lenses that bend about as wide-angle cameras do, each eye its own."""
    camera = load_config(config).camera
    focal_px = camera.focal_px.high
    left = {"fx_px": focal_px, "distortion": [-0.28, 0.09, 0.001, 0], "rotation_deg": [0.2, 0.5, 0.3]}
    right = {"fx_px": 1.02 * focal_px, "distortion": [-0.25, 0.08, 0, 0.001], "rotation_deg": [0, -0.4, -0.2]}
    sides = {"raw_width_px": camera.width_px, "raw_height_px": camera.height_px}
    return {"lens": sides | {"left": left, "right": right}, "outputs": ["visibility", "valid"]}


def main() -> None:
    """Make and judge datasets, and print the worst values of each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=12)
    options = parser.parse_args()
    print(f"{options.pairs} pairs of each, seed 5: the images' best shift (px) and scale; correlation; findings")
    for config in CONFIGS:
        cases = {name: {"imperfections": values} for name, values in IMPERFECTIONS.items()}
        cases["lens"] = lens(config)
        for name, values in cases.items():
            with tempfile.TemporaryDirectory() as folder:
                place = Path(folder) / "set"
                generate(load_config(config, values), place, pairs=options.pairs, seed=5, layout="middlebury")
                found = verify(place)
            shift, scale = (
                max(abs(each.measures[key]) for each in found.verdicts if key in each.measures)
                for key in ("best_shift_px", "best_scale_times")
            )
            least = min(each.measures.get("image_correlation", 1) for each in found.verdicts)
            print(f"{config:10} {name:6} {shift:.4f} {scale:.5f} {least:.3f} {len(found.findings)}", flush=True)


if __name__ == "__main__":
    main()
