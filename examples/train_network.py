"""Train a stereo network on pairs of this program, and see what it makes of real pairs.

    python examples/train_network.py                                   # a small network; pairs rendered as it trains
    python examples/train_network.py --data out/small-rooms            # on a dataset
    python examples/train_network.py --network my_module:MyNetwork --loss sequence --pretrained theirs.pth
    torchrun --nproc-per-node 4 examples/train_network.py              # on four GPUs

docs/training.md has what comes out.
"""

import json
import shlex
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np
import stereo_evaluation as evaluation
from numpy.typing import NDArray

from semisynth_gl.augmentation import PRESETS
from semisynth_gl.bench.summary import machine_facts
from semisynth_gl.cli.options import COUNT, MOST_WORKERS, above_0, name_option
from semisynth_gl.inputs.errors import InputError, SemisynthError

try:
    import torch
    from network_data import Data, Sample, batches_of, read_augmentation, read_sources, with_augmentation
    from network_form import LARGEST_MULTIPLE, LEVELS, Form, find_device, load_weights
    from network_losses import LOSSES
    from network_training import PRECISIONS, Plan, Training, join_processes
    from torch import distributed
except ModuleNotFoundError as missing:
    if missing.name != "torch":
        raise
    sys.exit("PyTorch is not installed, and this example trains with it: pip install torch")

CHECKPOINT = "checkpoint.pt"
PRETRAINED = "pretrained"
_CONFIG = Path(__file__).with_name("small-rooms.yaml")
_STEPS_SHOWN = 20
_REFUSED = 2
_MOST_PX = 4096
# A step's seed is this times the most steps times 1000, and PyTorch's seeds have 64 bits.
_LARGEST_SEED = 1_000_000_000


