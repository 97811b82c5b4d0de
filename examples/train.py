"""Train a stereo network on pairs of this program, and evaluate it on real pairs.

    pip install lightning tensorboard
    python examples/train.py                                       # a small network, on pairs rendered during training
    python examples/train.py --data out/rooms                      # on a dataset
    python examples/train.py --network my_module:make --loss sequence --pretrained theirs.pth
    python examples/train.py --devices 4 --precision bf16-mixed    # on four GPUs

docs/training.md lists the results.
"""

import importlib
import inspect
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from pickle import UnpicklingError
from types import SimpleNamespace
from typing import Any

import click
import lightning
import torch
from judged_pairs import COLUMNS, folder, motorcycle, picture
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.loggers import TensorBoardLogger
from lightning.pytorch.utilities.exceptions import MisconfigurationException
from ruamel.yaml import YAML, YAMLError
from stereo_network import cross_entropy_loss
from torch import Tensor, nn
from torch.nn import functional
from torch.utils.data import ConcatDataset, DataLoader, WeightedRandomSampler

from semisynth_gl import score
from semisynth_gl.config import load_config
from semisynth_gl.inputs.errors import InputError, SemisynthError
from semisynth_gl.torch import PRESETS, Augmentation, Sample, StereoDataset, StereoStream

CONTEXT = {"help_option_names": ["-h", "--help"], "show_default": True, "max_content_width": 100}
CONFIG = Path(__file__).with_name("small-rooms.yaml")
_FILE = click.Path(path_type=Path, exists=True)
LOSSES = "cross-entropy", "smooth-l1", "sequence"
Part = StereoDataset | StereoStream
_MULTIPLE_PX = 32
"""Whole images are padded to multiples of this, since published networks need that."""
_MEAN, _DEVIATION = [[[0.485]], [[0.456]], [[0.406]]], [[[0.229]], [[0.224]], [[0.225]]]
LEVELS: Mapping[str, Callable[[Tensor], Tensor]] = {
    "unit": lambda images: images / 255,
    "byte": lambda images: images,
    "imagenet": lambda images: (images / 255 - images.new_tensor(_MEAN)) / images.new_tensor(_DEVIATION),
}


def needed(sample: Sample) -> Sample:
    """Return only the keys that training uses."""
    return {name: sample[name] for name in ("left", "right", "disparity_left")}


def estimates(output: Any) -> list[Tensor]:  # noqa: ANN401 - a tensor, a list, or an object with disparities
    """Return a network's estimates of the left disparity, (B, H, W) px each, the final one last."""
    output = getattr(output, "disparities", output)
    several = [output] if isinstance(output, Tensor) else list(output)
    return [each[:, 0] if each.ndim == 4 else each for each in several]


def loss_of(name: str, output: Any, truth: Tensor, valid: Tensor) -> Tensor:  # noqa: ANN401 - as estimates takes it
    """Return the loss of a network's output for the true disparity (B, H, W) px, over the ``valid`` pixels (B, H, W).

    ``sequence`` is the mean absolute error of all estimates with RAFT-Stereo's weights, which increase from estimate to
    estimate. ``smooth-l1`` is the mean smooth L1 error with PSMNet's weights. ``cross-entropy`` adds the cross-entropy
    of the scores of disparity levels, with which networks learn faster.
    """
    found = estimates(output)
    error, weights = functional.smooth_l1_loss, [*([0.5] * len(found)), 0.7, 1.0][-len(found) :]
    if name == "sequence":
        decay = 0.9 ** (15 / max(1, len(found) - 1))
        error, weights = functional.l1_loss, [decay ** (len(found) - 1 - i) for i in range(len(found))]
    losses = [error(each.float()[valid], truth[valid], reduction="sum") for each in found]
    loss = truth.new_tensor(weights) @ torch.stack(losses) / valid.sum().clamp(min=1)
    if name == "cross-entropy":
        if not hasattr(output, "scores"):
            raise InputError("--loss cross-entropy: the network gives no scores: use --loss smooth-l1 or sequence")
        loss = loss + cross_entropy_loss(output, truth, valid)
    return loss


