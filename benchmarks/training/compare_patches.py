"""What MC-CNN's patch network learns from which pairs, beside its shipped weights and census, judged on real pairs.

    pip install '.[torch]' mccnn==1.4 h5py libsgm==0.5.2
    python benchmarks/training/compare_patches.py --images PHOTOGRAPHS --real MIDDLEBURY --json FILE

Disparities are the least cost of each pixel alone, and that of semi-global matching; no step that fills, checks or
smooths follows. docs/training.md has what came out.
"""

import json
import shlex
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import islice, product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import patch_network
import torch
from compare_sets import BUDGETS, Sources, kept_runs
from mc_cnn.model.mc_cnn_fast import FastMcCnn
from patch_costs import Costs, Penalties, census_costs, learnt_costs, smoothed, winner
from patch_network import PatchBudget
from patch_report import FOUR, FOUR_PAIRS, headline, table
from real_pairs import RealPair, judge, read_pairs
from trainer import of_judges

from semisynth_gl.bench.summary import machine_facts
from semisynth_gl.dataset.reader import open_dataset
from semisynth_gl.frame.channels import VISIBLE
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.errors import SemisynthError
from semisynth_gl.judge.truth import Truth
from semisynth_gl.textures.atlas import to_grey

RENDERED = ("zero-shot", "packaged", "calibrated")
UNLEARNT = ("census", "shipped-middlebury", "shipped-satellites")
_SHIPPED = {"shipped-middlebury": "middlebury", "shipped-satellites": "dfc"}
_MAX_DISPARITY_PX = 112
"""All real pairs that the benchmark was made with show less."""
_CHOOSE_BY = 4
"""Rendered pairs, learnt from by none, that choose the penalties of semi-global matching."""
_GRID = tuple(Penalties(small, small * ratio) for small, ratio in product((0.03, 0.1, 0.3), (2.0, 5.0, 15.0)))
_REFUSED = 2

Matcher = Callable[[RealPair], Costs]


@dataclass(frozen=True, slots=True)
class Pairs:
    """What is learnt from and judged by.

    Attributes:
        sources: of rendered pairs.
        real: judged pairs.
        choosing: rendered pairs that choose penalties.
    """

    sources: Sources
    real: Mapping[str, RealPair]
    choosing: Mapping[str, RealPair]

    def learnt_from(self, name: str, budget: PatchBudget) -> list[Frame]:
        """Return the pairs of a set; four real ones give as many points as a whole dataset."""
        if name == FOUR:
            return of_judges({each: self.real[each] for each in FOUR_PAIRS})
        return list(islice(open_dataset(self.sources.write(name, BUDGETS["cpu"])), budget.pairs))


def held_out(sources: Sources, budget: PatchBudget) -> dict[str, RealPair]:
    """Return rendered pairs that no training uses, with their truth where both eyes see it."""
    written = open_dataset(sources.write(RENDERED[0], BUDGETS["cpu"]))
    frames = islice(written, budget.pairs, budget.pairs + _CHOOSE_BY)
    return {
        str(number): RealPair(
            frame.left.image, frame.right.image, Truth(frame.left.disparity, frame.left.visibility == VISIBLE)
        )
        for number, frame in enumerate(frames)
    }


def census(pair: RealPair) -> Costs:
    """Match a pair by census."""
    return census_costs(to_grey(pair.left), to_grey(pair.right), _MAX_DISPARITY_PX + 1)


def learnt(network: FastMcCnn, pair: RealPair) -> Costs:
    """Match a pair by a network."""
    left, right = (patch_network.features(network, image) for image in (pair.left, pair.right))
    return learnt_costs(left, right, _MAX_DISPARITY_PX + 1)


def choose_penalties(choosing: Mapping[str, RealPair], costs: Mapping[str, Costs]) -> Penalties:
    """Return the penalties of a grid with which semi-global matching is best on rendered pairs."""

    def error(penalties: Penalties) -> float:
        return _judged(choosing, {name: smoothed(each, penalties) for name, each in costs.items()})["mean"]

    return min(_GRID, key=error)


def judged(pairs: Pairs, match: Matcher) -> dict[str, Any]:
    """Judge by real pairs: the least cost alone, and after semi-global matching."""
    penalties = choose_penalties(pairs.choosing, {name: match(pair) for name, pair in pairs.choosing.items()})
    costs = {name: match(pair) for name, pair in pairs.real.items()}
    smooth = {name: smoothed(each, penalties) for name, each in costs.items()}
    return {
        "winner": _judged(pairs.real, costs),
        "semi_global": _judged(pairs.real, smooth),
        "penalties": asdict(penalties),
    }


