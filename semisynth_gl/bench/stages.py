"""Costs of a pair's stages and of the passes that draw it, and the stage that limits the pairs per second.

Stages are timed one by one: the driver finishes each before the next begins.
"""

import shutil
import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from semisynth_gl.dataset.documents import Shard
from semisynth_gl.dataset.make import Job, encode
from semisynth_gl.dataset.root import open_root
from semisynth_gl.dataset.shard import write_shard
from semisynth_gl.frame.camera import EYES
from semisynth_gl.listener import Listener
from semisynth_gl.pairs.pipeline import PAIR_STAGES, PairRenderer
from semisynth_gl.render.pass_clock import PASSES, PassName, PassSeconds

STAGES = (*PAIR_STAGES, "encode", "write")
"""The stages of a pair in a dataset, in order: first the renderer's, then the encoding and writing of the files."""

STAGE_TEXTS: Mapping[str, str] = {
    "sample": "what stands where",
    "draw": "colour, disparity and surfaces of both eyes",
    "visibility": "both masks",
    "readback": "from the driver into arrays",
    "check": "cheap checks of the pair, imperfections, provenance",
    "encode": "PNG and PFM in memory",
    "write": "files into the dataset's folder",
}
PASS_TEXTS: Mapping[PassName, str] = {
    "draw": "colour, disparity and surfaces, one sample a pixel",
    "edges": "outlines smoothed",
    "samples": "colour once more, several samples a pixel",
    "resolve": "one sample of several",
    "masks": "what the other eye sees",
    "correspondence": "where the other eye sees it, and whether, in pairs that are not rectified",
    "moment": "depth and surfaces at the other moment",
    "flow": "the way to the other moment",
    "read": "into arrays",
}
_ON_THE_GPU = ("draw", "visibility", "readback")
PROCESSOR = "processor"


class Costs(NamedTuple):
    """Costs of one stage of one pair.

    Attributes:
        seconds: time on the clock.
        cpu_seconds: processor time of all threads of the process together.
        result_bytes: size of the stage's result; None where the result stays with the driver or is small.
    """

    seconds: float
    cpu_seconds: float
    result_bytes: int | None


class PairTimes(NamedTuple):
    """Times of one pair.

    Attributes:
        costs: the costs of each stage, each finished before the next began.
        passes: the time of each pass that ran.
        queries: whether the GPU's timer queries timed the passes, or else the processor's clock did.
        facts: `Renderer.facts`.
    """

    costs: Mapping[str, Costs]
    passes: PassSeconds
    queries: bool
    facts: dict[str, str]


class _StageClock(Listener):
    """Adds up, for each stage of a pair, the time on the clock and the processor time, s."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(STAGES, 0.0)
        self.cpu_seconds = dict.fromkeys(STAGES, 0.0)
        self._last = time.perf_counter(), time.process_time()

    def on_stage(self, stage: str) -> None:
        last, self._last = self._last, (time.perf_counter(), time.process_time())
        self.seconds[stage] += self._last[0] - last[0]
        self.cpu_seconds[stage] += self._last[1] - last[1]


def time_pair(job: Job, renderer: PairRenderer, shard: Shard) -> PairTimes:
    """Time the stages of a shard's pair, then its passes; passed to `measure_pairs`."""
    # The first time that the pair is made, since the sampler keeps the latest scene.
    renderer.listener = clock = _StageClock()
    array_bytes, file_bytes = _write(job, renderer, shard, clock)
    renderer.listener = None
    renderer.clock.start()
    renderer.render(shard.first)
    passes = renderer.clock.stop()
    sizes = {"readback": array_bytes, "encode": file_bytes, "write": file_bytes}
    costs = {stage: Costs(clock.seconds[stage], clock.cpu_seconds[stage], sizes.get(stage)) for stage in STAGES}
    return PairTimes(costs, passes, renderer.clock.queries, renderer.facts)


def _write(job: Job, renderer: PairRenderer, shard: Shard, listener: Listener) -> tuple[int, int]:
    """Make a pair as `write_pairs` does; return the bytes of its arrays and of its files, which are removed."""
    pair = renderer.render(shard.first)
    encoded = encode(job.plan, shard, pair)
    listener.on_stage("encode")
    # Writing includes the shard's record, which takes less time per pair in a shard of more pairs.
    write_shard(open_root(job.address), job.plan, shard, [encoded])
    listener.on_stage("write")
    shutil.rmtree(job.address)
    return sum(array.nbytes for array in pair.frame.arrays().values()), sum(map(len, encoded.files.values()))


