"""Train a stereo network on pairs of this program, and judge it by real pairs.

    pip install lightning tensorboard torchdata
    python examples/train.py                                       # a small network; pairs rendered as it trains
    python examples/train.py --data out/rooms                      # on a dataset
    python examples/train.py --network my_module:make --loss sequence --pretrained theirs.pth
    python examples/train.py --devices 4 --precision bf16-mixed    # on four GPUs

docs/training.md has what comes out.
"""

import importlib
import inspect
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import click
import lightning
import torch
from judged_pairs import COLUMNS, folder, motorcycle, picture
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.loggers import TensorBoardLogger
from ruamel.yaml import YAML
from stereo_network import cross_entropy_loss
from torch import Tensor, nn
from torch.nn import functional
from torch.utils.data import ConcatDataset, DataLoader, WeightedRandomSampler
from torchdata.stateful_dataloader import StatefulDataLoader

from semisynth_gl.config import load_config
from semisynth_gl.inputs.errors import InputError, SemisynthError
from semisynth_gl.judge import score
from semisynth_gl.torch import PRESETS, Augmentation, Sample, StereoDataset, StereoStream

CHECKPOINT = "checkpoint"
CONFIG = Path(__file__).with_name("small-rooms.yaml")
_FILE = click.Path(path_type=Path, exists=True)
_MULTIPLE_PX = 32
"""Whole images are padded to multiples of this, px, which published networks need."""
_MEAN, _DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
LEVELS: Mapping[str, Callable[[Tensor], Tensor]] = {
    "unit": lambda images: images / 255,
    "byte": lambda images: images,
    "imagenet": lambda images: (images / 255 - _channels(_MEAN, images)) / _channels(_DEVIATION, images),
}


def _channels(values: Sequence[float], like: Tensor) -> Tensor:
    return like.new_tensor(values).view(1, 3, 1, 1)


def needed(sample: Sample) -> Sample:
    """Drop what a sample has beside what is learnt from."""
    return {name: sample[name] for name in ("left", "right", "disparity_left")}


def estimates(output: Any) -> list[Tensor]:  # noqa: ANN401 - a tensor, a list, or an object with disparities
    """Return a network's estimates of the left disparity, (B, H, W) px each, the final one last."""
    output = getattr(output, "disparities", output)
    several = [output] if isinstance(output, Tensor) else list(output)
    return [each[:, 0] if each.ndim == 4 else each for each in several]


Part = StereoDataset | StereoStream
Loss = Callable[[Any, Tensor, Tensor], Tensor]
"""From a network's output, the true disparity (B, H, W) px and the pixels that count (B, H, W) to a number."""


def _weighted(
    error: Callable[..., Tensor], several: list[Tensor], weights: list[float], truth: Tensor, valid: Tensor
) -> Tensor:
    losses = [error(each.float()[valid], truth[valid], reduction="sum") for each in several]
    sums = [weight * loss for weight, loss in zip(weights, losses, strict=True)]
    return torch.stack(sums).sum() / valid.sum().clamp(min=1)


def sequence_loss(output: Any, truth: Tensor, valid: Tensor) -> Tensor:  # noqa: ANN401 - as estimates takes it
    """Mean absolute errors of all estimates, with RAFT-Stereo's weights, which grow from estimate to estimate."""
    several = estimates(output)
    decay = 0.9 ** (15 / max(1, len(several) - 1))
    weights = [decay ** (len(several) - 1 - i) for i in range(len(several))]
    return _weighted(functional.l1_loss, several, weights, truth, valid)


def smooth_l1_loss(output: Any, truth: Tensor, valid: Tensor) -> Tensor:  # noqa: ANN401 - as estimates takes it
    """Mean smooth L1 errors of all estimates, with PSMNet's weights."""
    several = estimates(output)
    weights = [*([0.5] * len(several)), 0.7, 1.0][-len(several) :]
    return _weighted(functional.smooth_l1_loss, several, weights, truth, valid)


def scores_loss(output: Any, truth: Tensor, valid: Tensor) -> Tensor:  # noqa: ANN401 - as estimates takes it
    """`smooth_l1_loss`, and the cross-entropy of the scores of disparity levels, which teaches faster."""
    if not hasattr(output, "scores"):
        raise InputError("--loss cross-entropy: the network gives no scores: take --loss smooth-l1 or sequence")
    return smooth_l1_loss(output, truth, valid) + cross_entropy_loss(output, truth, valid)


