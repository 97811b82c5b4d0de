"""What networks learn from which pairs: the same small network, trained on each set alike and judged on real pairs.

    python benchmarks/training/compare_sets.py --images PHOTOGRAPHS --real MIDDLEBURY --json FILE
    python benchmarks/training/compare_sets.py --budget gpu --images PHOTOGRAPHS --real MIDDLEBURY --json FILE

Sets are in training_sets.py. Seeds take turns, so that a table that was ended early compares all sets with fewer runs.
docs/training.md has what came out.
"""

import json
import shlex
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import click
import torch
from matching_network import MatchingNetwork
from real_pairs import RealPair, judge, judge_without_truth, plainness, read_pairs, semi_global
from trainer import (
    Budget,
    Hardware,
    Sample,
    TimeUpError,
    crops,
    find_precision,
    frames_of,
    predictor,
    read_dataset,
    rendered,
    train,
)
from training_report import headline, table
from training_sets import COLOURS, REAL, SETS, config_of

from semisynth_gl.bench.summary import machine_facts
from semisynth_gl.dataset.engines import LocalEngine, SerialEngine
from semisynth_gl.dataset.generate import generate
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.errors import InputError, SemisynthError

BUDGETS: Mapping[str, Budget] = {
    # Sizes at which a run takes minutes on one thread.
    "cpu": Budget(
        steps=6000, batch=2, crop_px=(96, 160), factor=2, max_disparity_px=40, width=1, pairs=576, minutes=None
    ),
    # Whole sizes, and new pairs all the time.
    "gpu": Budget(
        steps=400, batch=8, crop_px=(192, 320), factor=1, max_disparity_px=80, width=2, pairs=0, minutes=9.5
    ),
}  # fmt: skip
_REFUSED = 2


@dataclass(frozen=True, slots=True)
class Sources:
    """Where a set's batches come from.

    Attributes:
        images: photographs of the place; may be empty.
        folder: where datasets are kept.
        real: the real pairs.
        workers: processes that render.
    """

    images: tuple[str, ...]
    folder: Path
    real: Mapping[str, RealPair]
    workers: int

    def write(self, name: str, budget: Budget) -> Path:
        """Write the dataset of a set, unless it is there."""
        name = SETS[name].pairs_of or name
        folder = self.folder / name
        pairs = max(1, round(budget.pairs * SETS[name].share))
        engine = LocalEngine(self.workers) if self.workers > 1 else SerialEngine()
        generate(config_of(name, self.images, self.folder), folder, pairs, engine=engine)
        return folder

    def pairs(self, name: str, budget: Budget) -> list[Frame]:
        """Read the pairs of a set that is not rendered while it trains."""
        return frames_of(self.real) if name == REAL else read_dataset(self.write(name, budget), budget.factor)

    def batches(self, name: str, budget: Budget, seed: int) -> Iterator[Sample]:
        """Yield the batches of a run."""
        augmentation = COLOURS if name == REAL else SETS[name].augmentation
        if name == REAL or budget.pairs:
            return crops(self.pairs(name, budget), budget, augmentation, seed)
        return rendered(config_of(name, self.images, self.folder), budget, augmentation, seed, self.workers)


def choose_sets(names: tuple[str, ...], images: tuple[str, ...], budget: Budget) -> tuple[list[str], dict[str, str]]:
    """Tell which sets are trained on, and why others are not.

    Args:
        names: those that were asked for; none for all.
        images: photographs of the place.
        budget: of the trainings.
    """
    chosen: list[str] = []
    left_out: dict[str, str] = {}
    for name in names or (REAL, *SETS):
        row = SETS.get(name)
        if row is not None and row.of_place and not images:
            left_out[name] = "needs photographs of the place, --images"
        elif row is not None and row.share != 1 and not budget.pairs:
            left_out[name] = "is about the number of pairs, and rendering has no such number"
        else:
            chosen.append(name)
    return chosen, left_out


def compare(
    sources: Sources,
    chosen: list[str],
    seeds: int,
    budget: Budget,
    hardware: Hardware,
    *,
    kept: list[dict[str, Any]],
    save: Callable[[], None],
) -> list[str]:
    """Train and judge, the first seed of all sets first.

    Args:
        sources: of batches, and the real pairs.
        chosen: sets.
        seeds: runs of each.
        budget: of each run.
        hardware: where they run.
        kept: runs that are not done again; new ones are added.
        save: called after each run.

    Returns:
        Names of the runs that time did not allow.
    """
    end = time.perf_counter() + 60 * budget.minutes if budget.minutes else float("inf")
    done = {(run["set"], run["seed"]) for run in kept}
    wanted = [(name, seed) for seed in range(seeds) for name in chosen if (name, seed) not in done]
    missing = []
    opened = (sources.batches(name, budget, seed) for name, seed in wanted)
    coming = next(opened, iter(()))
    for name, seed in wanted:
        start, batches = time.perf_counter(), coming
        if start < end:
            # Workers take seconds to start: those of the next run do so while this one trains.
            coming = next(opened, iter(()))
        try:
            network = train(batches, budget, hardware, seed, end=end, tell=partial(_tell, name, seed))
        except TimeUpError:
            missing.append(f"{name}, seed {seed}")
            continue
        predict = predictor(network, hardware)
        pairs, mean = judge(sources.real, predict)
        unconfirmed = judge_without_truth(sources.real, predict)
        seconds = time.perf_counter() - start
        kept.append({
            "set": name, "seed": seed, "mean": mean, "pairs": pairs, "unconfirmed": unconfirmed, "seconds": seconds
        })  # fmt: skip
        _tell(name, seed, f"bad-1 {mean:.2f} %")
        save()
    return missing


