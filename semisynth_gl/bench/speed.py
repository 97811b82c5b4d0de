"""Pairs per second by number of workers, and the time of each stage of a pair.

Everything runs in worker processes and writes files, as `generate` does.
"""

import os
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import ceil
from multiprocessing import get_context
from multiprocessing.synchronize import Barrier
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from semisynth_gl.bench.shards import SPLIT, shard_job
from semisynth_gl.bench.summary import machine_facts, markdown
from semisynth_gl.config import Config
from semisynth_gl.dataset.documents import Shard
from semisynth_gl.dataset.engines import THREADS, cores, keep_freed_memory, threads_each
from semisynth_gl.dataset.make import Job, encode, open_renderer, write_pairs
from semisynth_gl.dataset.root import open_root
from semisynth_gl.dataset.shard import write_shard
from semisynth_gl.inputs.errors import counted
from semisynth_gl.listener import Listener
from semisynth_gl.pairs.pipeline import PAIR_STAGES, PairRenderer
from semisynth_gl.render.backends import Backend, is_software

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
PROCESSOR = "processor"
_ON_THE_GPU = ("draw", "visibility", "readback")
# Smallest number of pairs for each worker in a round.
_PAIRS_EACH = 4


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is measured: the options of ``bench speed``. Empty ``workers`` stand for `usual_workers`."""

    pairs: int = 8
    repeats: int = 2
    workers: tuple[int, ...] = ()


class Costs(NamedTuple):
    """The costs of one stage of one pair.

    Attributes:
        seconds: time on the clock.
        cpu_seconds: processor time of all threads of the process together.
        result_bytes: size of the stage's result; None where the result stays with the driver or is small.
    """

    seconds: float
    cpu_seconds: float
    result_bytes: int | None


def usual_workers() -> tuple[int, ...]:
    """Return the powers of two up to the number of usable cores, and that number, in ascending order."""
    most = cores()
    return tuple(sorted({2**power for power in range(most.bit_length()) if 2**power <= most} | {most}))


def measure(
    config: Config, seed: int, backend: Backend, effort: Effort, listener: Listener | None = None
) -> dict[str, Any]:
    """Measure in rounds; in each, the stages of ``pairs`` pairs, then each number of workers.

    In each round, each number of workers makes ``pairs`` pairs, or four for each worker if that is more.

    Args:
        config: the config.
        seed: the dataset's seed.
        backend: as of `Renderer`.
        effort: how much is measured.
        listener: hears what is measured.

    Returns:
        A report in JSON's types: config, seed, effort, "machine", "stages" as of `stage_rows`, and "workers", a row for
        each number of workers. There, "threads" are llvmpipe's in each worker, 0 where it draws in the calling thread;
        "pairs_per_second" includes writing the files, and "ratio" is relative to the first row; both are medians over
        the rounds.

    Raises:
        SemisynthError: where the config or OpenGL cannot be used.
    """
    counts = sorted(set(effort.workers or usual_workers()))
    if listener is not None:
        rounds = counted(effort.repeats, "round")
        listener.on_message(f"stages, and {', '.join(map(str, counts))} workers, in {rounds}")
    costs: list[Mapping[str, Costs]] = []
    rates = np.zeros((effort.repeats, len(counts)))
    for row in rates:
        facts, found = _costs(config, seed, backend, effort.pairs)
        costs += found
        row[:] = [_rate(config, seed, backend, count, max(effort.pairs, _PAIRS_EACH * count)) for count in counts]
    return {
        "config": config.name,
        "config_sha256": config.digest(),
        "seed": seed,
        "size_px": [config.camera.width_px, config.camera.height_px],
        "pairs": effort.pairs,
        "repeats": effort.repeats,
        "machine": machine_facts() | {"usable_cores": cores()} | facts,
        "stages": stage_rows(costs, cores(), software=is_software(facts["renderer"])),
        "workers": [
            {
                "workers": count,
                "threads": int(os.environ.get(THREADS) or threads_each(count)),
                "pairs_per_second": float(np.median(rates[:, number])),
                "ratio": float(np.median(rates[:, number] / rates[:, 0])),
            }
            for number, count in enumerate(counts)
        ],
    }


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
        mean = float(np.mean(sizes)) if sizes else None
        rows.append(row(stage, STAGE_TEXTS[stage], wall, cpu, mean, on_gpu=stage in _ON_THE_GPU and not software))
    text = "all of the above" if software else "the processor's part of all of the above"
    return [*rows, row(PROCESSOR, text, total, sum(processor), None, on_gpu=False)]


def headline(report: Mapping[str, Any]) -> str:
    """Return a line that names the scenes and the machine of a report."""
    machine, (width, height) = report["machine"], report["size_px"]
    return (
        f"{report['config']}, {width} x {height} px; {machine['renderer']}, {machine['opengl']}; "
        f"{machine['processor']}, {counted(machine['usable_cores'], 'core')}; Python {machine['python']}; "
        f"{machine['date']}"
    )


def table(report: Mapping[str, Any]) -> str:
    """Return a report in Markdown: a table of stages, a sentence on the limit, a table of workers."""
    stages, workers = report["stages"], report["workers"]
    limit = min(stages, key=lambda row: row["allows_per_second"])
    reached = f"{counted(workers[-1]['workers'], 'worker')} reached {workers[-1]['pairs_per_second']:.3g}"
    return "\n\n".join(
        [
            markdown(
                ("stage", "ms a pair", "ms of CPU", "share", "MB a pair", "pairs/s alone", "what it is"),
                [
                    (row["name"], f"{1e3 * row['seconds']:.1f}", f"{1e3 * row['cpu_seconds']:.1f}",
                     f"{100 * row['share']:.0f} %", _megabytes(row["bytes_per_pair"]),
                     f"{row['allows_per_second']:.3g}", row["text"])
                    for row in stages
                ],
            ),
            f"The {limit['name']} allows {limit['allows_per_second']:.3g} pairs/s; {reached}.",
            markdown(
                ("workers", "threads each", "pairs/s", "x"),
                [
                    (str(row["workers"]), str(row["threads"]), f"{row['pairs_per_second']:.2f}", f"{row['ratio']:.2f}")
                    for row in workers
                ],
                text_last=False,
            ),
        ]
    )  # fmt: skip


def _megabytes(count: float | None) -> str:
    return "-" if count is None else f"{count / 1e6:.1f}"


# Passed by all workers of a round once they have opened their renderers.
_opened: Barrier


def _begin(threads: str, opened: Barrier) -> None:
    global _opened  # noqa: PLW0603 - a barrier is inherited, and never pickled
    os.environ[THREADS] = threads
    keep_freed_memory()
    _opened = opened


@contextmanager
def _workers(count: int, threads: str) -> Iterator[ProcessPoolExecutor]:
    """Start worker processes in which llvmpipe has these threads; all wait for the barrier `_opened`."""
    context = get_context("spawn")
    with ProcessPoolExecutor(count, context, _begin, (threads, context.Barrier(count))) as pool:
        yield pool


class _Share(NamedTuple):
    """The shards that one worker makes in a round, in its own folder; the first one is not timed."""

    job: Job
    shards: tuple[Shard, ...]


def _rate(config: Config, seed: int, backend: Backend, workers: int, pairs: int) -> float:
    """Return the pairs per second of a number of workers, from when all have made a first shard.

    At the end, some workers have no work while others make the last pairs. This does not matter in a long run, so the
    number of pairs is divided by the workers' mean time.
    """
    length = config.sequence_pairs
    sequences = max(workers, ceil(pairs / length))
    threads = os.environ.get(THREADS) or str(threads_each(workers))
    with tempfile.TemporaryDirectory() as scratch, _workers(workers, threads) as pool:
        job = shard_job(config, seed, backend, (1 + sequences) * length, length, Path(scratch))
        untimed, *timed = job.plan.shards
        shares = [
            _Share(replace(job, address=str(Path(scratch, str(worker)))), (untimed, *timed[worker::workers]))
            for worker in range(workers)
        ]
        return sequences * length / float(np.mean(list(pool.map(_make_share, shares))))


def _make_share(share: _Share) -> float:
    """Make a worker's shards; return the seconds of the timed ones."""
    untimed, *timed = share.shards
    with open_renderer(share.job, SPLIT) as renderer:
        # The first pair makes the buffers and compiles the shaders.
        write_pairs(share.job, untimed, renderer, Listener())
        _opened.wait()
        start = time.perf_counter()
        for shard in timed:
            write_pairs(share.job, shard, renderer, Listener())
        return time.perf_counter() - start


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