LOSSES: Mapping[str, Loss] = {"cross-entropy": scores_loss, "smooth-l1": smooth_l1_loss, "sequence": sequence_loss}


class StereoModule(lightning.LightningModule):
    """A network with its loss, optimiser and judgement. The arguments are the options of the same names."""

    def __init__(
        self,
        network: str,
        arguments: Sequence[str],
        levels: str,
        max_disparity: int,
        loss: str = "smooth-l1",
        learning_rate: float = 2e-3,
        steps: int = 1,
        *,
        fixed_norms: bool = False,
    ) -> None:
        super().__init__()
        self.save_hyperparameters()
        self.network = _made(network, arguments, max_disparity)
        self._levels, self._loss, self._max_disparity = LEVELS[levels], LOSSES[loss], max_disparity
        self._learning_rate, self._steps, self._fixed_norms = learning_rate, steps, fixed_norms

    def train(self, mode: bool = True) -> "StereoModule":  # noqa: FBT001, FBT002 - PyTorch's signature
        """Switch between training and evaluation; fixed norms stay in evaluation."""
        super().train(mode)
        for module in self.network.modules() if self._fixed_norms else ():
            if isinstance(module, nn.modules.batchnorm._BatchNorm):  # noqa: SLF001 - all dimensions' common class
                module.eval()
        return self

    def forward(self, left: Tensor, right: Tensor) -> Any:  # noqa: ANN401 - what the network gives
        """Run the network on images (B, 3 or 1, H, W) of levels from 0 to 255."""
        return self.network(*(self._levels(each.float().expand(-1, 3, -1, -1)) for each in (left, right)))

    def predict_disparity(self, left: Tensor, right: Tensor) -> Tensor:
        """Return the left disparity (H, W), px, of whole images (3, H, W) uint8."""
        height, width = left.shape[1:]
        # Below and to the right, so that the padding moves no pixel.
        padding = (0, -width % _MULTIPLE_PX, 0, -height % _MULTIPLE_PX)
        views = [functional.pad(each[None].float(), padding, "replicate") for each in (left, right)]
        return estimates(self(*views))[-1][0, :height, :width].float()

    def transfer_batch_to_device(self, batch: dict[str, Any], device: torch.device, _: int) -> dict[str, Any]:
        """Move tensors; real pairs have more beside them."""
        return {name: each.to(device) if isinstance(each, Tensor) else each for name, each in batch.items()}

    def training_step(self, batch: Sample, _: int) -> Tensor:
        """Return the loss of a batch."""
        truth = batch["disparity_left"]
        valid = torch.isfinite(truth) & (truth > 0) & (truth < self._max_disparity)
        loss = self._loss(self(batch["left"], batch["right"]), truth, valid)
        if not torch.isfinite(loss):
            raise SemisynthError(
                f"step {self.global_step}: the loss is {loss.item()}: lower --learning-rate, or take more precision"
            )
        self.log("loss", loss, prog_bar=True)
        return loss

    def validation_step(self, pair: dict[str, Any], number: int, dataloader_idx: int = 0) -> None:
        """Log the figures of a real pair, and a picture of the first one."""
        found = self.predict_disparity(pair["left"], pair["right"]).cpu().numpy()
        figures = score(found, pair["truth"].disparity, pair["protocol"], limits=pair["truth"].limits).figures()
        for name in COLUMNS:
            self.log(f"{pair['set']}: {name}", figures[name], batch_size=1, add_dataloader_idx=False)
        if number == dataloader_idx == 0 and isinstance(self.logger, TensorBoardLogger):
            self.logger.experiment.add_figure(pair["name"], picture(pair, found), self.global_step)

    def on_validation_epoch_end(self) -> None:
        """Print the figures."""
        for name, value in self.trainer.callback_metrics.items():
            if name.endswith(": avgerr"):
                self.print(f"step {self.global_step}: {name} {value:.2f} px")

    def configure_optimizers(self) -> Any:  # noqa: ANN401 - Lightning's own choice of types
        """Return AdamW, with a learning rate that rises in the first steps and then falls."""
        optimizer = torch.optim.AdamW(self.network.parameters(), lr=self._learning_rate, weight_decay=1e-4)
        # PyTorch divides by zero where the rate is to rise for exactly one step.
        rising = min(max(0.05, 1.5 / self._steps), 0.75)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, self._learning_rate, self._steps, pct_start=rising)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


