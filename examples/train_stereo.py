"""Train a small stereo network on pairs of this program, and see what it makes of a real pair.

    python examples/train_stereo.py                                  # renders while it trains
    python examples/train_stereo.py --data out/small-rooms           # trains on a dataset

docs/training.md has what comes out.
"""

import json
import shlex
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import numpy as np
import stereo_evaluation as evaluation
from numpy.typing import NDArray

from semisynth_gl.bench.summary import machine_facts
from semisynth_gl.config import load_config
from semisynth_gl.frame.frame import as_rgb
from semisynth_gl.histogram import PixelCount
from semisynth_gl.inputs.errors import InputError, SemisynthError

try:
    import torch
    from stereo_network import StereoNetwork, disparity_loss
    from torch import Tensor, nn
    from torch.utils import data
except ModuleNotFoundError as missing:
    if missing.name != "torch":
        raise
    sys.exit("PyTorch is not installed, and this example trains with it: pip install torch")

STREAM = "stream"
_CONFIG = Path(__file__).with_name("small-rooms.yaml")
_LEARNING_RATE = 2e-3
_RISING = 0.05
"""Share of the steps in which the learning rate rises."""
_WEIGHT_DECAY = 1e-4
_LARGEST_GRADIENT = 1.0
_STEPS_SHOWN = 20
_BIN_PX = 0.25
_REFUSED = 2

Sample = dict[str, Tensor]


def _image(pixels: NDArray[np.uint8]) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(as_rgb(pixels).transpose(2, 0, 1)))


def photographed(images: Tensor, generator: torch.Generator) -> Tensor:
    """Give each image an exposure, a tone curve, a white balance and noise of its own, as two real cameras would.

    Pairs of this program agree to the last bit where both views see a point. Those of cameras do not, and a network
    that has only seen perfect ones relies on it.

    Args:
        images: (B, 3, H, W) uint8, or (B, 1, H, W) of monochrome cameras.
        generator: of the draws, on the CPU.

    Returns:
        (B, 3, H, W) float32 in [0, 1].
    """
    device = images.device

    def drawn(low: float, high: float, channels: int = 1) -> Tensor:
        values = low + (high - low) * torch.rand(len(images), channels, 1, 1, generator=generator)
        return values.to(device)

    noise = torch.randn(images.shape, generator=generator).to(device) * drawn(0.0, 0.02)
    values = (images.float() / 255) ** drawn(0.75, 1.33) * drawn(0.8, 1.2) * drawn(0.95, 1.05, 3) + noise
    return values.clamp(0, 1)


@dataclass(slots=True, eq=False)
class Training:
    """What a training leaves behind.

    Attributes:
        losses: of each step.
        truths: disparities of the pixels that were learnt from.
        seconds: all of it, waiting for pairs included.
        seconds_waiting: for pairs.
    """

    truths: PixelCount
    losses: list[float] = field(default_factory=list)
    seconds: float = 0.0
    seconds_waiting: float = 0.0


def train(
    network: nn.Module,
    batches: Iterator[Sample],
    *,
    steps: int,
    max_disparity: int,
    device: torch.device,
    seed: int = 0,
    tell: Callable[[str], None] = click.echo,
) -> Training:
    """Train a network in place.

    Args:
        network: from two images to estimates, as `StereoNetwork`.
        batches: at least ``steps``: ``left`` and ``right`` (B, 3, H, W) uint8, ``disparity_left`` (B, H, W) px.
        steps: how many batches to learn from.
        max_disparity: px; pixels at or above it are left out.
        device: where the network is.
        seed: of the photometric changes.
        tell: takes a line about how far it is.

    Raises:
        InputError: where the batches end early.
    """
    optimizer = torch.optim.AdamW(network.parameters(), lr=_LEARNING_RATE, weight_decay=_WEIGHT_DECAY)
    # PyTorch divides by zero where the rate is to rise for exactly one step; so few steps get one and a half.
    rising = min(max(_RISING, 1.5 / steps), 0.75)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, _LEARNING_RATE, total_steps=steps, pct_start=rising)
    generator = torch.Generator().manual_seed(seed)
    done = Training(PixelCount(np.arange(0, max_disparity + _BIN_PX, _BIN_PX)))
    start = time.perf_counter()
    network.train()
    for step in range(1, steps + 1):
        asked = time.perf_counter()
        batch = next(batches, None)
        if batch is None:
            raise InputError(f"the pairs ended after {step - 1} of {steps} steps; give fewer --steps")
        done.seconds_waiting += time.perf_counter() - asked
        truth = batch["disparity_left"]
        done.truths.add(truth[(truth > 0) & (truth < max_disparity)].numpy())
        left, right = (photographed(batch[view].to(device), generator) for view in ("left", "right"))
        loss = disparity_loss(network(left, right), truth.to(device), max_disparity)
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), _LARGEST_GRADIENT)
        optimizer.step()
        schedule.step()
        done.losses.append(loss.item())
        done.seconds = time.perf_counter() - start
        if step % _STEPS_SHOWN == 0 or step == steps:
            recent = done.losses[-_STEPS_SHOWN:]
            each = done.seconds / step
            tell(
                f"step {step} of {steps}: loss {sum(recent) / len(recent):.2f}, {each:.2f} s a step, "
                f"{(steps - step) * each / 60:.1f} min left"
            )
    return done


