"""What a pair of each recipe of a config, and of the mix, costs beside clutter alone: drawn and checked, not encoded.

What counts is the processor's time, of all threads:

    python benchmarks/recipe_costs.py > benchmarks/results/recipe-costs.txt
"""

import argparse
import time
from contextlib import ExitStack

import numpy as np

from semisynth_gl import PairRenderer, load_config

_CLUTTER_ALONE = ("scenes=[]", "textures.large_px=0")


def main() -> None:
    """Render pairs of all in turn, and print times and ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--config", default="middlebury")
    parser.add_argument("--turns", type=int, default=6)
    parser.add_argument("--pairs", type=int, default=4, help="pairs of each in a turn")
    options = parser.parse_args()
    mix = load_config(options.config)
    configs = {"clutter alone": load_config(options.config, _CLUTTER_ALONE), "the mix": mix}
    configs |= {f"recipe {recipe.name}": recipe.config for recipe in mix.recipes()}
    times: dict[str, list[float]] = {name: [] for name in configs}
    with ExitStack() as stack:
        renderers = {name: stack.enter_context(PairRenderer(config, 1)) for name, config in configs.items()}
        for renderer in renderers.values():
            renderer.render(0)  # the first one compiles shaders
        for turn in range(options.turns):
            for name, renderer in renderers.items():
                start = time.process_time()
                for index in range(options.pairs):
                    renderer.render(1 + turn * options.pairs + index)
                times[name].append((time.process_time() - start) / options.pairs)
        drawn_by = next(iter(renderers.values())).renderer_name
    clutter = np.array(times["clutter alone"])
    print(f"{options.config}, {drawn_by}: {options.turns} turns of {options.pairs} pairs each, in one process")
    for name, seconds in times.items():
        ratio = np.array(seconds) / clutter
        low, high = ratio.min(), ratio.max()
        print(
            f"{name:20} {np.mean(seconds):.3f} s of CPU a pair, {ratio.mean():.2f} of clutter alone "
            f"({low:.2f} to {high:.2f} in single turns)"
        )


if __name__ == "__main__":
    main()
