"""Pairs per second by number of workers, and the time of each stage of a pair."""

import os
import tempfile
import time
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from math import ceil
from multiprocessing import get_context
from typing import Any

from semisynth_gl.bench.summary import machine_facts, markdown
from semisynth_gl.config import Config
from semisynth_gl.dataset.engines import LLVMPIPE_THREADS, LocalEngine, cores, keep_freed_memory, threads_each
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.make import DatasetJob, encode, open_renderer, write_shard
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.dataset.root import open_root
from semisynth_gl.inputs.errors import counted
from semisynth_gl.listener import Listener
from semisynth_gl.render import Backend

STAGES: Mapping[str, str] = {
    "sample": "objects and cameras of the scene",
    "draw": "colour, disparity and surfaces of both eyes",
    "visibility": "both masks",
    "readback": "from the driver into arrays",
    "check": "the config's checks, imperfections, provenance",
    "encode": "PNG and PFM in memory",
    "write": "files into the dataset's folder",
}
"""The stages of a pair, in order. `PairRenderer` reports all but the last two."""

_LAYOUT = "middlebury"
# Minimum number of timed pairs per worker.
_PAIRS_EACH = 4


def usual_workers() -> set[int]:
    """Return the powers of two up to the number of usable cores, and this number."""
    return {2**power for power in range(cores().bit_length())} | {cores()}


def measure(
    config: Config, seed: int, backend: Backend, pairs: int = 8, workers: tuple[int, ...] = (), *, listener: Listener
) -> dict[str, Any]:
    """Time the stages of ``pairs`` pairs, and whole runs of `generate` with each number of ``workers``.

    A run has ``pairs`` timed pairs, or four per worker if that is more. By default, the numbers are `usual_workers`.
    The listener gets messages. Raises SemisynthError if the config or OpenGL cannot be used.

    Returns:
        A report in JSON's types: config, seed, image size, number of pairs and machine. Its "stages" are rows with
        "name", "text", mean "seconds" per pair, and "share" of all seconds. Its "workers" are rows with a number of
        "workers", their "pairs_per_second", and the "threads" of llvmpipe in each worker (0 means that llvmpipe draws
        in the calling thread).
    """
    listener.on_message(f"timing the stages of {counted(pairs, 'pair')}")
    # In a new process, since llvmpipe reads its number of threads once.
    with ProcessPoolExecutor(1, get_context("spawn"), os.putenv, (LLVMPIPE_THREADS, "0")) as process:
        facts, seconds = process.submit(_time_stages, config, seed, backend, pairs).result()
    total = sum(seconds.values())
    rows = []
    for count in sorted(set(workers or usual_workers())):
        listener.on_message(f"timing {counted(count, 'worker')}")
        rate = _pairs_per_second(config, seed, backend, count, max(pairs, _PAIRS_EACH * count))
        threads = int(os.environ.get(LLVMPIPE_THREADS) or threads_each(count))
        rows.append({"workers": count, "threads": threads, "pairs_per_second": rate})
    return {
        "config": config.name,
        "config_sha256": config.digest(),
        "seed": seed,
        "size_px": [config.camera.width_px, config.camera.height_px],
        "pairs": pairs,
        "machine": machine_facts() | {"usable_cores": cores()} | facts,
        "stages": [
            {"name": stage, "text": text, "seconds": seconds[stage] / pairs, "share": seconds[stage] / total}
            for stage, text in STAGES.items()
        ],
        "workers": rows,
    }


class _Clock(Listener):
    """Sums the seconds of each stage, and records the time when each pair is finished."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(STAGES, 0.0)
        self.finished: list[float] = []
        self._last = time.perf_counter()

    def on_stage(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[stage] += now - self._last
        self._last = now

    def on_pair(self) -> None:
        self.finished.append(time.perf_counter())


def _time_stages(config: Config, seed: int, backend: Backend, pairs: int) -> tuple[dict[str, str], dict[str, float]]:
    """Return `Renderer.facts`, and the seconds of each stage, summed over the pairs; the stages do not overlap."""
    keep_freed_memory()
    with tempfile.TemporaryDirectory() as scratch:
        job = DatasetJob(make_plan(config, seed, _LAYOUT, {"train": 1 + pairs}, 1), scratch, backend)
        with open_renderer(job, "train") as renderer:
            for shard in job.plan.shards:
                # Pair 0 is not timed, since it allocates buffers and compiles shaders.
                if shard.first <= 1:
                    renderer.renderer.listener = clock = _Clock()
                encoded = encode(job.plan, shard, renderer.render(shard.first))
                clock.on_stage("encode")
                write_shard(open_root(scratch), job.plan, shard, [encoded])
                clock.on_stage("write")
            return renderer.renderer.facts, clock.seconds


def _pairs_per_second(config: Config, seed: int, backend: Backend, workers: int, pairs: int) -> float:
    """Return the pairs per second of a run of `generate`. With w workers, its first 2 w and last w shards do not count.

    In between, all workers are busy.
    """
    length, clock = config.sequence_pairs, _Clock()
    timed = ceil(pairs / length)
    total = (3 * workers + timed) * length
    with tempfile.TemporaryDirectory() as scratch:
        generate(
            config, scratch, total, seed, layout=_LAYOUT, backend=backend, engine=LocalEngine(workers),
            shard_pairs=length, listener=clock,
        )  # fmt: skip
    # The engine reports all pairs of a shard when the shard is complete.
    shard_ends = clock.finished[length - 1 :: length]
    return timed * length / (shard_ends[-1 - workers] - shard_ends[2 * workers - 1])


def table(report: Mapping[str, Any]) -> str:
    """Return the report of `measure` in Markdown: a table of stages and a table of workers."""
    stages = [
        (row["name"], f"{1e3 * row['seconds']:.1f}", f"{100 * row['share']:.0f} %", row["text"])
        for row in report["stages"]
    ]
    workers = [
        (str(row["workers"]), str(row["threads"]), f"{row['pairs_per_second']:.2f}") for row in report["workers"]
    ]
    timed = markdown(("stage", "ms a pair", "share", "what it is"), stages)
    return f"{timed}\n\n{markdown(('workers', 'threads each', 'pairs/s'), workers, text_last=False)}"