def predictor(network: nn.Module, device: torch.device) -> evaluation.Predictor:
    """Return what predicts with a network, at a pair's full size."""

    def predict(view: evaluation.View) -> NDArray[np.float32]:
        network.eval()
        with torch.inference_mode():
            left, right = (_image(image)[None].to(device).float() / 255 for image in (view.left, view.right))
            found: NDArray[np.float32] = network(left, right).disparities[-1][0].cpu().numpy()
        return found

    return predict


def batches_of(source: data.Dataset[Sample], batch: int, workers: int) -> Iterator[Sample]:
    """Put samples together, with worker processes that read or render ahead."""
    loader: Iterable[Sample] = data.DataLoader(source, batch_size=batch, num_workers=workers, drop_last=True)
    return iter(loader)


def find_device(name: str) -> torch.device:
    """Turn auto, cpu or cuda into a device.

    Raises:
        InputError: where PyTorch has no CUDA here.
    """
    if name == "cuda" and not torch.cuda.is_available():
        raise InputError("--device cuda: PyTorch finds no CUDA here; give --device cpu, or auto for what there is")
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    return torch.device(name)


def needed(sample: dict[str, Any]) -> Sample:
    """Drop what a sample has beside what is learnt from."""
    return {name: sample[name] for name in ("left", "right", "disparity_left")}


def open_source(
    source: str, config: str, settings: tuple[str, ...], crop: tuple[int, int], steps: int, batch: int, seed: int
) -> data.Dataset[Sample]:
    """Open what is trained on: the stream of a config, or a dataset.

    Args:
        source: ``stream``, or a dataset's folder.
        config: the stream's, a name or a path.
        settings: keys of it to override.
        crop: (height, width), px.
        steps: how many batches are needed.
        batch: samples in each.
        seed: of pairs and crops.

    Raises:
        InputError: where it cannot be used.
    """
    from semisynth_gl.torch import Selection, StereoDataset, StereoMix, StereoStream  # noqa: PLC0415 - they load OpenGL

    if source == STREAM:
        made_of = load_config(config, list(settings))
        # A crop is rendered alone where the rest of its pair need not be looked at.
        stream: data.Dataset[Sample] = StereoStream(
            made_of,
            seed,
            Selection(pairs=steps * batch),
            batch_size=batch,
            crop=crop,
            checked=False,
            transform=needed,
        )
        return stream
    if settings or config != str(_CONFIG):
        raise InputError(f"--config and --set are the stream's, and --data {source} is a dataset: leave them out")
    # A mix of one dataset reads it over and over, each time with other crops in another order.
    passes: data.Dataset[Sample] = StereoMix(
        [(StereoDataset(source, crop=crop, transform=needed), 1)], seed, pairs=steps * batch, batch_size=batch
    )
    return passes