def _made(address: str, arguments: Sequence[str], max_disparity: int) -> nn.Module:
    """Call ``module:callable`` with arguments ``name=value``, values in YAML."""
    module, _, name = address.partition(":")
    if str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))
    try:
        made_by = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(f"--network {address}: expected module:callable: {error}") from error
    values = {key: YAML(typ="safe").load(value) for key, _, value in (each.partition("=") for each in arguments)}
    if "max_disparity" in inspect.signature(made_by).parameters:
        values.setdefault("max_disparity", max_disparity)
    network: nn.Module = made_by(**values)
    return network


def load_weights(module: StereoModule, path: Path) -> None:
    """Give a network weights that were learnt before, from a checkpoint of this script or a file of torch.save.

    Raises:
        InputError: where they are those of another network.
    """
    state = torch.load(path, map_location="cpu", weights_only=True)
    state = next((state[key] for key in ("state_dict", "network", "model") if key in state), state)
    named = {name.removeprefix("module.").removeprefix("network."): each for name, each in state.items()}
    try:
        module.network.load_state_dict(named)
    except RuntimeError as error:
        raise InputError(f"{path}: expected weights of this very network: {error}") from None


def read_augmentation(value: str) -> Augmentation:
    """Return a preset by its name, or the keys of a YAML file."""
    if value in PRESETS:
        return PRESETS[value]
    path = Path(value)
    if not path.is_file():
        raise InputError(f"--augment {value}: expected {', '.join(PRESETS)}, or a YAML file with keys of Augmentation")
    values = YAML(typ="safe").load(path)
    known = [each.name for each in fields(Augmentation)]
    if not isinstance(values, dict) or not set(values) <= set(known):
        raise InputError(f"{path}: expected keys among {', '.join(known)}, got {values}")
    return Augmentation(**{key: tuple(each) if isinstance(each, list) else each for key, each in values.items()})


def open_source(value: str, pairs: int, seed: int, options: dict[str, Any]) -> tuple[Part, float]:
    """Open ``CONFIG|DIR[=SHARE]`` as a stream of so many pairs, or a dataset; return it with its share."""
    name, given, share = value.rpartition("=")
    if not given:
        name, share = value, "1"
    if Path(name).is_dir():
        return StereoDataset(name, seed=seed, **options), float(share)
    return StereoStream(load_config(name), seed, pairs, checked=False, **options), float(share)


def make_loader(sources: Sequence[tuple[Part, float]], seed: int, **options: Any) -> StatefulDataLoader[Sample]:  # noqa: ANN401 - the loader's
    """Mix sources in shares. An epoch has as many samples as take no source more than once, on average."""
    total = sum(share for _, share in sources)
    weights = torch.cat([torch.full((len(part),), share / total / len(part)) for part, share in sources])
    samples = int(min(len(part) * total / share for part, share in sources))
    generator = torch.Generator().manual_seed(seed)
    sampler = WeightedRandomSampler(weights, samples, replacement=len(sources) > 1, generator=generator)
    mix = ConcatDataset([part for part, _ in sources])
    return StatefulDataLoader(mix, sampler=sampler, drop_last=True, **options)


class Epochs(lightning.Callback):
    """Gives each epoch other crops and changes."""

    def __init__(self, parts: Sequence[Part]) -> None:
        self._parts = parts

    def on_train_epoch_start(self, trainer: lightning.Trainer, _: lightning.LightningModule) -> None:
        """Tell the sources the epoch."""
        for part in self._parts:
            part.set_epoch(trainer.current_epoch)


