"""What a pair of each recipe of a config, and of the mix, costs beside clutter alone: drawn and checked, not encoded.

What counts is the processor's time, of all threads:

    python benchmarks/recipe_costs.py > benchmarks/results/recipe-costs.txt
"""

import argparse
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from functools import partial
from itertools import count, islice

import numpy as np
from timing import alternated

from semisynth_gl import Config, PairRenderer, load_config

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
    compare(options.config, configs, options.turns, options.pairs)


def compare(title: str, configs: Mapping[str, Config], turns: int, pairs: int) -> None:
    """Render pairs of configs in turn, and print the processor's time of each and its ratio to the first one's."""
    with ExitStack() as stack:
        renderers = {name: stack.enter_context(PairRenderer(config, 1)) for name, config in configs.items()}
        for renderer in renderers.values():
            renderer.render(0)  # the first one compiles shaders
        tasks = {name: partial(_render, renderer, count(1), pairs) for name, renderer in renderers.items()}
        times = alternated(tasks, turns, time.process_time)
        drawn_by = next(iter(renderers.values())).renderer_name
    print(f"{title}, {drawn_by}: {turns} turns of {pairs} pairs each, in one process")
    first, *_ = configs
    for name, seconds in times.items():
        ratio = seconds / times[first]
        print(
            f"{name:{max(map(len, configs))}} {np.mean(seconds) / pairs:.3f} s of CPU a pair, {ratio.mean():.2f} "
            f"of {first} ({ratio.min():.2f} to {ratio.max():.2f} in single turns)"
        )


def _render(renderer: PairRenderer, numbers: Iterator[int], pairs: int) -> None:
    for number in islice(numbers, pairs):
        renderer.render(number)


if __name__ == "__main__":
    main()