def _judged(real: Mapping[str, RealPair], costs: Mapping[str, Costs]) -> dict[str, Any]:
    names = {id(pair): name for name, pair in real.items()}
    by_pair, mean = judge(real, lambda pair: winner(costs[names[id(pair)]]))
    return {"mean": mean, "pairs": by_pair}


def matcher(name: str, pairs: Pairs, budget: PatchBudget, seed: int, tell: Callable[[str], None]) -> Matcher:
    """Return what a row of the table matches with, which takes a training for most."""
    if name == "census":
        return census
    if name in _SHIPPED:
        return partial(learnt, patch_network.shipped(_SHIPPED[name]))
    if name == "untrained":
        return partial(learnt, patch_network.untrained(seed))
    frames = pairs.learnt_from(name, budget)
    each = replace(budget, points=budget.points * budget.pairs // len(frames))
    with TemporaryDirectory() as folder:
        patch_network.write_training_files(frames, each, seed, Path(folder))
        return partial(learnt, patch_network.train(Path(folder), budget, seed, tell))


@click.command(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.option(
    "--set",
    "names",
    type=click.Choice((*UNLEARNT, "untrained", FOUR, *RENDERED)),
    multiple=True,
    help="A row of the table. May be repeated.  [default: all]",
)
@click.option("--seeds", type=click.IntRange(1), default=3, show_default=True, help="Runs of each row that learns.")
@click.option("--steps", type=click.IntRange(1), default=PatchBudget().steps, show_default=True)
@click.option(
    "--real",
    "folders",
    type=click.Path(path_type=Path),
    multiple=True,
    required=True,
    metavar="DIR",
    help="Scenes to judge by: a folder in Middlebury's layout. May be repeated.",
)
@click.option("--images", multiple=True, metavar="PATH_OR_GLOB", help="Photographs of the place, for `calibrated`.")
@click.option(
    "--data",
    type=click.Path(path_type=Path),
    default=Path("out/training-sets"),
    show_default=True,
    help="Folder of the datasets, the same as compare_sets.py's; what is there is not rendered again.",
)
@click.option("--workers", type=click.IntRange(0), default=0, show_default=True, help="Processes that render.")
@click.option("--json", "out", type=click.Path(path_type=Path, dir_okay=False), help="Write everything here.")
@click.option("--go-on", is_flag=True, help="Keep the runs that the file of --json has, and add those that it lacks.")
def main(**options: Any) -> None:  # noqa: ANN401 - as many types as options
    """Train MC-CNN's fast network on each set alike, and judge it on real pairs."""
    try:
        run(**options)
    except SemisynthError as error:
        click.echo(f"Error: {error}", err=True)
        sys.exit(_REFUSED)


def run(
    *,
    names: tuple[str, ...],
    seeds: int,
    steps: int,
    folders: Sequence[Path],
    images: tuple[str, ...],
    data: Path,
    workers: int,
    out: Path | None,
    go_on: bool,
) -> None:
    """Do what the options say; see ``--help``."""
    budget = PatchBudget(steps=steps)
    real = read_pairs(folders, 1, _MAX_DISPARITY_PX)
    chosen = names or (*UNLEARNT, "untrained", FOUR, *(name for name in RENDERED if images or name != "calibrated"))
    if FOUR in chosen and not set(FOUR_PAIRS) <= set(real):
        raise click.UsageError(
            f"--set {FOUR}: expected the scenes {', '.join(FOUR_PAIRS)} in --real: name the other rows with --set"
        )
    sources = Sources(images, data, real, workers)
    pairs = Pairs(sources, real, held_out(sources, budget))
    setup = {"budget": asdict(budget), "pairs": list(real)}
    runs = kept_runs(out, setup) if go_on and out is not None and out.is_file() else []
    report = {
        "command": shlex.join(["python", *sys.argv]),
        "machine": {**machine_facts(), "torch": torch.__version__, "threads": torch.get_num_threads()},
        "setup": setup,
        "runs": runs,
    }
    done = {(each["set"], each["seed"]) for each in runs}
    for seed, name in product(range(seeds), chosen):
        if (name, seed) in done or (seed and name in UNLEARNT):
            continue
        start = time.perf_counter()
        match = matcher(name, pairs, budget, seed, partial(_tell, name, seed))
        seconds = time.perf_counter() - start
        runs.append({"set": name, "seed": seed, "seconds": seconds, **judged(pairs, match)})
        _tell(name, seed, " / ".join(f"{runs[-1][way]['mean']:.2f} %" for way in ("winner", "semi_global")))
        if out is not None:
            out.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    click.echo(f"{headline(report)}.\n\n{table(report)}")


def _tell(name: str, seed: int, line: str) -> None:
    click.echo(f"{name}, seed {seed}: {line}", err=True)


if __name__ == "__main__":
    main()
