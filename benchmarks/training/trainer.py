"""A training of the benchmark: crops of pairs in memory or of a stream, steps, predictions."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np
import torch
from matching_network import MatchingNetwork, matching_loss
from numpy.typing import NDArray
from real_pairs import Predictor, RealPair, shrunk_disparity, shrunk_image
from torch import Tensor, nn
from torch.utils.data import DataLoader

from semisynth_gl.augmentation import Augmentation
from semisynth_gl.config import Config
from semisynth_gl.dataset.reader import open_dataset
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.frame.channels import View
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.errors import InputError, SemisynthError
from semisynth_gl.torch import StereoStream
from semisynth_gl.torch.sample_maker import SampleMaker

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


def needed(sample: Sample) -> Sample:
    """Drop what a sample has beside what is learnt from."""
    return {name: sample[name] for name in ("left", "right", "disparity_left")}


def frame_of(left: NDArray[np.uint8], right: NDArray[np.uint8], disparity: NDArray[np.float32]) -> Frame:
    """Return a pair of images (H, W, 3) and the left disparity (H, W) px. Its camera is a stand-in that nobody asks."""
    height, width = disparity.shape
    camera = StereoCamera.centred(width, height, focal_px=width, baseline_m=0.1)
    return Frame(camera, View({"image": left, "disparity": disparity}), View({"image": right}))


def read_dataset(folder: Path, factor: int) -> list[Frame]:
    """Read a dataset of this program into memory, shrunk."""
    return [
        frame_of(
            *(shrunk_image(view.image, factor) for view in (frame.left, frame.right)),
            shrunk_disparity(frame.left.disparity, factor),
        )
        for frame in open_dataset(folder)
    ]


def frames_of(real: Mapping[str, RealPair]) -> list[Frame]:
    """Turn real pairs into what is trained on."""
    return [frame_of(pair.left, pair.right, pair.truth.disparity) for pair in real.values()]


def crops(pairs: Sequence[Frame], budget: Budget, augmentation: Augmentation, seed: int) -> Iterator[Sample]:
    """Cut batches out of pairs at random and change them, without end.

    Raises:
        InputError: where a pair is too small for a crop and its changes.
    """
    sides = [(frame.camera.height_px, frame.camera.width_px) for frame in pairs]
    makers = {size: SampleMaker(size, "a pair", budget.crop_px, augmentation, needed) for size in set(sides)}
    rng = np.random.default_rng(seed)
    for first in count(0, budget.batch):
        chosen = enumerate(rng.choice(len(pairs), budget.batch), first)
        samples = [makers[sides[pair]].make(number, number, seed, pairs[pair].cropped) for number, pair in chosen]
        yield {name: torch.stack([each[name] for each in samples]) for name in samples[0]}


def rendered(config: Config, budget: Budget, augmentation: Augmentation, seed: int, workers: int) -> Iterator[Sample]:
    """Render batches of crops while they are asked for.

    Raises:
        InputError: where the budget shrinks pairs, which a stream's crops are not.
    """
    if budget.factor != 1:
        raise InputError("pairs that are rendered while a network trains are not shrunk: expected a factor of 1")
    stream = StereoStream(
        config,
        seed,
        budget.steps * budget.batch,
        crop=budget.crop_px,
        augmentation=augmentation,
        checked=False,
        transform=needed,
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
        seed: of the weights.
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
    start, losses = time.perf_counter(), []
    for step in range(1, steps + 1):
        if time.perf_counter() > end:
            raise TimeUpError
        batch = next(batches)
        left, right = (batch[view].to(device).float() / 255 for view in ("left", "right"))
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

    def predict(pair: RealPair) -> NDArray[np.float32]:
        images = (torch.from_numpy(np.ascontiguousarray(each.transpose(2, 0, 1))) for each in (pair.left, pair.right))
        with torch.inference_mode():
            left, right = (image[None].to(hardware.device).float() / 255 for image in images)
            found: NDArray[np.float32] = network(left, right).final[0].cpu().numpy()
        return found

    return predict
