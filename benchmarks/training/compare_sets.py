"""Train a network on each of several datasets with examples/train.py, and evaluate it on real pairs.

    python benchmarks/training/compare_sets.py --images PHOTOGRAPHS --real MIDDLEBURY --json FILE
    python benchmarks/training/compare_sets.py --set clutter --set mix --seeds 1 --steps 800 -- --batch 4

The datasets are listed in training_sets.py. Options after ``--`` are passed to train.py. Each seed trains on all
datasets before the next seed, so an interrupted table compares all of them. The same command resumes.
"""

import json
import subprocess
import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from training_sets import SETS, config_of

from semisynth_gl import score
from semisynth_gl.bench.summary import machine_facts, markdown
from semisynth_gl.dataset.engines import LocalEngine
from semisynth_gl.dataset.generate import generate

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
sys.path.append(str(EXAMPLES))

import predict  # noqa: E402 - found once the path above is set
from judged_pairs import folder, motorcycle  # noqa: E402

_NETWORK = "stereo_network:StereoNetwork"
_FIGURE = "bad-1"


def trained(name: str, seed: int, dataset: Path, out: Path, options: Sequence[str]) -> Path:
    """Train on a dataset; return the checkpoint."""
    command = [sys.executable, str(EXAMPLES / "train.py"), "--data", str(dataset), "--seed", str(seed)]
    command += ["--augment", SETS[name].augment, "--out", str(out), *options]
    subprocess.run(command, check=True, cwd=EXAMPLES)
    return out / "checkpoint.ckpt"


def judged(checkpoint: Path, folders: Sequence[Path]) -> dict[str, float]:
    """Return bad-1, the percentage of pixels off by more than 1 px, of each real pair."""
    module, shares = predict.load(checkpoint, _NETWORK), {}
    for pairs in (motorcycle(), *map(folder, folders)):
        for number in range(len(pairs)):
            pair = pairs[number]
            found = predict.predict(module, pair["left"], pair["right"])
            shares[pair["name"]] = score(found, pair["truth"].disparity, pairs.protocol)[_FIGURE]
    return shares


def table(runs: Sequence[dict[str, Any]]) -> str:
    """Return a table of the mean and standard deviation over the runs of each dataset, the best first."""
    by_set: dict[str, list[float]] = defaultdict(list)
    for run in runs:
        by_set[run["set"]].append(float(np.mean([*run["pairs"].values()])))
    rows = [
        (name, f"{np.mean(means):.2f}", f"{np.std(means, ddof=1):.2f}" if len(means) > 1 else "-", SETS[name].what)
        for name, means in sorted(by_set.items(), key=lambda each: np.mean(each[1]))
    ]
    return markdown(("set", f"{_FIGURE}, %", "spread", "what it is"), rows)


@click.command()
@click.option("--set", "names", type=click.Choice([*SETS]), multiple=True, help="May be repeated.  [default: all]")
@click.option("--seeds", type=click.IntRange(1), default=3, show_default=True, help="Runs of each set.")
@click.option("--steps", type=click.IntRange(1), default=3000, show_default=True, help="Of each run.")
@click.option("--pairs", type=click.IntRange(1), default=576, show_default=True, help="In each dataset.")
@click.option("--images", multiple=True, metavar="PATH_OR_GLOB", help="Photographs of the place.")
@click.option("--real", "folders", type=click.Path(path_type=Path), multiple=True, help="As train.py's --evaluate.")
@click.option("--workers", type=click.IntRange(1), default=1, show_default=True, help="Processes that render.")
@click.option("--data", type=click.Path(path_type=Path), default=Path("out/training-sets"), show_default=True)
@click.option("--json", "out", type=click.Path(path_type=Path), default=Path("sets.json"), show_default=True)
@click.argument("options", nargs=-1)
def main(
    names: tuple[str, ...],
    seeds: int,
    steps: int,
    pairs: int,
    images: tuple[str, ...],
    folders: tuple[Path, ...],
    workers: int,
    data: Path,
    out: Path,
    options: tuple[str, ...],
) -> None:
    """Train on each dataset, and evaluate the networks on real pairs."""
    chosen = [name for name in names or SETS if images or not SETS[name].of_place]
    options = ("--steps", str(steps), "--every", str(steps), *options)
    report: dict[str, Any] = {"options": options, "pairs": pairs, "machine": machine_facts(), "runs": []}
    if out.is_file():
        report["runs"] = json.loads(out.read_text("utf-8"))["runs"]
    done = {(run["set"], run["seed"]) for run in report["runs"]}
    for name, seed in ((name, seed) for seed in range(seeds) for name in chosen if (name, seed) not in done):
        dataset = data.absolute() / (SETS[name].pairs_of or name)
        generate(config_of(name, images, data.absolute()), dataset, pairs, engine=LocalEngine(workers))
        checkpoint = trained(name, seed, dataset, data.absolute() / f"{name}-{seed}", options)
        report["runs"].append({"set": name, "seed": seed, "pairs": judged(checkpoint, folders)})
        out.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    click.echo(table(report["runs"]))


if __name__ == "__main__":
    main()
