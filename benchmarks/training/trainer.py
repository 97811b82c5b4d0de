"""A training of the benchmark: crops of pairs in memory or of a stream, steps, predictions."""

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from matching_network import MatchingNetwork, matching_loss
from numpy.typing import NDArray
from real_pairs import Predictor, shrunk_disparity, shrunk_image
from torch import Tensor, nn
from torch.utils.data import DataLoader

from semisynth_gl.config import Config
from semisynth_gl.dataset.reader import open_dataset
from semisynth_gl.inputs.errors import InputError, SemisynthError
from semisynth_gl.torch import Selection, StereoStream

sys.path.append(str(Path(__file__).resolve().parents[2] / "examples"))

from stereo_evaluation import View
from train_stereo import needed, photographed

Sample = dict[str, Tensor]
_LEARNING_RATE = 3e-3
_RISING = 0.1
"""Share of the steps in which the learning rate rises."""
_WEIGHT_DECAY = 1e-4
_LARGEST_GRADIENT = 1.0
STEPS_SHOWN = 100


@dataclass(frozen=True, slots=True)
class Budget:
    """What all trainings of a table have alike.

    Attributes:
        steps: batches to learn from.
        batch: crops in each.
        crop_px: height and width.
        factor: by which all pairs are shrunk.
        max_disparity_px: of shrunk pairs; the searched range.
        width: of the network, a factor of its channels.
        pairs: in each dataset; 0 for pairs that are rendered while it trains.
        minutes: for all trainings together; None for no end.
    """

    steps: int
    batch: int
    crop_px: tuple[int, int]
    factor: int
    max_disparity_px: int
    width: int
    pairs: int
    minutes: float | None


class TimeUpError(Exception):
    """A training that has no time left."""


@dataclass(frozen=True, slots=True)
class Hardware:
    """Where a training runs.

    Attributes:
        device: of the network.
        precision: of its convolutions and products.
    """

    device: torch.device
    precision: torch.dtype


def find_precision(device: torch.device) -> torch.dtype:
    """Return bfloat16 where it is fast: on GPUs, and on processors with units for it."""
    if device.type == "cpu" and not torch.cpu.get_capabilities().get("amx_bf16", False):
        return torch.float32
    return torch.bfloat16


def tensors(view: View) -> Sample:
    """Turn a pair into what is trained on: (3, H, W) uint8 twice, and the left disparity (H, W) px."""
    left, right = (torch.from_numpy(np.ascontiguousarray(each.transpose(2, 0, 1))) for each in (view.left, view.right))
    return {"left": left, "right": right, "disparity_left": torch.from_numpy(view.truth.disparity)}


def read_dataset(folder: Path, factor: int) -> list[Sample]:
    """Read a dataset of this program into memory, shrunk."""
    samples = []
    for frame in open_dataset(folder):
        images = [shrunk_image(view.image, factor).transpose(2, 0, 1) for view in (frame.left, frame.right)]
        arrays = (*images, shrunk_disparity(frame.left.disparity, factor))
        names = ("left", "right", "disparity_left")
        samples.append({name: torch.from_numpy(array.copy()) for name, array in zip(names, arrays, strict=True)})
    return samples


def crops(pairs: Sequence[Sample], budget: Budget, seed: int) -> Iterator[Sample]:
    """Cut batches out of pairs at random, without end.

    Raises:
        InputError: where a pair is smaller than a crop.
    """
    height, width = budget.crop_px
    for pair in pairs:
        size = pair["disparity_left"].shape
        if size[0] < height or size[1] < width:
            raise InputError(f"a pair has {size[1]} x {size[0]} px: expected at least {width} x {height}, a crop")
    rng = np.random.default_rng(seed)
    while True:
        drawn = []
        for pair in rng.choice(len(pairs), budget.batch):
            sample = pairs[pair]
            rows, columns = sample["disparity_left"].shape
            y, x = rng.integers(rows - height + 1), rng.integers(columns - width + 1)
            drawn.append({name: each[..., y : y + height, x : x + width] for name, each in sample.items()})
        yield {name: torch.stack([each[name] for each in drawn]) for name in drawn[0]}


