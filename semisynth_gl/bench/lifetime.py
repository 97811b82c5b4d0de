"""The time from a process's start to its first pair on disk, and a process's memory over many pairs."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.bench.shards import LAYOUT, SPLIT, measure_pairs, shard_job
from semisynth_gl.config import Config
from semisynth_gl.dataset.documents import Shard
from semisynth_gl.dataset.make import Job, write_pairs
from semisynth_gl.inputs.errors import SemisynthError
from semisynth_gl.listener import Listener
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.render.backends import Backend

_POLL_S = 0.002
# Environment variables that name the drivers' folders of compiled shaders: Mesa, older versions of Mesa, NVIDIA.
_DRIVER_CACHES = ("MESA_SHADER_CACHE_DIR", "MESA_GLSL_CACHE_DIR", "__GL_SHADER_DISK_CACHE_PATH")
# Share of the pairs after which all buffers are expected to have grown to their final size.
_SETTLING = 0.25


class _Memory(NamedTuple):
    """A process's resident memory, and its OpenGL objects counted by kind, after a pair."""

    rss_bytes: int
    objects: dict[str, int]


def _memory_after(job: Job, renderer: PairRenderer, shard: Shard) -> _Memory:
    """Make the pair of a shard, remove it from the disk and read the process's memory; passed to `measure_pairs`."""
    write_pairs(job, shard, renderer, Listener())
    shutil.rmtree(job.address)
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return _Memory(pages * os.sysconf("SC_PAGE_SIZE"), renderer.count_objects())


def measure_memory(config: Config, seed: int, backend: Backend, pairs: int) -> dict[str, Any]:
    """Make pairs, 1 or more, in another process and follow its memory.

    Returns:
        A dictionary with the keys

        - "pairs": the number of pairs,
        - "rss_bytes": resident memory after the last pair; with a software renderer, it includes images and textures,
        - "peak_bytes": the largest resident memory after any pair,
        - "slope_bytes_per_pair" and "slope_error_bytes_per_pair": slope, with its standard error, of a line through the
          resident memory after each pair from the second quarter on,
        - "objects": the number of OpenGL objects at the end, by kind,
        - "objects_constant": whether these numbers are those after the first quarter, by when all objects should exist.
    """
    memory = measure_pairs(_memory_after, config, seed, backend, pairs)
    rss, settled = np.array([after.rss_bytes for after in memory], np.float64), int(_SETTLING * pairs)
    slope, error = line_slope(rss[settled:])
    return {
        "pairs": pairs,
        "rss_bytes": int(rss[-1]),
        "peak_bytes": int(rss.max()),
        "slope_bytes_per_pair": slope,
        "slope_error_bytes_per_pair": error,
        "objects": memory[-1].objects,
        "objects_constant": memory[-1].objects == memory[settled].objects,
    }


def line_slope(values: NDArray[np.float64]) -> tuple[float, float]:
    """Fit a line through (N,) values at 0, 1, ...; return its slope and the slope's standard error.

    Both are in the unit of the values, per step, and 0 for fewer than three values.
    """
    if len(values) < 3:
        return 0.0, 0.0
    (slope, _), covariance = np.polyfit(np.arange(len(values)), values, 1, cov=True)
    return float(slope), float(np.sqrt(covariance[0, 0]))


def measure_start(config: Config, seed: int, backend: Backend, repeats: int) -> list[dict[str, Any]]:
    """Run ``semisynth-gl generate --pairs 1`` with empty caches, and again with the caches that this run has filled.

    Returns:
        A row for "empty caches" and a row for "warm caches", under "name". "first_pair_seconds" is the time until the
        pair is on disk, "end_seconds" the time until the process has ended; both are medians over the repeats.

    Raises:
        SemisynthError: where the program ends with an error.
    """
    names = ("empty caches", "warm caches")
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in names}
    for _ in range(repeats):
        with tempfile.TemporaryDirectory() as scratch:
            for name in names:
                times[name].append(_start(config, seed, backend, Path(scratch)))
    medians = {name: np.median(times[name], axis=0).tolist() for name in names}
    return [{"name": name, "first_pair_seconds": first, "end_seconds": end} for name, (first, end) in medians.items()]


def _start(config: Config, seed: int, backend: Backend, scratch: Path) -> tuple[float, float]:
    """Run the program with its caches below a folder; return the seconds to the first pair and to the process's end."""
    # YAML includes JSON. None would stand for a key that was not given.
    config_path, out, driver_cache = scratch / "config.yaml", scratch / "out", scratch / "driver"
    config_path.write_text(json.dumps(config.model_dump(mode="json", exclude_none=True)), encoding="utf-8")
    command = [
        *(sys.executable, "-m", "semisynth_gl", "generate", "--config", str(config_path)),
        *("--pairs", "1", "--out", str(out), "--seed", str(seed), "--backend", backend, "--layout", LAYOUT),
    ]
    shutil.rmtree(out, ignore_errors=True)
    driver_cache.mkdir(exist_ok=True)
    caches = {"SEMISYNTH_GL_CACHE": str(scratch / "cache")} | dict.fromkeys(_DRIVER_CACHES, str(driver_cache))
    plan = shard_job(config, seed, backend, 1, 1, out).plan
    # The last file of a pair to be written.
    last_file = out / plan.layout.files(plan.key(SPLIT, 0), plan.layout.encodings_for(config))["provenance"]
    first_pair = None
    start = time.perf_counter()
    with subprocess.Popen(command, env=os.environ | caches, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as run:  # noqa: S603 - this program
        while run.poll() is None:
            if first_pair is None and last_file.is_file():
                first_pair = time.perf_counter() - start
            time.sleep(_POLL_S)
        end = time.perf_counter() - start
        _, message = run.communicate()
    if run.returncode != 0:
        raise SemisynthError(f"the timed program ended with an error:\n{message.decode(errors='replace')}")
    return first_pair if first_pair is not None else end, end