class StereoModule(lightning.LightningModule):
    """A network with its loss, optimiser and evaluation. Each argument is the option of the same name."""

    def __init__(self, network: str, arguments: Sequence[str], max_disparity: int, **_: Any) -> None:  # noqa: ANN401
        super().__init__()
        self.save_hyperparameters()
        self.network = _made(network, arguments, max_disparity)

    def forward(self, left: Tensor, right: Tensor) -> Any:  # noqa: ANN401 - the network's output
        """Run the network on images (B, 3 or 1, H, W) with levels from 0 to 255."""
        levels = LEVELS[self.hparams["levels"]]
        return self.network(*(levels(each.float().expand(-1, 3, -1, -1)) for each in (left, right)))

    def predict_disparity(self, left: Tensor, right: Tensor) -> Tensor:
        """Return the left disparity (H, W), px, of whole images (3, H, W) uint8."""
        height, width = left.shape[1:]
        # Pads below and to the right, which moves no pixel.
        padding = (0, -width % _MULTIPLE_PX, 0, -height % _MULTIPLE_PX)
        views = [functional.pad(each[None].float(), padding, "replicate") for each in (left, right)]
        return estimates(self(*views))[-1][0, :height, :width].float()

    def transfer_batch_to_device(self, batch: dict[str, Any], device: torch.device, _: int) -> dict[str, Any]:
        """Move tensors to the device; items of real pairs also contain other objects."""
        return {name: each.to(device) if isinstance(each, Tensor) else each for name, each in batch.items()}

    def on_train_batch_start(self, *_: object) -> None:
        """Seed torch's generators by the step, so that resuming does not change the training."""
        torch.manual_seed((self.hparams["seed"] << 32) + self.global_step * self.trainer.world_size + self.global_rank)

    def training_step(self, batch: Sample, _: int) -> Tensor:
        """Return the loss of a batch."""
        truth = batch["disparity_left"]
        valid = torch.isfinite(truth) & (truth > 0) & (truth < self.hparams["max_disparity"])
        loss = loss_of(self.hparams["loss"], self(batch["left"], batch["right"]), truth, valid)
        if not torch.isfinite(loss):
            raise SemisynthError(f"step {self.global_step}: the loss is {loss}: lower --learning-rate")
        self.log("loss", loss, prog_bar=True)
        return loss

    def validation_step(self, pair: dict[str, Any], number: int, dataloader_idx: int = 0) -> None:
        """Log the error measures of a real pair, and a figure of the first pair."""
        found = self.predict_disparity(pair["left"], pair["right"]).cpu().numpy()
        figures = score(found, pair["truth"], pair["protocol"])
        for name in COLUMNS:
            self.log(f"{pair['set']}: {name}", figures[name], batch_size=1, sync_dist=True, add_dataloader_idx=False)
        if number == dataloader_idx == 0 and isinstance(self.logger, TensorBoardLogger):
            self.logger.experiment.add_figure(pair["name"], picture(pair, found), self.global_step)

    def on_validation_epoch_end(self) -> None:
        """Print the mean errors."""
        for name, value in self.trainer.callback_metrics.items():
            if name.endswith(": avgerr"):
                self.print(f"step {self.global_step}: {name} {value:.2f} px")

    def configure_optimizers(self) -> Any:  # noqa: ANN401 - Lightning's own choice of types
        """Return AdamW, with a learning rate that rises in the first steps and then falls."""
        rate, steps = self.hparams["learning_rate"], self.hparams["steps"]
        optimizer = torch.optim.AdamW(self.network.parameters(), lr=rate, weight_decay=1e-4)
        # Never exactly one step of rise, for which PyTorch divides by zero.
        rising = min(max(0.05, 1.5 / steps), 0.75)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, rate, steps, pct_start=rising)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


def _made(address: str, arguments: Sequence[str], max_disparity: int) -> nn.Module:
    """Call ``module:callable`` with arguments ``name=value``, values in YAML."""
    module, _, name = address.partition(":")
    if str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))
    try:
        made_by = getattr(importlib.import_module(module), name)
        values = {key: YAML(typ="safe").load(value) for key, _, value in (each.partition("=") for each in arguments)}
        if "max_disparity" in inspect.signature(made_by).parameters:
            values.setdefault("max_disparity", max_disparity)
        network: nn.Module = made_by(**values)
    except (ImportError, AttributeError, TypeError, ValueError, YAMLError) as error:
        raise InputError(f"--network {address}: expected module:callable and its --arguments: {error}") from error
    return network