class Judged:
    """What real pairs say of a network: before it learns, on the way, and after.

    Args:
        judges: of real pairs; pictures show the first one's only pair.
        training: of the network.
        out: folder for pictures and figures.
        before: name of the network before it learns.
    """

    def __init__(self, judges: list[evaluation.Judges], training: Training, out: Path, before: str) -> None:
        self._judges, self._training, self._out = judges, training, out
        self._positive = False
        self._rows = [{before: evaluation.figures(each, self._predict)} for each in judges]
        [self._shown] = (read() for read in judges[0].views.values())
        self._before = self._predict(self._shown)
        self._tell(before, self._rows, before)
        if before == PRETRAINED:
            self._warn()

    def look(self) -> None:
        """Judge the network on the way, and draw what it makes of the first pair."""
        self._positive = False
        found = [{"now": evaluation.figures(each, self._predict)} for each in self._judges]
        self._tell(f"step {self._training.step}", found, "now")
        self._warn()
        self._draw()

    def report(self, facts: dict[str, Any]) -> None:
        """Judge the trained network, and write weights, a picture and all figures."""
        self._positive = False
        for each, row in zip(self._judges, self._rows, strict=True):
            row["constant, each truth's own median"] = evaluation.figures(each, evaluation.best_constant)
            row["trained"] = evaluation.figures(each, self._predict)
            click.echo(f"\n{evaluation.table(each, row)}")
        self._warn()
        self._draw()
        weights = self._training.network.state_dict()
        torch.save({"network": weights, "form": self._training.form.values}, self._out / "weights.pt")
        results = [
            {"on": each.title, "protocol": each.protocol, "figures": row}
            for each, row in zip(self._judges, self._rows, strict=True)
        ]
        facts |= {"results": results, "losses": [round(loss, 4) for loss in self._training.losses]}
        (self._out / "metrics.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
        click.echo(f"\nweights, pictures and figures are in {self._out}")

    def _tell(self, when: str, rows: list[dict[str, dict[str, float]]], name: str) -> None:
        for each, row in zip(self._judges, rows, strict=True):
            click.echo(f"{when}, {each.title}: avgerr {row[name]['avgerr']:.2f} px")

    def _predict(self, view: evaluation.View) -> NDArray[np.float32]:
        found = self._training.form.predict(self._training.network, view.left, view.right)
        self._positive |= bool((found > 0).any())
        return found

    def _warn(self) -> None:
        if not self._positive:
            click.echo(
                "Warning: no disparity that the network predicts is above 0 px: does it give negative disparities, or "
                "the right view's? The left view's disparities are expected, and they are positive",
                err=True,
            )

    def _draw(self) -> None:
        folder = self._out / "pictures"
        folder.mkdir(parents=True, exist_ok=True)
        drawn = evaluation.picture(self._shown, self._before, self._predict(self._shown), self._training.losses)
        drawn.savefig(folder / f"step-{self._training.step:06d}.png")


def _progress(training: Training, begun: int, seconds: float) -> str:
    recent, steps = training.losses[-_STEPS_SHOWN:], training.plan.steps
    each = seconds / (training.step - begun)
    return (
        f"step {training.step} of {steps}: loss {sum(recent) / len(recent):.2f}, {each:.2f} s a step, "
        f"{(steps - training.step) * each / 60:.1f} min left"
    )


def learn(training: Training, batches: Iterator[Sample], out: Path, every: int, judged: Judged | None) -> float:
    """Learn to the end, with a checkpoint and a look at real pairs every so many steps.

    Args:
        training: its step says where it begins.
        batches: the batches from there on.
        out: folder for the checkpoint.
        every: steps between checkpoints.
        judged: None in processes that leave files and words to the first.

    Returns:
        Seconds that it waited for batches.
    """
    begun, start, waited = training.step, time.perf_counter(), 0.0
    while training.step < training.plan.steps:
        asked = time.perf_counter()
        batch = next(batches)
        waited += time.perf_counter() - asked
        training.learn(batch)
        last = training.step == training.plan.steps
        # The other processes wait for the first one in the next step.
        if judged is not None and (training.step % _STEPS_SHOWN == 0 or last):
            click.echo(_progress(training, begun, time.perf_counter() - start))
        if judged is not None and (training.step % every == 0 or last):
            out.mkdir(parents=True, exist_ok=True)
            training.save(out / CHECKPOINT)
            if not last:
                judged.look()
    return waited


@click.command(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.option(
    "--network",
    default="stereo_network:StereoNetwork",
    show_default=True,
    metavar="MODULE:CALLABLE",
    help="Callable that returns the network, such as my_network:make; the module lies in the current folder or "
    "beside this script, or is installed. The network takes left and right and gives the left disparity, px.",
)
@click.option(
    "--argument",
    "arguments",
    multiple=True,
    metavar="name=value",
    help="An argument of that callable, its value in YAML, such as width=32. May be repeated.",
)
@click.option(
    "--levels",
    type=click.Choice(list(LEVELS)),
    default="unit",
    show_default=True,
    help="Levels of the images that the network takes: unit is [0, 1], byte [0, 255], imagenet normalised by "
    "ImageNet's mean and deviation.",
)
@click.option(
    "--pretrained",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Begin with these weights of the same network, in a file of torch.save, such as weights.pt.",
)
@click.option(
    "--data",
    "sources",
    multiple=True,
    default=(str(_CONFIG),),
    metavar="CONFIG|DIR[=SHARE]",
    help="A config, whose pairs are rendered while it trains, or a dataset's folder; with its share of the samples, "
    "such as place.yaml=3. May be repeated.  [default: small-rooms.yaml here]",
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="dotted.key=value",
    help="Override a key of the configs, such as camera.width_px=640. May be repeated.",
)
@click.option(
    "--augment",
    default="semisynth",
    show_default=True,
    metavar="NAME|FILE.yaml",
    help=f"A preset ({', '.join(PRESETS)}), or a YAML file with keys of Augmentation, such as noise: [0, 3].",
)
@click.option(
    "--loss",
    type=click.Choice(list(LOSSES)),
    default="cross-entropy",
    show_default=True,
    help="cross-entropy needs scores, as the small network gives them; smooth-l1 is PSMNet's, sequence RAFT-Stereo's.",
)
@click.option("--steps", type=COUNT, default=800, show_default=True, help="Batches to learn from.")
@click.option(
    "--crop",
    type=click.IntRange(16, _MOST_PX),
    nargs=2,
    default=(160, 320),
    show_default=True,
    metavar="HEIGHT WIDTH",
    help="Sides of the parts of pairs to learn from, px.",
)
@click.option(
    "--batch",
    type=click.IntRange(1, 4096),
    default=2,
    show_default=True,
    help="Crops that each process takes in a step.",
)
@click.option(
    "--max-disparity",
    type=click.IntRange(16, _MOST_PX),
    default=80,
    show_default=True,
    help="End of the searched range, px; larger disparities are not learnt from.",
)
@click.option(
    "--learning-rate",
    type=above_0(10),
    default=2e-3,
    show_default=True,
    help="AdamW's, at its highest: it rises, then falls.",
)
@click.option(
    "--precision",
    type=click.Choice(list(PRECISIONS)),
    default="float32",
    show_default=True,
    help="Of convolutions and products; 16 bits are for GPUs.",
)
@click.option(
    "--fixed-norms",
    is_flag=True,
    help="Batch normalisation keeps its running means and variances, as when weights are tuned with small batches.",
)
@click.option(
    "--workers",
    type=click.IntRange(0, MOST_WORKERS),
    default=1,
    show_default=True,
    help="Processes that read or render pairs ahead; 0 leaves it to the training.",
)
@click.option(
    "--device",
    type=click.Choice(("auto", "cpu", "cuda")),
    default="auto",
    show_default=True,
    help="auto takes a GPU where PyTorch finds one.",
)
@click.option(
    "--seed",
    type=click.IntRange(0, _LARGEST_SEED),
    default=0,
    show_default=True,
    help="A whole number; another one draws other pairs, crops, changes and first weights.",
)
@click.option(
    "--evaluate",
    "folders",
    type=click.Path(path_type=Path),
    multiple=True,
    metavar="DIR",
    help="Judge by these pairs with truth too: scenes of Middlebury's or ETH3D's form, each with im0.png, im1.png and "
    "disp0GT.pfm, such as MiddEval3/trainingQ, or a dataset of this program. May be repeated.",
)
@click.option(
    "--multiple",
    type=click.IntRange(1, LARGEST_MULTIPLE),
    default=1,
    show_default=True,
    help="The network needs sides that are multiples of this, px, such as 32: pad images that are judged or predicted, "
    "but not crops.",
)
@click.option("--every", type=COUNT, default=200, show_default=True, help="Steps between checkpoints and judgements.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/stereo-network"),
    show_default=True,
    help="Folder for checkpoint.pt, pictures/, weights.pt and metrics.json.",
)
@click.option("--resume", is_flag=True, help="Go on from the checkpoint in --out.")
def main(**options: Any) -> None:  # noqa: ANN401 - as many types as options
    """Train a stereo network, and compare it with what it was before and with a constant."""
    try:
        run(**options)
    except SemisynthError as error:
        if isinstance(error, InputError):
            name_option(error, main)
        click.echo(f"Error: {with_augmentation(str(error), options['augment'])}", err=True)
        sys.exit(_REFUSED)
    finally:
        if distributed.is_available() and distributed.is_initialized():
            distributed.destroy_process_group()


def run(
    *,
    network: str,
    arguments: tuple[str, ...],
    levels: str,
    pretrained: Path | None,
    sources: tuple[str, ...],
    settings: tuple[str, ...],
    augment: str,
    loss: str,
    steps: int,
    crop: tuple[int, int],
    batch: int,
    max_disparity: int,
    learning_rate: float,
    precision: str,
    fixed_norms: bool,
    workers: int,
    device: str,
    seed: int,
    folders: tuple[Path, ...],
    multiple: int,
    every: int,
    out: Path,
    resume: bool,
) -> None:
    """Do what the options say; see ``--help``.

    Raises:
        InputError: where they cannot be followed.
    """
    checkpoint = out / CHECKPOINT
    if checkpoint.exists() and not resume:
        raise InputError(f"--out {out}: {CHECKPOINT} is there already: give --resume to go on, or another folder")
    if resume and not checkpoint.exists():
        raise InputError(f"--resume: there is no {checkpoint}: leave --resume out to begin")
    judges = [evaluation.motorcycle(), *map(evaluation.folder, folders)]
    data = Data(read_sources(sources), settings, crop, read_augmentation(augment), batch, seed)
    on = find_device(device)
    rank, processes = join_processes(on)
    torch.manual_seed(seed)
    form = Form(network, arguments, levels, max_disparity, multiple)
    made = form.make().to(on)
    if pretrained is not None:
        load_weights(made, pretrained, on)
    plan = Plan(steps, loss, learning_rate, precision, fixed_norms, seed)
    identity = {
        "data": json.loads(json.dumps(data.samples().source.identity)),
        "augmentation": data.augmentation.values,
        "batch": batch,
        "processes": processes,
        "pretrained": pretrained and str(pretrained),
    }
    training = Training(made, form, plan, on, rank, identity)
    judged = Judged(judges, training, out, PRETRAINED if pretrained else "untrained") if rank == 0 else None
    if resume:
        training.load(checkpoint)
        if judged is not None:
            click.echo(f"going on from step {training.step}")
    batches = batches_of(data, training.step * batch * processes, workers)
    parameters = sum(each.numel() for each in made.parameters())
    if judged is not None:
        click.echo(f"{parameters:,} parameters, on {processes} x {on.type}, {torch.get_num_threads()} threads")
    begun = training.step
    start = time.perf_counter()
    waited = learn(training, batches, out, every, judged)
    if judged is not None:
        facts = {
            "command": shlex.join(["python", *sys.argv]),
            "machine": {
                **machine_facts(),
                "torch": torch.__version__,
                "device": on.type,
                "threads": torch.get_num_threads(),
            },
            "parameters": parameters,
            **training.identity,
            "seconds": time.perf_counter() - start,
            "seconds_waiting_for_pairs": waited,
            "steps_in_these_seconds": steps - begun,
        }
        judged.report(facts)


if __name__ == "__main__":
    main()