def _tell(name: str, seed: int, line: str) -> None:
    click.echo(f"{name}, seed {seed}: {line}", err=True)


def kept_runs(path: Path, setup: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the runs of an earlier report, whose set-up must be the same.

    Raises:
        InputError: where it is another one.
    """
    report = json.loads(path.read_text(encoding="utf-8"))
    for what, expected in setup.items():
        if report["setup"][what] != expected:
            found = report["setup"][what]
            raise InputError(f"--go-on: {path} has {what} {found}, this command {expected}: give another --json")
    runs: list[dict[str, Any]] = report["runs"]
    return runs


@click.command(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.option("--budget", "budget_name", type=click.Choice(list(BUDGETS)), default="cpu", show_default=True)
@click.option(
    "--set",
    "names",
    type=click.Choice((REAL, *SETS)),
    multiple=True,
    help="Train on this. May be repeated.  [default: all]",
)
@click.option("--seeds", type=click.IntRange(1), default=3, show_default=True, help="Runs of each set.")
@click.option("--steps", type=click.IntRange(1), help="Instead of the budget's.")
@click.option("--pairs", type=click.IntRange(1), help="In each dataset, instead of the budget's; not for gpu.")
@click.option(
    "--minutes", type=click.FloatRange(0, min_open=True), help="End after this long, instead of the budget's."
)
@click.option(
    "--real",
    "folders",
    type=click.Path(path_type=Path),
    multiple=True,
    metavar="DIR",
    help="Judge by these scenes too: a folder in Middlebury's layout. May be repeated.",
)
@click.option(
    "--images",
    multiple=True,
    metavar="PATH_OR_GLOB",
    help="Photographs of the place, for all sets but those with pictures of their own.",
)
@click.option(
    "--data",
    type=click.Path(path_type=Path),
    default=Path("out/training-sets"),
    show_default=True,
    help="Folder of the datasets; what is there already is not rendered again.",
)
@click.option("--workers", type=click.IntRange(0), default=0, show_default=True, help="Processes that render.")
@click.option("--device", default="cuda" if torch.cuda.is_available() else "cpu", show_default=True)
@click.option(
    "--json", "out", type=click.Path(path_type=Path, dir_okay=False), help="Write everything here, run by run."
)
@click.option("--go-on", is_flag=True, help="Keep the runs that the file of --json has, and add those that it lacks.")
def main(**options: Any) -> None:  # noqa: ANN401 - as many types as options
    """Train a small network on each set alike, and judge it on real pairs."""
    try:
        run(**options)
    except SemisynthError as error:
        click.echo(f"Error: {error}", err=True)
        sys.exit(_REFUSED)


def run(
    *,
    budget_name: str,
    names: tuple[str, ...],
    seeds: int,
    steps: int | None,
    pairs: int | None,
    minutes: float | None,
    folders: tuple[Path, ...],
    images: tuple[str, ...],
    data: Path,
    workers: int,
    device: str,
    out: Path | None,
    go_on: bool,
) -> None:
    """Do what the options say; see ``--help``.

    Raises:
        InputError: where they cannot be followed.
    """
    budget = BUDGETS[budget_name]
    if pairs and not budget.pairs:
        raise InputError(f"--pairs: --budget {budget_name} renders new pairs all the time: leave --pairs out")
    own = {"steps": steps, "pairs": pairs, "minutes": minutes}
    budget = replace(budget, **{key: value for key, value in own.items() if value is not None})
    on = torch.device(device)
    hardware = Hardware(on, find_precision(on))
    real = read_pairs(folders, budget.factor, budget.max_disparity_px)
    chosen, left_out = choose_sets(names, images, budget)
    if go_on and (out is None or not out.is_file()):
        raise InputError("--go-on: expected --json with the file of an earlier command")
    setup = {
        "budget": json.loads(json.dumps(asdict(replace(budget, minutes=None)))),
        "images": list(images),
        "pairs": list(real),
        "plainness": {name: plainness(pair) for name, pair in real.items()},
    }
    runs = kept_runs(out, setup) if go_on and out is not None else []
    by_pair, mean = judge(real, semi_global(budget.max_disparity_px))
    report = {
        "command": shlex.join(["python", *sys.argv]),
        "machine": {
            **machine_facts(),
            "torch": torch.__version__,
            "device": torch.cuda.get_device_name() if on.type == "cuda" else "cpu",
            "precision": str(hardware.precision).removeprefix("torch."),
            "threads": torch.get_num_threads(),
        },
        "setup": setup,
        "parameters": sum(
            each.numel() for each in MatchingNetwork(budget.max_disparity_px, budget.width).parameters()
        ),
        "sets": {REAL: "the judged pairs themselves"} | {name: row.what for name, row in SETS.items()},
        "semi_global": {"mean": mean, "pairs": by_pair},
        "runs": runs,
        "left_out": [f"{name} ({why})" for name, why in left_out.items()],
    }  # fmt: skip

    def save() -> None:
        if out is not None:
            out.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")

    sources = Sources(images, data, real, workers)
    missing = compare(sources, chosen, seeds, budget, hardware, kept=runs, save=save)
    report["left_out"] += [f"{each} (no time was left)" for each in missing]
    save()
    click.echo(f"{headline(report)}.\n\n{table(report)}")


if __name__ == "__main__":
    main()