@click.command(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.option(
    "--data",
    "source",
    default=STREAM,
    show_default=True,
    metavar="stream|DIR",
    help="Pairs rendered while it trains, or a dataset of this program in any layout.",
)
@click.option(
    "--config", default=str(_CONFIG), metavar="NAME_OR_PATH", help="Of the stream.  [default: small-rooms.yaml here]"
)
@click.option("--set", "settings", multiple=True, metavar="dotted.key=value", help="Override a key of the config.")
@click.option("--steps", type=click.IntRange(1), default=800, show_default=True, help="Batches to learn from.")
@click.option(
    "--crop", type=click.IntRange(16), nargs=2, default=(160, 320), show_default=True, help="Height and width, px."
)
@click.option("--batch", type=click.IntRange(1), default=2, show_default=True, help="Crops in a batch.")
@click.option("--max-disparity", type=click.IntRange(16), default=80, show_default=True, help="Searched range, px.")
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
    "--picture", type=click.Path(path_type=Path), metavar="FILE.png", help="Draw Motorcycle before and after."
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/stereo-network"),
    show_default=True,
    help="Folder for weights.pt and metrics.json.",
)
def main(**options: Any) -> None:  # noqa: ANN401 - as many types as options
    """Train a small stereo network, and compare it with its untrained self and with constants."""
    try:
        run(**options)
    except SemisynthError as error:
        click.echo(f"Error: {error}", err=True)
        sys.exit(_REFUSED)


def run(
    *,
    source: str,
    config: str,
    settings: tuple[str, ...],
    steps: int,
    crop: tuple[int, int],
    batch: int,
    max_disparity: int,
    workers: int,
    device: str,
    seed: int,
    folders: tuple[Path, ...],
    picture: Path | None,
    out: Path,
) -> None:
    """Do what the options say; see ``--help``.

    Raises:
        InputError: where they cannot be followed.
    """
    if picture is not None and not picture.absolute().parent.is_dir():
        raise InputError(f"--picture {picture}: the folder {picture.absolute().parent} does not exist")
    on = find_device(device)
    judges = [evaluation.motorcycle(), *map(evaluation.folder, folders)]
    torch.manual_seed(seed)
    network = StereoNetwork(max_disparity).to(on)
    parameters = sum(each.numel() for each in network.parameters())
    samples = open_source(source, config, settings, crop, steps, batch, seed)
    click.echo(f"{parameters:,} parameters, on {on.type}, {torch.get_num_threads()} threads")
    predict = predictor(network, on)
    rows: list[dict[str, dict[str, float]]] = [{"untrained": evaluation.figures(each, predict)} for each in judges]
    for each, row in zip(judges, rows, strict=True):
        click.echo(f"untrained on {each.title}: avgerr {row['untrained']['avgerr']:.2f} px")
    [shown] = (read() for read in judges[0].views.values())
    before = predict(shown)

    batches = batches_of(samples, batch, workers)
    done = train(network, batches, steps=steps, max_disparity=max_disparity, device=on, seed=seed)

    median_px = done.truths.histogram.quantile(0.5)
    for each, row in zip(judges, rows, strict=True):
        row[f"constant {median_px:.1f} px, the training's median"] = evaluation.figures(
            each, evaluation.constant(median_px)
        )
        row["constant, each truth's own median"] = evaluation.figures(each, evaluation.best_constant)
        row["trained"] = evaluation.figures(each, predict)
        click.echo(f"\n{evaluation.table(each, row)}")
    out.mkdir(parents=True, exist_ok=True)
    torch.save({"max_disparity": max_disparity, "network": network.state_dict()}, out / "weights.pt")
    report = {
        "command": shlex.join(["python", *sys.argv]),
        "machine": {
            **machine_facts(),
            "torch": torch.__version__,
            "device": on.type,
            "threads": torch.get_num_threads(),
        },
        "parameters": parameters,
        "steps": steps,
        "batch": batch,
        "crop_px": list(crop),
        "max_disparity_px": max_disparity,
        "seed": seed,
        "seconds": done.seconds,
        "seconds_waiting_for_pairs": done.seconds_waiting,
        "training_median_px": median_px,
        "results": [
            {"on": each.title, "protocol": each.protocol, "figures": row}
            for each, row in zip(judges, rows, strict=True)
        ],
        "losses": [round(loss, 4) for loss in done.losses],
    }
    (out / "metrics.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    click.echo(f"\n{done.seconds / 60:.1f} minutes; weights and figures are in {out}")
    if picture is not None:
        evaluation.picture(shown, before, predict(shown), done.losses).savefig(picture)


if __name__ == "__main__":
    main()
