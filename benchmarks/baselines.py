"""What V pairs of one scene cost beside V scenes of one pair each: sampled, drawn, checked, encoded and written.

What counts is the processor's time, of all threads. Each turn makes the same scene with each number of baselines: the
longest one is the same, which the scene is made for.

    python benchmarks/baselines.py --json benchmarks/results/baselines.json
"""

import argparse
import json
import platform
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from semisynth_gl import load_config
from semisynth_gl.bench.shards import shard_job
from semisynth_gl.listener import Listener

_BASELINES_M = (0.27, 0.18, 0.22, 0.25)


def main() -> None:
    """Write scenes of all numbers of baselines in turn, and print and write down seconds and ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--config", default="middlebury")
    parser.add_argument("--turns", type=int, default=8)
    parser.add_argument("--baselines", type=int, nargs="+", default=[2, 3, 4], choices=(2, 3, 4))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    numbers = [1, *options.baselines]
    times: dict[int, list[float]] = {number: [] for number in numbers}
    with ExitStack() as stack, tempfile.TemporaryDirectory() as scratch:
        jobs, renderers = {}, {}
        for number in numbers:
            baselines_m = list(_BASELINES_M[:number])
            config = load_config(options.config, {"camera.baseline_m": None, "camera.baselines": baselines_m})
            # A shard for each scene; the first one compiles shaders.
            pairs = number * (1 + options.turns)
            jobs[number] = shard_job(config, 0, "auto", pairs, number, Path(scratch) / str(number))
            renderers[number] = stack.enter_context(jobs[number].open_renderer("train"))
        for turn in range(1 + options.turns):
            for number, job in jobs.items():
                renderer, start = renderers[number], time.process_time()
                job.make(job.plan.shards[turn], lambda _, own=renderer: own, Listener())
                if turn:
                    times[number].append(time.process_time() - start)
        drawn_by = renderers[1].renderer_name
    one = np.array(times[1])
    rows = []
    for number in options.baselines:
        ratios = np.array(times[number]) / (number * one)
        ratio = sum(times[number]) / (number * one.sum())
        rows.append({"baselines": number, "ratio": ratio, "ratios": ratios.tolist(), "seconds": times[number]})
        print(
            f"{number} pairs of one scene: {np.mean(times[number]):.2f} s of CPU, {ratio:.2f} of {number} scenes "
            f"({ratios.min():.2f} to {ratios.max():.2f} in single turns)"
        )
    print(f"a scene of one pair: {one.mean():.2f} s of CPU; {options.config}, {drawn_by}, {options.turns} turns")
    if options.json is not None:
        report = {"config": options.config, "renderer": drawn_by, "machine": platform.machine(), "one": one.tolist()}
        options.json.write_text(json.dumps(report | {"rows": rows}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
