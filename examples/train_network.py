"""Train a stereo network on pairs of this program, and see what it makes of real pairs.

    python examples/train_network.py                                   # a small network; pairs rendered as it trains
    python examples/train_network.py --data out/small-rooms            # on a dataset
    python examples/train_network.py --network my_module:MyNetwork --loss sequence --pretrained theirs.pth
    torchrun --nproc-per-node 4 examples/train_network.py              # on four GPUs

docs/training.md has what comes out.
"""

import inspect
import json
import shlex
import sys
import time
from collections.abc import Callable, Iterator
from importlib import import_module
from io import StringIO
from pathlib import Path
from typing import Any

import click
import numpy as np
import stereo_evaluation as evaluation
from numpy.typing import NDArray
from ruamel.yaml import YAML

from semisynth_gl.augmentation import PRESETS
from semisynth_gl.bench.summary import machine_facts
from semisynth_gl.frame.frame import as_rgb
from semisynth_gl.inputs.errors import InputError, SemisynthError

try:
    import torch
    from network_data import Data, Sample, batches_of, read_augmentation, read_sources
    from network_losses import LOSSES, estimates_of
    from network_training import LEVELS, PRECISIONS, Plan, Training, load_weights, start_process
    from torch import Tensor, distributed, nn
    from torch.nn import functional
except ModuleNotFoundError as missing:
    if missing.name != "torch":
        raise
    sys.exit("PyTorch is not installed, and this example trains with it: pip install torch")

CHECKPOINT = "checkpoint.pt"
_CONFIG = Path(__file__).with_name("small-rooms.yaml")
_STEPS_SHOWN = 20
_REFUSED = 2


def make_network(address: str, arguments: tuple[str, ...], max_disparity: int) -> nn.Module:
    """Make the network that a callable returns; a callable that has ``max_disparity`` gets the searched range.

    Args:
        address: ``module:callable``; modules beside this file, in the current folder and installed ones.
        arguments: ``name=value`` of the callable, values in YAML.
        max_disparity: px.

    Raises:
        InputError: where there is no such callable, or it returns something else.
    """
    module, _, name = address.partition(":")
    given = dict(argument.partition("=")[::2] for argument in arguments)
    values = {key: YAML(typ="safe").load(StringIO(value)) for key, value in given.items()}
    sys.path.append(str(Path.cwd()))
    try:
        made_by: Callable[..., Any] = getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(f"--network {address}: expected module:callable: {error}") from None
    if "max_disparity" in inspect.signature(made_by).parameters:
        values.setdefault("max_disparity", max_disparity)
    try:
        network = made_by(**values)
    except TypeError as error:
        raise InputError(f"--network {address} with --argument {' '.join(arguments) or 'none'}: {error}") from None
    if not isinstance(network, nn.Module):
        raise InputError(f"--network {address}: expected a torch.nn.Module, got {type(network).__name__}")
    return network


def predictor(training: Training, multiple: int) -> evaluation.Predictor:
    """Return what predicts with a network, at a pair's full size, padded to sides that are multiples of a number."""

    def predict(view: evaluation.View) -> NDArray[np.float32]:
        height, width = view.left.shape[:2]
        # Below and to the right, so that the padding moves no pixel.
        padding = (0, -width % multiple, 0, -height % multiple)
        left, right = (
            functional.pad(
                torch.from_numpy(as_rgb(image).transpose(2, 0, 1).copy())[None].float(), padding, "replicate"
            )
            for image in (view.left, view.right)
        )
        found: Tensor = estimates_of(training.estimate(left, right))[-1][0, :height, :width]
        return found.float().cpu().numpy()

    return predict