@click.command(context_settings={"help_option_names": ["-h", "--help"], "show_default": True, "max_content_width": 100})
@click.option("--network", default="stereo_network:StereoNetwork", help="module:callable that returns the network.")
@click.option("--argument", "arguments", multiple=True, help="name=value of that callable, in YAML. May be repeated.")
@click.option(
    "--levels", type=click.Choice(list(LEVELS)), default="unit", help="Of images: [0, 1], [0, 255], ImageNet's."
)
@click.option("--pretrained", type=_FILE, help="Begin with the weights of this file of torch.save.")
@click.option("--data", "sources", multiple=True, default=(str(CONFIG),), help="CONFIG|DIR[=SHARE]. May be repeated.")
@click.option("--augment", default="semisynth", help=f"{', '.join(PRESETS)}, or a YAML file with keys of Augmentation.")
@click.option("--loss", type=click.Choice(list(LOSSES)), default="cross-entropy", help="cross-entropy needs scores.")
@click.option("--steps", type=click.IntRange(1), default=800, help="Batches to learn from.")
@click.option("--crop", type=click.IntRange(16), nargs=2, default=(160, 320), help="Height and width, px.")
@click.option("--batch", type=click.IntRange(1), default=2, help="Crops in a step of each device.")
@click.option(
    "--max-disparity", type=click.IntRange(16), default=80, help="Larger disparities are not learnt from, px."
)
@click.option("--learning-rate", type=float, default=2e-3, help="AdamW's, at its highest.")
@click.option("--precision", default="32-true", help="Lightning's: 32-true, bf16-mixed, 16-mixed.")
@click.option("--fixed-norms", is_flag=True, help="Batch normalisation keeps its running means.")
@click.option("--devices", type=click.IntRange(1), default=1, help="GPUs, or processes on a CPU.")
@click.option("--workers", type=click.IntRange(0), default=1, help="Processes that read or render, for each device.")
@click.option("--seed", type=click.IntRange(0), default=0, help="Of pairs, crops, changes and first weights.")
@click.option("--evaluate", "folders", type=_FILE, multiple=True, help="Real scenes, or a dataset. May be repeated.")
@click.option("--every", type=click.IntRange(1), default=200, help="Steps between checkpoints and judgements.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("out/network"), help="For checkpoint and logs.")
@click.option("--resume", is_flag=True, help="Go on from the checkpoint in --out.")
def main(**options: Any) -> None:  # noqa: ANN401 - as many types as options
    """Train a stereo network, and judge it by real pairs before, on the way and after."""
    try:
        run(**options)
    except SemisynthError as error:
        click.echo(f"Error: {error}", err=True)
        sys.exit(2)


def run(
    *,
    sources: tuple[str, ...],
    folders: tuple[Path, ...],
    pretrained: Path | None,
    augment: str,
    crop: tuple[int, int],
    batch: int,
    workers: int,
    devices: int,
    precision: str,
    steps: int,
    every: int,
    seed: int,
    out: Path,
    resume: bool,
    **network: Any,  # noqa: ANN401 - the module's own
) -> None:
    """Do what the options say; see ``--help``."""
    path = out / f"{CHECKPOINT}.ckpt"
    if path.exists() != resume:
        raise InputError(f"{path}: expected it {'there, with' if resume else 'not to be there, without'} --resume")
    judged = [motorcycle(), *map(folder, folders)]
    changes = {"crop": crop, "augmentation": read_augmentation(augment), "transform": needed}
    parts = [open_source(source, steps * batch * devices, seed, changes) for source in sources]
    lightning.seed_everything(seed)
    module = StereoModule(steps=steps, **network)
    if pretrained is not None:
        load_weights(module, pretrained)
    loader = {"batch_size": batch, "num_workers": workers, "persistent_workers": workers > 0}
    if workers:
        loader["multiprocessing_context"] = "spawn"
    if resume:
        epoch = torch.load(path, map_location="cpu", weights_only=True)["epoch"]
        for part, _ in parts:
            part.set_epoch(epoch)
    saved = ModelCheckpoint(out, CHECKPOINT, every_n_train_steps=every, enable_version_counter=False)
    trainer = lightning.Trainer(
        default_root_dir=out,
        logger=TensorBoardLogger(out, name="logs"),
        callbacks=[saved, Epochs([part for part, _ in parts])],
        max_steps=steps,
        val_check_interval=every,
        check_val_every_n_epoch=None,
        devices=devices,
        strategy="ddp_find_unused_parameters_true" if devices > 1 else "auto",
        precision=precision,
        gradient_clip_val=1.0,
        num_sanity_val_steps=0,
        log_every_n_steps=10,
    )
    real = [DataLoader(pairs, batch_size=None) for pairs in judged]
    if not resume:
        trainer.validate(module, real, verbose=False)
    trainer.fit(module, make_loader(parts, seed, **loader), real, ckpt_path=path if resume else None, weights_only=True)
    if steps % every:
        trainer.validate(module, real, verbose=False)
    trainer.save_checkpoint(path)
    click.echo(f"weights are in {path}; for curves and pictures: tensorboard --logdir {out}")


if __name__ == "__main__":
    main()