def rendered(config: Config, budget: Budget, seed: int, workers: int) -> Iterator[Sample]:
    """Render batches of crops while they are asked for.

    Raises:
        InputError: where the budget shrinks pairs, which a stream's crops are not.
    """
    if budget.factor != 1:
        raise InputError("pairs that are rendered while a network trains are not shrunk: expected a factor of 1")
    selection = Selection(pairs=budget.steps * budget.batch)
    stream = StereoStream(
        config, seed, selection, batch_size=budget.batch, crop=budget.crop_px, checked=False, transform=needed
    )
    # Forked workers have no OpenGL once this process has used CUDA.
    context = "spawn" if workers else None
    loader: Iterable[Sample] = DataLoader(
        stream, batch_size=budget.batch, num_workers=workers, multiprocessing_context=context
    )
    return iter(loader)


def train(
    batches: Iterator[Sample],
    budget: Budget,
    hardware: Hardware,
    seed: int,
    *,
    end: float = np.inf,
    tell: Callable[[str], None] = print,
) -> MatchingNetwork:
    """Train a network.

    Args:
        batches: at least ``budget.steps`` of them.
        budget: of the training.
        hardware: where.
        seed: of weights and of changes of colour.
        end: when to give up, by `time.perf_counter`.
        tell: takes a line about how far it is.

    Raises:
        TimeUpError: at the end.
        SemisynthError: where the loss is no longer finite, as bfloat16 has it on some processors.
    """
    torch.manual_seed(seed)
    device, steps = hardware.device, budget.steps
    network = MatchingNetwork(budget.max_disparity_px, budget.width).to(device).train()
    optimizer = torch.optim.AdamW(network.parameters(), lr=_LEARNING_RATE, weight_decay=_WEIGHT_DECAY, fused=True)
    # PyTorch divides by zero where the rate is to rise for exactly one step; so few steps get one and a half.
    rising = min(max(_RISING, 1.5 / steps), 0.75)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, _LEARNING_RATE, total_steps=steps, pct_start=rising)
    generator = torch.Generator().manual_seed(seed)
    start, losses = time.perf_counter(), []
    for step in range(1, steps + 1):
        if time.perf_counter() > end:
            raise TimeUpError
        batch = next(batches)
        left, right = (photographed(batch[view].to(device), generator) for view in ("left", "right"))
        with torch.autocast(device.type, hardware.precision, enabled=hardware.precision != torch.float32):
            matched = network(left, right)
        loss = matching_loss(matched, batch["disparity_left"].to(device), budget.max_disparity_px)
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), _LARGEST_GRADIENT)
        optimizer.step()
        schedule.step()
        losses.append(loss.detach())
        if step % STEPS_SHOWN == 0 or step == steps:
            recent = float(torch.stack(losses[-STEPS_SHOWN:]).mean())
            if not np.isfinite(recent):
                precision = str(hardware.precision).removeprefix("torch.")
                raise SemisynthError(f"the loss is {recent} at step {step}, in {precision}: train in float32")
            tell(f"step {step} of {steps}: loss {recent:.2f}, {(time.perf_counter() - start) / step:.3f} s a step")
    return network


def predictor(network: MatchingNetwork, hardware: Hardware) -> Predictor:
    """Return what predicts with a network, in full precision."""
    network.eval()

    def predict(view: View) -> NDArray[np.float32]:
        sample = tensors(view)
        with torch.inference_mode():
            left, right = (sample[name][None].to(hardware.device).float() / 255 for name in ("left", "right"))
            found: NDArray[np.float32] = network(left, right).final[0].cpu().numpy()
        return found

    return predict


def of_views(views: Mapping[str, View]) -> list[Sample]:
    """Turn real pairs into what is trained on."""
    return [tensors(view) for view in views.values()]