def stage_rows(pairs: Sequence[Mapping[str, Costs]], cores: int, *, software: bool) -> list[dict[str, Any]]:
    """Average the costs of pairs on a machine with ``cores`` usable cores and a software renderer or a GPU.

    Returns:
        A row for each of `STAGES`, then a row for the processor's part of all stages. "name" and "text" say which;
        "seconds", "cpu_seconds" and "bytes_per_pair" are means over the pairs; "share" is the stage's share of the time
        of all stages. "allows_per_second" is the number of pairs per second if pairs consisted only of this stage: on
        the GPU one pair after the other, on the processor with all cores at work.
    """
    costs = np.array([[pair[stage][:2] for stage in STAGES] for pair in pairs])
    seconds, processor = np.moveaxis(costs, -1, 0).mean(axis=1).tolist()
    total = sum(seconds)

    def row(name: str, text: str, wall: float, cpu: float, size: float | None, *, on_gpu: bool) -> dict[str, Any]:
        return {
            "name": name,
            "text": text,
            "seconds": wall,
            "cpu_seconds": cpu,
            "share": wall / total,
            "bytes_per_pair": size,
            # A microsecond stands for times below the clock's resolution.
            "allows_per_second": 1 / max(wall, 1e-6) if on_gpu else cores / max(cpu, 1e-6),
        }

    rows = []
    for stage, wall, cpu in zip(STAGES, seconds, processor, strict=True):
        sizes = [size for pair in pairs if (size := pair[stage].result_bytes) is not None]
        mean = float(np.mean(sizes)) if len(sizes) == len(pairs) else None
        on_gpu = stage in _ON_THE_GPU and not software
        rows.append(row(stage, STAGE_TEXTS[stage], wall, cpu, mean, on_gpu=on_gpu))
    text = "all of the above" if software else "the processor's part of all of the above"
    return [*rows, row(PROCESSOR, text, total, sum(processor), None, on_gpu=False)]


def pass_rows(pairs: Sequence[PassSeconds]) -> list[dict[str, Any]]:
    """Average the times of the passes of pairs; return a row for each pass and eye that ran, in the order of `PASSES`.

    "seconds" is the mean over all pairs, also those without the pass.
    """
    rows = []
    for name in PASSES:
        for eye in EYES:
            seconds = [pair[name, eye] for pair in pairs if (name, eye) in pair]
            if seconds:
                mean = float(np.sum(seconds)) / len(pairs)
                rows.append({"name": name, "eye": eye, "text": PASS_TEXTS[name], "seconds": mean})
    return rows


def speed_limit(
    rows: Sequence[Mapping[str, Any]], cores: int, reached_per_second: float, shares: Sequence[float]
) -> dict[str, Any]:
    """Return the limit of pairs per second of a run, and the share of the limit that the run reached.

    A pair goes through all stages, so no run is faster than the narrowest (slowest) stage allows alone, nor faster than
    the processor can do its part of all stages. If the processor draws, its limit is always the lower one.

    Args:
        rows: from `stage_rows`.
        cores: number of usable cores.
        reached_per_second: pairs per second of the run.
        shares: for each round, its pairs per second divided by the limit of its stages.

    Returns:
        "narrowest_stage" and "narrowest_allows_per_second"; "by", the name of the row that sets the limit, and
        "allows_per_second", the limit; "share", the median share; and "cores", "reached_per_second" and "shares".
    """
    limit = min(rows, key=lambda row: row["allows_per_second"])
    narrowest = min(rows[:-1], key=lambda row: row["allows_per_second"])  # the last row is the processor's
    return {
        "cores": cores,
        "narrowest_stage": narrowest["name"],
        "narrowest_allows_per_second": narrowest["allows_per_second"],
        "by": limit["name"],
        "allows_per_second": limit["allows_per_second"],
        "reached_per_second": reached_per_second,
        "share": float(np.median(shares)),
        "shares": list(shares),
    }