def load_weights(network: nn.Module, path: Path) -> None:
    """Load weights into a network from a checkpoint of this script or a file of torch.save."""
    try:
        state, own = torch.load(path, map_location="cpu", weights_only=True), network.state_dict()
        state = next((state[key] for key in ("state_dict", "network", "model") if key in state), state)
        short = {name: name.removeprefix("module.").removeprefix("network.") for name in state}
        network.load_state_dict({name if name in own else short[name]: each for name, each in state.items()})
    except (UnpicklingError, EOFError, RuntimeError, TypeError, AttributeError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: expected weights of this network, and no code: {reason}") from None


def read_augmentation(value: str) -> Augmentation:
    """Return the preset of this name, or an augmentation with the keys of a YAML file."""
    try:
        return PRESETS[value] if value in PRESETS else Augmentation(**YAML(typ="safe").load(Path(value)))
    except (OSError, TypeError, YAMLError, InputError) as error:
        known = f"expected {', '.join(PRESETS)}, or a YAML file with keys of Augmentation"
        raise InputError(f"--augment {value}: {known}: {error}") from None


def open_source(value: str, pairs: int, seed: int, options: dict[str, Any]) -> tuple[Part, float]:
    """Open ``CONFIG|DIR[=SHARE]`` as a stream of ``pairs`` pairs or as a dataset; return it with its share."""
    name, _, share = value.rpartition("=") if "=" in value else (value, "", "1")
    if not share.replace(".", "", 1).isdecimal() or float(share) == 0:
        raise InputError(f"--data {value}: expected a share above 0 after =, got {share}")
    if Path(name).is_dir():
        return StereoDataset(name, seed=seed, **options), float(share)
    return StereoStream(load_config(name), seed, pairs, checked=False, **options), float(share)


class TrainingOrder(WeightedRandomSampler):
    """The random order of an epoch's samples, with the shares of the sources; each device gets a part of them.

    The order depends on the seed and the trainer's step, so a resumed training continues its epoch. An epoch has as
    many samples as possible without using a source more than once on average.
    """

    def __init__(
        self, sources: Sequence[tuple[Part, float]], batch: int, seed: int, trainer: lightning.Trainer
    ) -> None:
        total = sum(share for _, share in sources)
        weights = torch.cat([torch.full((len(part),), share / total / len(part)) for part, share in sources])
        samples = int(min(len(part) * total / share for part, share in sources))
        super().__init__(weights, samples, replacement=len(sources) > 1, generator=torch.Generator())
        self._parts, self._batch, self._seed, self._trainer = [part for part, _ in sources], batch, seed, trainer
        self._steps = samples // (batch * trainer.world_size)
        if not self._steps:
            raise InputError(f"--data: {samples} pairs are fewer than --batch {batch} for each device")

    def __len__(self) -> int:
        return self._steps * self._batch

    def __iter__(self) -> Iterator[int]:
        epoch, step = divmod(self._trainer.global_step, self._steps)
        for part in self._parts:
            part.set_epoch(epoch)
        self.generator.manual_seed(self._seed + epoch)
        own = [*super().__iter__()][self._trainer.global_rank :: self._trainer.world_size]
        return iter(own[step * self._batch : len(self)])


class Command(click.Command):
    """A command that reports expected errors as a message without a traceback, with exit code 2."""

    def invoke(self, ctx: click.Context) -> None:
        """Run the command."""
        try:
            super().invoke(ctx)
        except (SemisynthError, MisconfigurationException, OSError) as error:
            raise click.UsageError(str(error)) from error


@click.command(cls=Command, context_settings=CONTEXT)
@click.option("--network", default="stereo_network:StereoNetwork", help="module:callable that returns the network.")
@click.option("--argument", "arguments", multiple=True, help="name=value of its arguments, in YAML. May be repeated.")
@click.option("--levels", type=click.Choice(list(LEVELS)), default="unit", help="[0, 1], [0, 255] or ImageNet's.")
@click.option("--pretrained", type=_FILE, help="Checkpoint or file of torch.save with initial weights.")
@click.option("--data", "sources", multiple=True, default=(str(CONFIG),), help="CONFIG|DIR[=SHARE]. May be repeated.")
@click.option("--augment", default="semisynth", help=f"{', '.join(PRESETS)}, or a YAML file with keys of Augmentation.")
@click.option("--loss", type=click.Choice(LOSSES), default="cross-entropy", help="cross-entropy needs scores.")
@click.option("--steps", type=click.IntRange(1), default=800, help="Number of batches.")
@click.option("--crop", type=click.IntRange(16), nargs=2, default=(160, 320), help="Height and width, px.")
@click.option("--batch", type=click.IntRange(1), default=2, help="Crops per step and device.")
@click.option("--max-disparity", type=click.IntRange(16), default=80, help="The loss ignores larger disparities, px.")
@click.option("--learning-rate", type=click.FloatRange(0), default=2e-3, help="Maximum learning rate.")
@click.option("--precision", type=click.Choice(["32-true", "bf16-mixed", "16-mixed"]), default="32-true")
@click.option("--devices", type=click.IntRange(1), default=1, help="Number of GPUs, or of processes on a CPU.")
@click.option("--workers", type=click.IntRange(0), default=1, help="Processes per device that read or render pairs.")
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, help="Seed of pairs, crops, changes and weights.")
@click.option("--evaluate", "folders", type=_FILE, multiple=True, help="Real scenes, or a dataset. May be repeated.")
@click.option("--every", type=click.IntRange(1), default=200, help="Steps between checkpoints and evaluations.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("out/network"), help="Folder of the results.")
@click.option("--resume", is_flag=True, help="Continue from the checkpoint in --out, with the same options.")
def main(
    *,
    sources: Sequence[str],
    folders: Sequence[Path],
    pretrained: Path | None,
    out: Path,
    resume: bool,
    **options: Any,  # noqa: ANN401
) -> None:
    """Train a stereo network, and evaluate it on real pairs before, during and after training."""
    given = SimpleNamespace(**options)
    path = out / "checkpoint.ckpt"
    if path.exists() != resume:
        raise InputError(f"{path}: {'expected with --resume' if resume else 'exists: add --resume, or change --out'}")
    judged = [motorcycle(), *map(folder, folders)]
    changes = {"crop": given.crop, "augmentation": read_augmentation(given.augment), "transform": needed}
    pairs = given.steps * given.batch * given.devices
    parts = [open_source(source, pairs, given.seed, changes) for source in sources]
    lightning.seed_everything(given.seed)
    module = StereoModule(**options)
    if pretrained is not None:
        load_weights(module.network, pretrained)
    warnings.filterwarnings("ignore", "You're resuming")  # within an epoch, which TrainingOrder supports
    trainer = lightning.Trainer(
        logger=TensorBoardLogger(out, name="logs"),
        callbacks=[ModelCheckpoint(out, path.stem, every_n_train_steps=given.every, enable_version_counter=False)],
        max_steps=given.steps,
        val_check_interval=given.every,
        check_val_every_n_epoch=None,
        devices=given.devices,
        strategy="ddp_find_unused_parameters_true" if given.devices > 1 else "auto",
        use_distributed_sampler=False,
        precision=given.precision,
        gradient_clip_val=1.0,
        num_sanity_val_steps=0,
        log_every_n_steps=10,
    )
    mix, order = ConcatDataset([part for part, _ in parts]), TrainingOrder(parts, given.batch, given.seed, trainer)
    lasting = {"multiprocessing_context": "spawn", "persistent_workers": True} if given.workers else {}
    loader = DataLoader(mix, given.batch, sampler=order, num_workers=given.workers, **lasting)
    real = [DataLoader(pairs, batch_size=None) for pairs in judged]
    if not resume:
        trainer.validate(module, real, verbose=False)
    trainer.fit(module, loader, real, ckpt_path=path if resume else None, weights_only=True)
    if given.steps % given.every:
        trainer.validate(module, real, verbose=False)
    trainer.save_checkpoint(path, weights_only=False)
    if trainer.is_global_zero:
        click.echo(f"weights are in {path}; for curves and pictures: tensorboard --logdir {out}")


if __name__ == "__main__":
    main()
