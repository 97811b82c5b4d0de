"""Seconds per pair of a packaged config, files written, with the share of each stage.

python benchmarks/seconds_per_pair.py --config middlebury --pairs 24 --json benchmarks/results/seconds_per_pair.json
"""

import argparse
import json
import tempfile
import time
from math import ceil
from pathlib import Path

import numpy as np

from semisynth_gl.bench.machine import machine_facts
from semisynth_gl.config import load_config
from semisynth_gl.pipeline import PairRenderer
from semisynth_gl.write.dataset import DatasetFolder
from semisynth_gl.write.middlebury import SCENES, encode_scene, scene_name


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--config", default="middlebury")
    parser.add_argument("--pairs", type=int, default=24)
    parser.add_argument("--backend", default="auto")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()

    config = load_config(options.config)
    stages: dict[str, list[float]] = {"render": [], "encode": [], "write": []}
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as scratch, PairRenderer(config, 0, options.backend) as renderer:
        opened = time.perf_counter() - start
        folder = DatasetFolder(Path(scratch) / "out", overwrite=False)
        folder.open()
        for index in range(options.pairs):
            marks = [time.perf_counter()]
            pair = renderer.render(index)
            marks.append(time.perf_counter())
            files = encode_scene(pair.frame, pair.provenance, ceil(config.disparity.max_px))
            marks.append(time.perf_counter())
            folder.add_folder(SCENES / scene_name(config.name, index), files)
            marks.append(time.perf_counter())
            for stage, seconds in zip(stages, np.diff(marks), strict=True):
                stages[stage].append(float(seconds))
        driver = renderer.renderer_name
    total = np.sum(list(stages.values()), axis=0)
    result = {
        "config": options.config,
        "size_px": [config.camera.width_px, config.camera.height_px],
        "pairs": options.pairs,
        "seconds_per_pair": {"mean": round(float(total.mean()), 4), "median": round(float(np.median(total)), 4)},
        "stage_means_s": {stage: round(float(np.mean(seconds)), 4) for stage, seconds in stages.items()},
        "start_s": round(opened, 2),
        "renderer": driver,
        "machine": machine_facts(),
    }
    text = json.dumps(result, indent=1)
    print(text)
    if options.json:
        options.json.write_text(text + "\n")


if __name__ == "__main__":
    main()
