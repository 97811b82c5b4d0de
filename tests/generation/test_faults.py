"""Long fault runs: kill -9 at many moments, and the dataset comes out byte for byte as if nothing had happened."""

import random
import shutil
import signal
import subprocess
import time

import pytest
from tiny_datasets import PAIRS, SEED, command, digests, tiny

from semisynth_gl.generation.generate import generate

MOMENTS = 50


@pytest.mark.faults
@pytest.mark.parametrize("layout", ["webdataset", "kitti"])
def test_killed_at_random_moments_it_comes_out_the_same(tmp_path, layout):
    config = tiny(models={"complex": 0.0}, particles={"size_px": [40.0, 120.0]})
    generate(config, tmp_path / "undisturbed", PAIRS, SEED, layout=layout, shard_pairs=3)
    wanted = digests(tmp_path / "undisturbed")
    out = tmp_path / "o"
    moments = random.Random(0)
    kills = completed = compared = 0
    while kills < MOMENTS // 2:
        process = subprocess.Popen(
            command(config, out, layout, "--workers", 2), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        time.sleep(moments.uniform(0.5, 4.0))
        if process.poll() is None:
            process.send_signal(signal.SIGKILL)
            kills += 1
        if process.wait() == 0:
            completed += 1
        if (out / "index.json").exists():
            # Whether it was killed just after or not: what claims to be complete is.
            assert digests(out) == wanted
            compared += 1
            shutil.rmtree(out)
    done = subprocess.run(command(config, out, layout), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert digests(out) == wanted
    print(f"{layout}: killed {kills} times; {completed} runs ended; {compared + 1} finished datasets compared")