class Judged:
    """What real pairs say of a network: before it learns, on the way, and after.

    Args:
        judges: of real pairs; pictures show the first one's only pair.
        predict: with the network.
        out: folder for pictures and figures.
        before: name of the network before it learns.
    """

    def __init__(self, judges: list[evaluation.Judges], predict: evaluation.Predictor, out: Path, before: str) -> None:
        self._judges, self._predict, self._out = judges, predict, out
        self._rows = [{before: evaluation.figures(each, predict)} for each in judges]
        [self._shown] = (read() for read in judges[0].views.values())
        self._before = predict(self._shown)
        self._tell(before, self._rows, before)

    def look(self, training: Training) -> None:
        """Judge the network on the way, and draw what it makes of the first pair."""
        found = [{"now": evaluation.figures(each, self._predict)} for each in self._judges]
        self._tell(f"step {training.step}", found, "now")
        self._draw(training)

    def report(self, training: Training, facts: dict[str, Any]) -> None:
        """Judge the trained network, and write weights, a picture and all figures."""
        for each, row in zip(self._judges, self._rows, strict=True):
            row["constant, each truth's own median"] = evaluation.figures(each, evaluation.best_constant)
            row["trained"] = evaluation.figures(each, self._predict)
            click.echo(f"\n{evaluation.table(each, row)}")
        self._draw(training)
        torch.save({"network": training.network.state_dict()}, self._out / "weights.pt")
        results = [
            {"on": each.title, "protocol": each.protocol, "figures": row}
            for each, row in zip(self._judges, self._rows, strict=True)
        ]
        facts |= {"results": results, "losses": [round(loss, 4) for loss in training.losses]}
        (self._out / "metrics.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
        click.echo(f"\nweights, pictures and figures are in {self._out}")

    def _tell(self, when: str, rows: list[dict[str, dict[str, float]]], name: str) -> None:
        for each, row in zip(self._judges, rows, strict=True):
            click.echo(f"{when}, {each.title}: avgerr {row[name]['avgerr']:.2f} px")

    def _draw(self, training: Training) -> None:
        folder = self._out / "pictures"
        folder.mkdir(parents=True, exist_ok=True)
        drawn = evaluation.picture(self._shown, self._before, self._predict(self._shown), training.losses)
        drawn.savefig(folder / f"step-{training.step:06d}.png")


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
                judged.look(training)
    return waited


@click.command(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.option(
    "--network",
    default="stereo_network:StereoNetwork",
    show_default=True,
    metavar="MODULE:CALLABLE",
    help="Returns the network, which takes left and right and gives the left disparity.",
)
@click.option("--argument", "arguments", multiple=True, metavar="name=value", help="Of that callable.")
@click.option(
    "--levels",
    type=click.Choice(list(LEVELS)),
    default="unit",
    show_default=True,
    help="It takes images in [0, 1], in [0, 255], or normalised as ImageNet's.",
)
@click.option("--pretrained", type=click.Path(path_type=Path), metavar="FILE", help="Begin with these weights.")
@click.option(
    "--data",
    "sources",
    multiple=True,
    default=(str(_CONFIG),),
    metavar="CONFIG|DIR[=SHARE]",
    help="A config, rendered while it trains, or a dataset. May be repeated.  [default: small-rooms.yaml here]",
)
@click.option("--set", "settings", multiple=True, metavar="dotted.key=value", help="Override a key of the configs.")
@click.option(
    "--augment",
    default="semisynth",
    show_default=True,
    metavar="NAME|FILE.yaml",
    help=f"{', '.join(PRESETS)}, or keys of Augmentation.",
)
@click.option("--loss", type=click.Choice(list(LOSSES)), default="cross-entropy", show_default=True)
@click.option("--steps", type=click.IntRange(1), default=800, show_default=True, help="Batches to learn from.")
@click.option(
    "--crop", type=click.IntRange(16), nargs=2, default=(160, 320), show_default=True, help="Height and width, px."
)
@click.option("--batch", type=click.IntRange(1), default=2, show_default=True, help="Crops in a batch of a process.")
@click.option("--max-disparity", type=click.IntRange(16), default=80, show_default=True, help="Searched range, px.")
@click.option("--learning-rate", type=click.FloatRange(0, min_open=True), default=2e-3, show_default=True)
@click.option("--precision", type=click.Choice(list(PRECISIONS)), default="float32", show_default=True)
@click.option("--fixed-norms", is_flag=True, help="Batch normalisation keeps its running means.")
@click.option(
    "--workers", type=click.IntRange(0), default=1, show_default=True, help="Processes that read or render ahead."
)
@click.option("--device", type=click.Choice(("auto", "cpu", "cuda")), default="auto", show_default=True)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Another seed, another network.")
@click.option(
    "--evaluate",
    "folders",
    type=click.Path(path_type=Path),
    multiple=True,
    metavar="DIR",
    help="Judge by these pairs too: scenes of Middlebury's form, or a dataset of this program. May be repeated.",
)
@click.option(
    "--multiple", type=click.IntRange(1), default=1, show_default=True, help="Of which the network needs sides, px."
)
@click.option(
    "--every", type=click.IntRange(1), default=200, show_default=True, help="Steps between checkpoints and judgements."
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/stereo-network"),
    show_default=True,
    help="Folder for checkpoint.pt, pictures, weights.pt and metrics.json.",
)
@click.option("--resume", is_flag=True, help="Go on from the checkpoint in --out.")
def main(**options: Any) -> None:  # noqa: ANN401 - as many types as options
    """Train a stereo network, and compare it with what it was before and with a constant."""
    try:
        run(**options)
    except SemisynthError as error:
        click.echo(f"Error: {error}", err=True)
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
    on, rank, processes = start_process(device)
    torch.manual_seed(seed)
    made = make_network(network, arguments, max_disparity).to(on)
    if pretrained is not None:
        load_weights(made, pretrained, on)
    plan = Plan(steps, loss, levels, max_disparity, learning_rate, precision, fixed_norms, seed)
    identity = {
        "network": [network, *arguments],
        "data": [list(map(list, data.sources)), list(settings), list(crop), batch, processes],
        "augmentation": data.augmentation.values,
        "pretrained": pretrained and str(pretrained),
    }
    training = Training(made, plan, on, rank, identity)
    predict = predictor(training, multiple)
    judged = Judged(judges, predict, out, "pretrained" if pretrained else "untrained") if rank == 0 else None
    if resume:
        training.load(checkpoint)
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
        judged.report(training, facts)


if __name__ == "__main__":
    main()
