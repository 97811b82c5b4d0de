"""CPU seconds of each stage of a pair, of two checkouts of this project in alternating turns.

    python benchmarks/pair_costs.py ../before . --turns 8
    python benchmarks/pair_costs.py . . --set-after antialias=edges

Both checkouts run with the Python that runs this script, each in a process of its own that stays open, draws in its own
thread (llvmpipe with `LP_NUM_THREADS=0`) and makes the same pairs of a config as a dataset has them. Times are the
process's own, user and system, so that other work on the machine counts as little as it can. The checkout that begins
changes from turn to turn; a turn is some pairs of each, and a first one, in which memory and caches grow, does not
count. The table has the mean of each stage, and the median of the turns' ratios with its 90 % confidence interval
(bootstrap over the turns).
"""

import argparse
import json
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from compare_speed import Checkout, line_with, median_interval, say

DRAWING = ("draw", "visibility", "readback")
MOST_PAIRS = 10_000
ALL, REST = "all", "all but drawing and reading back"


class Clock:
    """Adds up CPU seconds by stage: of what runs inside `inside`, or since the last stage ended."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._last = time.process_time()
        self._taken = 0.0

    def on_stage(self, stage: str) -> None:
        """End a stage; what ran inside others meanwhile is not its own."""
        last, self._last = self._last, time.process_time()
        self.seconds[stage] += self._last - last - self._taken
        self._taken = 0.0

    def inside(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function whose time is a part of its own."""

        def timed(*arguments: Any, **options: Any) -> Any:  # noqa: ANN401 - of any function
            start, taken = time.process_time(), self._taken
            try:
                return function(*arguments, **options)
            finally:
                own = time.process_time() - start - (self._taken - taken)
                self.seconds[name] += own
                self._taken += own

        return timed


@contextmanager
def maker(config_name: str, settings: Sequence[str], folder: Path) -> Iterator[Callable[[int], dict[str, float]]]:
    """Open a renderer; yield what makes a pair and returns its CPU seconds by stage."""
    from semisynth_gl.bench.shards import SPLIT, shard_job  # noqa: PLC0415 - the checkout's own
    from semisynth_gl.codecs import IMAGE_CODECS  # noqa: PLC0415
    from semisynth_gl.codecs.json_object import JSON_OBJECT  # noqa: PLC0415
    from semisynth_gl.codecs.pfm import Pfm  # noqa: PLC0415
    from semisynth_gl.codecs.png import Png  # noqa: PLC0415
    from semisynth_gl.config import load_config  # noqa: PLC0415
    from semisynth_gl.dataset.engines import keep_freed_memory  # noqa: PLC0415
    from semisynth_gl.dataset.make import encode, open_renderer  # noqa: PLC0415
    from semisynth_gl.dataset.root import open_root  # noqa: PLC0415
    from semisynth_gl.dataset.shard import write_shard  # noqa: PLC0415

    keep_freed_memory()
    clock = Clock()

    def by_kind(encode: Callable[..., Any]) -> Callable[..., Any]:
        as_image, as_map = clock.inside("encode: images", encode), clock.inside("encode: masks and ids", encode)
        return lambda codec, value: (as_image if codec is IMAGE_CODECS["png"] else as_map)(codec, value)

    Png.encode = by_kind(Png.encode)
    Pfm.encode = clock.inside("encode: disparities", Pfm.encode)
    type(JSON_OBJECT).encode = clock.inside("encode: provenance", type(JSON_OBJECT).encode)
    job = shard_job(load_config(config_name, settings), 0, "auto", MOST_PAIRS, 1, folder)
    plan, root, shards = job.plan, open_root(job.address), job.plan.shards
    with open_renderer(job, SPLIT) as renderer:
        for sampler in renderer.sampler.samplers:
            sampler.population.expected()  # solved once for each recipe
        renderer.listener = clock

        def make(number: int) -> dict[str, float]:
            shard = shards[number]
            clock.__init__()
            pair = renderer.render(shard.first)
            encoded = encode(plan, shard, pair)
            clock.on_stage("encode: the rest")
            write_shard(root, plan, shard, [encoded])
            clock.on_stage("write and hash")
            for path in encoded.files:
                (root / f"{plan.folder(SPLIT)}{path}").unlink()
            return dict(clock.seconds)

        make(0)
        yield make


