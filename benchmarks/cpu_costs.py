"""Processor time of `middlebury` pairs: with outlines smoothed against without, and by parts.

    LP_NUM_THREADS=0 python benchmarks/cpu_costs.py edges 16 4    # pairs, turns
    LP_NUM_THREADS=0 python benchmarks/cpu_costs.py parts 24 FOLDER    # pairs, folder for the files

"edges" renders each pair with both modes in turns. "parts" makes pairs as `generate` does, after eight pairs that do
not count, and splits the time of each; what a part calls that is a part itself counts there only.
"""

import hashlib
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import numpy as np

from semisynth_gl.codecs.pfm import Pfm
from semisynth_gl.codecs.png import Png
from semisynth_gl.config import Config, load_config
from semisynth_gl.dataset import make
from semisynth_gl.dataset.engines import keep_freed_memory
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.dataset.root import open_root
from semisynth_gl.listener import Listener
from semisynth_gl.pairs import pipeline
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.render.instance_transforms import TransformComposer
from semisynth_gl.render.model_buffers import ModelBuffers

_WARM = 8


def edges(config: Config, pairs: int, turns: int) -> None:
    """Print the time to render each pair with the modes none and edges, and the ratio."""
    plain = PairRenderer(config, 0)
    smooth = PairRenderer(config.model_copy(update={"antialias": "edges"}), 0)
    medians = []
    for index in range(pairs):
        scene = plain.sampler.sample(index).scene
        plain.renderer.render(scene)
        smooth.renderer.render(scene)
        times = np.zeros((turns, 2))
        for turn in range(turns):
            for mode in (0, 1) if turn % 2 else (1, 0):
                start = time.process_time()
                (plain, smooth)[mode].renderer.render(scene)
                times[turn, mode] = time.process_time() - start
        none, both = np.median(times, axis=0) * 1e3
        medians.append((none, both))
        print(f"{index:4d} {len(scene):6d} {none:9.1f} {both:9.1f} {both / none:7.3f}", flush=True)
    total = np.array(medians)
    print(f"median {np.median(total[:, 1] / total[:, 0]):.3f}, sum {total[:, 1].sum() / total[:, 0].sum():.3f}")


class _Parts(Listener):
    """Adds up the processor time of stages, and of functions within them."""

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._last = time.process_time()
        self._inner = 0.0

    def on_stage(self, stage: str) -> None:
        now = time.process_time()
        self.seconds[stage] += now - self._last - self._inner
        self._last, self._inner = now, 0.0

    def clear(self) -> None:
        self.seconds.clear()
        self._last, self._inner = time.process_time(), 0.0

    def split(self, owner: Any, name: str, part: str) -> None:  # noqa: ANN401 - a class or a module
        """Count a function of a class or module as a part."""
        original: Callable[..., Any] = getattr(owner, name)

        def timed(*arguments: object, **options: object) -> Any:  # noqa: ANN401 - as the function
            start, before = time.process_time(), self._inner
            result = original(*arguments, **options)
            taken = time.process_time() - start
            self.seconds[part] += taken - (self._inner - before)
            self._inner = before + taken
            return result

        setattr(owner, name, timed)


def parts(config: Config, pairs: int, folder: str) -> None:
    """Print the milliseconds that each part of a pair takes."""
    keep_freed_memory()
    clock = _Parts()
    clock.split(TransformComposer, "compose", "transforms of instances")
    clock.split(ModelBuffers, "fill", "ordering and uploading instances")
    clock.split(Png, "encode", "PNG")
    clock.split(Pfm, "encode", "PFM")
    clock.split(hashlib, "sha256", "SHA-256")
    clock.split(make, "write", "writing files")
    clock.split(pipeline, "faults", "checks")
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        job = make.Job(make_plan(config, 0, "middlebury", {"train": _WARM + pairs}, 1), scratch, "auto")
        with make.open_renderer(job, "train") as renderer:
            renderer.renderer.listener = clock
            for shard in job.plan.shards:
                if shard.first == _WARM:
                    clock.clear()
                encoded = make.encode(job.plan, shard, renderer.render(shard.first))
                clock.on_stage("encoding: the rest")
                make.write_shard(open_root(scratch), job.plan, shard, [encoded])
                clock.on_stage("records: JSON")
    for part, seconds in sorted(clock.seconds.items(), key=lambda item: -item[1]):
        print(f"{part:34s} {seconds / pairs * 1e3:8.2f}")
    drawing = clock.seconds["draw"] + clock.seconds["visibility"]
    print(f"all but drawing and masks {(sum(clock.seconds.values()) - drawing) / pairs * 1e3:.1f}")


if __name__ == "__main__":
    if sys.argv[1] == "edges":
        edges(load_config("middlebury"), int(sys.argv[2]), int(sys.argv[3]))
    else:
        parts(load_config("middlebury"), int(sys.argv[2]), sys.argv[3])
