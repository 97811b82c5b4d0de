"""What monochrome cameras save: CPU seconds and bytes of a pair, beside the same pair in colour.

    python benchmarks/grey.py --json benchmarks/results/grey.json

Draws the pairs of a config both ways, in turns within one process, and encodes each for a layout of one channel and for
one of three equal channels. Times are the process's own, user and system, so that other work on the machine counts as
little as it can; the driver draws in this thread.
"""

import json
import os
import time
from collections import Counter, defaultdict
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path

os.environ.setdefault("LP_NUM_THREADS", "0")  # before OpenGL

import click
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.bench.summary import machine_facts
from semisynth_gl.config import Config, load_config
from semisynth_gl.dataset.sample import encode_pair
from semisynth_gl.layouts import Key, find_layout
from semisynth_gl.layouts.layout import Layout
from semisynth_gl.pairs.pipeline import Pair, PairRenderer

COLOURS = ("rgb", "grey")
# What writes one channel, and what writes three equal ones.
LAYOUTS = {"one channel": "webdataset", "three equal channels": "middlebury"}
IMAGES = ("im0.png", "im1.png", ".left.png", ".right.png")

Sizes = dict[str, dict[str, Counter[str]]]


class Stages:
    """Adds up CPU seconds by stage, each since the last one ended."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self.last = time.process_time()

    def on_stage(self, stage: str) -> None:
        """End a stage."""
        last, self.last = self.last, time.process_time()
        self.seconds[stage] += self.last - last


def encoded(layout: Layout, config: Config, pair: Pair) -> dict[str, bytes]:
    """Return the files of a pair."""
    key = Key(config.name, "train", pair.index)
    encodings = layout.encodings_for(config)
    return encode_pair(layout, key, pair.frame, pair.provenance, 512, encodings).files


def turn(
    renderers: Mapping[str, PairRenderer], numbers: range, sizes: Sizes, *, flipped: bool
) -> dict[str, dict[str, float]]:
    """Make some pairs both ways; return the CPU seconds of a pair by colour and stage, and add up bytes."""
    clocks = {colour: Stages() for colour in renderers}
    for number in numbers:
        for colour in COLOURS[:: -1 if flipped else 1]:
            stages, renderer = clocks[colour], renderers[colour]
            stages.last = time.process_time()
            renderer.listener = stages
            pair = renderer.render(number)
            for way, layout in LAYOUTS.items():
                stages.last = time.process_time()
                files = encoded(find_layout(layout), renderer.config, pair)
                stages.on_stage(f"encode, {way}")
                images = [data for path, data in files.items() if path.endswith(IMAGES)]
                sizes[colour][way].update(images=sum(map(len, images)), all=sum(map(len, files.values())))
    seconds = {}
    for colour, stages in clocks.items():
        each = {stage: value / len(numbers) for stage, value in stages.seconds.items()}
        drawn = sum(value for stage, value in each.items() if not stage.startswith("encode"))
        seconds[colour] = each | {f"whole pair, {way}": drawn + each[f"encode, {way}"] for way in LAYOUTS}
    return seconds


def row(rgb_s: NDArray[np.float64], grey_s: NDArray[np.float64]) -> dict[str, float]:
    """Return the figures of a stage's turns: what both share is compared in each turn."""
    ratios = grey_s / np.maximum(rgb_s, 1e-9)
    figures = {"rgb_s": rgb_s.mean(), "grey_s": grey_s.mean(), "ratio": np.median(ratios)}
    figures |= {"least_ratio": ratios.min(), "largest_ratio": ratios.max()}
    return {name: float(f"{value:.4g}") for name, value in figures.items()}


@click.command(help=__doc__.splitlines()[0])
@click.option("--config", "name", default="middlebury", show_default=True)
@click.option("--pairs", default=4, show_default=True, help="Pairs of each kind in a turn.")
@click.option("--turns", default=8, show_default=True)
@click.option("--json", "out", type=Path, help="Also write the figures here.")
def main(name: str, pairs: int, turns: int, out: Path | None) -> None:
    """Measure and print."""
    configs = {colour: load_config(name, [f"camera.colour={colour}"]) for colour in COLOURS}
    sizes: Sizes = {colour: {way: Counter() for way in LAYOUTS} for colour in COLOURS}
    with ExitStack() as stack:
        renderers = {colour: stack.enter_context(PairRenderer(config, 0)) for colour, config in configs.items()}
        for renderer in renderers.values():
            renderer.render(0)
        measured = [
            turn(renderers, range(1 + number * pairs, 1 + (number + 1) * pairs), sizes, flipped=number % 2 == 1)
            for number in range(turns)
        ]
        facts = machine_facts() | renderers["rgb"].facts
    rows = {
        stage: row(*(np.array([each[colour][stage] for each in measured]) for colour in COLOURS))
        for stage in measured[0]["rgb"]
    }
    click.echo(f"{'stage':36} {'rgb, ms':>9} {'grey, ms':>9} {'ratio':>6}   turns")
    for stage, figures in rows.items():
        rgb_s, grey_s, ratio, least, largest = figures.values()
        click.echo(f"{stage:36} {1e3 * rgb_s:9.2f} {1e3 * grey_s:9.2f} {ratio:6.3f}   {least:.3f} to {largest:.3f}")
    count = pairs * turns
    stored = {
        colour: {way: {what: round(size / count) for what, size in each.items()} for way, each in ways.items()}
        for colour, ways in sizes.items()
    }
    click.echo(f"bytes of a pair: {json.dumps(stored)}")
    if out is not None:
        report = {"config": name, "pairs": count, "turns": turns, "machine": facts, "stages": rows}
        out.write_text(json.dumps(report | {"bytes_per_pair": stored}, indent=1) + "\n")


if __name__ == "__main__":
    main()