def serve(config_name: str, settings: Sequence[str]) -> None:
    """Make the pairs whose first and last number each line of the standard input has; print the means as JSON."""
    with tempfile.TemporaryDirectory() as folder, maker(config_name, settings, Path(folder) / "out") as make:
        print("READY", flush=True)
        for line in sys.stdin:
            first, end = map(int, line.split())
            sums: dict[str, float] = defaultdict(float)
            for number in range(first, end):
                for stage, seconds in make(number).items():
                    sums[stage] += seconds / (end - first)
            print("DONE", json.dumps(sums), flush=True)


def with_sums(stages: Mapping[str, float]) -> dict[str, float]:
    """Add the sums to the CPU seconds of stages."""
    rest = sum(seconds for stage, seconds in stages.items() if stage not in DRAWING)
    return dict(stages) | {REST: rest, ALL: sum(stages.values())}


def table(turns: Sequence[tuple[Mapping[str, float], Mapping[str, float]]]) -> str:
    """Lay the turns of two checkouts out in Markdown."""
    lines = ["| stage | before, ms | after, ms | ratio | 90 % interval |", "|---|---:|---:|---:|---:|"]
    for stage in turns[0][0]:
        before, after = (np.array([turn[side].get(stage, 0.0) for turn in turns]) for side in (0, 1))
        median, low, high = median_interval(after / np.maximum(before, 1e-9))
        means = f"{1e3 * before.mean():.2f} | {1e3 * after.mean():.2f}"
        lines.append(f"| {stage} | {means} | {median:.3f} | {low:.3f} to {high:.3f} |")
    return "\n".join(lines)


def main() -> None:
    """Compare and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("checkouts", type=Path, nargs="*", metavar="CHECKOUT", help="before and after")
    parser.add_argument("--config", default="middlebury")
    parser.add_argument("--set", dest="settings", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument(
        "--set-after",
        dest="settings_after",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="of the second alone",
    )
    parser.add_argument("--turns", type=int, default=8)
    parser.add_argument("--pairs", type=int, default=4, help="pairs of each checkout in a turn")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        serve(options.config, options.settings)
        return
    if len(options.checkouts) != 2:
        parser.error("expected two checkouts")
    settings = (options.settings, options.settings + options.settings_after)
    with tempfile.TemporaryDirectory() as folder:
        sides = [Checkout(path, Path(folder) / str(side)) for side, path in enumerate(options.checkouts)]
        script = (str(Path(__file__).resolve()), "--serve", "--config", options.config)
        processes = [
            side.start(*script, *(f"--set={setting}" for setting in own), LP_NUM_THREADS="0")
            for side, own in zip(sides, settings, strict=True)
        ]
        for process in processes:
            line_with("READY", process)
        turns = []
        for turn in range(options.turns + 1):
            first = 1 + turn * options.pairs
            results: dict[int, dict[str, float]] = {}
            for side in (0, 1) if turn % 2 == 0 else (1, 0):
                say(f"{first} {first + options.pairs}", processes[side])
                results[side] = with_sums(json.loads(line_with("DONE", processes[side])))
            if not turn:
                continue
            turns.append((results[0], results[1]))
            before, after = (f"{1e3 * results[side][REST]:.1f} ms" for side in (0, 1))
            print(f"turn {turn}, {REST}: {before}, {after}", file=sys.stderr)
        for process in processes:
            process.communicate()
    before, after = (" ".join([options.config, *own]) for own in settings)
    print(f"{before} and {after}: {options.turns} turns of {options.pairs} pairs\n")
    print(table(turns))


if __name__ == "__main__":
    main()
