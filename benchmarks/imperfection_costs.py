"""What each imperfection costs: of an image a megapixel, and motion blur beside all that a pair takes without it.

What counts is the processor's time, of all threads:

    python benchmarks/imperfection_costs.py > benchmarks/results/imperfection-costs.txt
"""

import argparse
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from functools import partial
from itertools import count

import numpy as np
from timing import alternated

from semisynth_gl import PairRenderer, load_config
from semisynth_gl.pairs.imperfections import Imperfections, apply_imperfections

_IMAGE = {
    "lens blur of 1 px": Imperfections(blur_px=1.0),
    "vignetting": Imperfections(vignetting=0.3),
    "exposure": Imperfections(exposure_stops=0.3),
    "white balance": Imperfections(white_balance=(0.1, -0.1)),
    "noise": Imperfections(noise=3.0),
    "gamma": Imperfections(gamma=1.1),
    "sharpening": Imperfections(sharpening=0.5),
    "JPEG of quality 75": Imperfections(jpeg_quality=75),
    "JPEG of quality 95": Imperfections(jpeg_quality=95),
    "vignetting, white balance, noise and gamma": Imperfections(
        vignetting=0.3, white_balance=(0.1, -0.1), noise=3.0, gamma=1.1
    ),
    "noise and gamma alone": Imperfections(noise=3.0, gamma=1.1),
}
_SUB_FRAMES = (3, 7, 15)


def main() -> None:
    """Measure images, then pairs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--configs", nargs="+", default=["middlebury", "sceneflow"])
    parser.add_argument("--turns", type=int, default=7)
    options = parser.parse_args()
    for name in options.configs:
        with ExitStack() as stack:
            clutter = ("scenes=[]", "textures.large_px=0", "camera.sway_m=0.02")
            blurred = {
                f"motion blur, {frames} sub-frames": (f"imperfections={{motion_blur: 0.5, sub_frames: {frames}}}",)
                for frames in _SUB_FRAMES
            }
            renderers = {
                kind: stack.enter_context(PairRenderer(load_config(name, [*clutter, *keys]), 1))
                for kind, keys in ({"no imperfections": ()} | blurred).items()
            }
            first = [renderer.render(0) for renderer in renderers.values()]  # it compiles shaders
            if name == options.configs[0]:
                measure_images(first[0].frame.left.image, options.turns)
            tasks = {kind: partial(_render, renderer, count(1)) for kind, renderer in renderers.items()}
            print(f"\nclutter of {name} whose camera sways, drawn by {renderers['no imperfections'].renderer_name}:")
            say(alternated(tasks, options.turns, time.process_time))


def _render(renderer: PairRenderer, numbers: Iterator[int]) -> None:
    renderer.render(next(numbers))


def measure_images(image: np.ndarray, turns: int) -> None:
    """Print the milliseconds of each imperfection a megapixel."""
    megapixels = image.shape[0] * image.shape[1] / 1e6
    print(f"an image of {image.shape[1]} x {image.shape[0]} pixels, {turns} turns: CPU ms a megapixel, median (least)")

    rng = np.random.default_rng(0)
    tasks = {name: partial(apply_imperfections, image, drawn, rng) for name, drawn in _IMAGE.items()}
    for name, seconds in alternated(tasks, turns, time.process_time).items():
        each = 1e3 * seconds / megapixels
        print(f"{name:43} {np.median(each):6.1f} ({each.min():.1f})")


def say(seconds: Mapping[str, np.ndarray]) -> None:
    """Print the seconds of pairs, and their ratios to those of the same pairs in the first row."""
    plain = next(iter(seconds.values()))
    for name, each in seconds.items():
        ratio = each / plain
        print(
            f"{name:28} {np.mean(each):.2f} s of CPU a pair, {np.median(ratio):.2f} times as much "
            f"({ratio.min():.2f} to {ratio.max():.2f})"
        )


if __name__ == "__main__":
    main()