def _costs(config: Config, seed: int, backend: Backend, pairs: int) -> tuple[dict[str, str], list[Mapping[str, Costs]]]:
    """Time the stages of pairs in a process with one thread; return `Renderer.facts`, and the costs of each pair."""
    with tempfile.TemporaryDirectory() as scratch, _workers(1, "0") as pool:
        return pool.submit(_time_pairs, shard_job(config, seed, backend, 1 + pairs, 1, Path(scratch))).result()


def _time_pairs(job: Job) -> tuple[dict[str, str], list[Mapping[str, Costs]]]:
    with open_renderer(job, SPLIT) as renderer:
        # The first pair is left out: it makes the buffers and compiles the shaders.
        return renderer.facts, [_time_pair(job, renderer, shard) for shard in job.plan.shards][1:]


def _time_pair(job: Job, renderer: PairRenderer, shard: Shard) -> Mapping[str, Costs]:
    """Make a shard of one pair; return the costs of each stage, which the driver finishes before the next begins."""
    renderer.listener = clock = _StageClock()
    pair = renderer.render(shard.first)
    encoded = encode(job.plan, shard, pair)
    clock.on_stage("encode")
    # Writing includes the shard's record, which takes less time per pair in a shard of more pairs.
    write_shard(open_root(job.address), job.plan, shard, [encoded])
    clock.on_stage("write")
    file_bytes = sum(map(len, encoded.files.values()))
    array_bytes = sum(array.nbytes for array in pair.frame.arrays().values())
    sizes = {"readback": array_bytes, "encode": file_bytes, "write": file_bytes}
    return {stage: Costs(clock.seconds[stage], clock.cpu_seconds[stage], sizes.get(stage)) for stage in STAGES}
