"""MC-CNN's fast network, of the PyPI package mccnn: its training file from any pairs, and its training.

The network gives each pixel a vector of 64 numbers for the 11 x 11 pixels around it; the likeness of two pixels is the
cosine of their vectors (Zbontar and LeCun, JMLR 2016). Network, generator of patches, loss and shipped weights are the
package's; its script needs MLflow and does not import under PyTorch 2.13, so the loop over its epochs is here.
"""

import json
import random  # noqa: TID251 - what the package's generator draws from
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from itertools import islice
from pathlib import Path

import h5py
import numpy as np
import torch
from mc_cnn.dataset_generator.middlebury_generator import MiddleburyGenerator
from mc_cnn.model.mc_cnn_fast import FastMcCnn
from mc_cnn.weights import get_weights
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.utils.data import DataLoader

from semisynth_gl.augmentation import PRESETS
from semisynth_gl.frame.channels import VISIBLE
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.textures.atlas import to_grey

RADIUS = 5
"""A patch reaches as many pixels beyond its own."""
AUGMENTATION = PRESETS["semisynth"]
_MARGIN = 0.2
"""Of the loss, by the package's training."""
_REACH = RADIUS + 8
"""Columns between the match and the image's border: the generator looks for unlike patches up to 6 px beside it."""


@dataclass(frozen=True, slots=True)
class PatchBudget:
    """What all trainings of a table have alike.

    Attributes:
        steps: batches to learn from.
        batch: points in each, which come with the patch that matches and one that does not.
        pairs: of a dataset, at most.
        points: of a pair.
        exposures: changes of colour that a pair is written with.
        learning_rate: Adam's at the start; it falls to 0 as a cosine.
    """

    steps: int = 5000
    batch: int = 128
    pairs: int = 400
    points: int = 2000
    exposures: int = 3
    learning_rate: float = 1e-3


def normalised(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return what the network takes of an image (H, W, 3): grey, of mean 0 and standard deviation 1."""
    grey = to_grey(image).astype(np.float32)
    values: NDArray[np.float32] = (grey - grey.mean()) / max(float(grey.std()), 1.0)
    return values


def points_of(frame: Frame, count: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """Draw points that both views see, whose patches lie in both images: (N, 3) of row, column, disparity in px.

    N is ``count``, or less where there are fewer such points. Without a mask all points with a disparity are taken.
    """
    disparity = frame.left.disparity
    height, width = disparity.shape
    usable = np.isfinite(disparity)
    if "visibility" in frame.left:
        usable &= frame.left.visibility == VISIBLE
    columns = np.arange(width)
    with np.errstate(invalid="ignore"):
        matches = columns - disparity
        usable &= (matches >= _REACH) & (matches < width - _REACH)
    usable[:, :RADIUS] = usable[:, width - RADIUS :] = False
    usable[:RADIUS] = usable[height - RADIUS :] = False
    rows, found = np.nonzero(usable)
    chosen = rng.choice(len(rows), min(count, len(rows)), replace=False)
    # The generator cuts fractions off, and its own shift of +-0.5 px, cut off in turn, makes up for that: a rounded
    # disparity would be half a pixel off in the mean.
    return np.column_stack((rows, found, disparity[rows, found]))[chosen].astype(np.float32)


def write_training_files(pairs: Sequence[Frame], budget: PatchBudget, seed: int, folder: Path) -> None:
    """Write ``points.hdf5`` and ``images.hdf5``, which the package's generator for Middlebury reads.

    Args:
        pairs: with images (H, W, 3), left disparities, and the left mask where there is one.
        budget: of the training.
        seed: of points and colours.
        folder: is made.

    Raises:
        InputError: where a pair has no point to learn from.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    with h5py.File(folder / "points.hdf5", "w") as points, h5py.File(folder / "images.hdf5", "w") as images:
        for number, pair in enumerate(pairs):
            drawn = points_of(pair, budget.points, rng)
            if not len(drawn):
                raise InputError(f"pair {number}: expected points that both views see, {_REACH} px inside, found none")
            points[str(number)] = np.column_stack((np.full(len(drawn), number, np.float32), drawn))
            exposures = [_changed(pair, seed, number, exposure) for exposure in range(budget.exposures)]
            images[f"{number}/0"] = np.array(exposures, np.float16)


def _changed(pair: Frame, seed: int, number: int, exposure: int) -> list[NDArray[np.float32]]:
    sides = pair.camera.height_px, pair.camera.width_px
    drawn = AUGMENTATION.sample(None, sides, seed, number, exposure)
    changed, _ = drawn.applied(pair, AUGMENTATION.noise_rng(seed, number, exposure))
    return [normalised(view.image) for view in (changed.left, changed.right)]


def batches(folder: Path, budget: PatchBudget, seed: int) -> Iterator[Tensor]:
    """Yield batches (B, 3, 11, 11) of left, matching and other patches by the package's generator, without end."""
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002, TID251 - the package's generator draws from this one, too
    config = json.loads(resources.files("mc_cnn").joinpath("training_config/train_mb_fast.json").read_text())
    patches = MiddleburyGenerator(str(folder / "points.hdf5"), str(folder / "images.hdf5"), config)
    order = torch.Generator().manual_seed(seed)
    while True:
        yield from DataLoader(patches, budget.batch, shuffle=True, generator=order, drop_last=True)


def train(folder: Path, budget: PatchBudget, seed: int, tell: Callable[[str], None]) -> FastMcCnn:
    """Train a network on training files.

    Args:
        folder: of `write_training_files`.
        budget: of the training.
        seed: of weights and batches.
        tell: takes a line about how far it is.

    Raises:
        InputError: where the points do not fill a batch.
    """
    with h5py.File(folder / "points.hdf5") as file:
        points = sum(len(each) for each in file.values())
    if points < budget.batch:
        raise InputError(f"expected at least {budget.batch} points to learn from, found {points}: take more pairs")
    # Channels last: 0.8 times as long on a processor.
    network = untrained(seed).train().to(memory_format=torch.channels_last)
    optimizer = torch.optim.Adam(network.parameters(), lr=budget.learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, budget.steps)
    loss_of = nn.MarginRankingLoss(_MARGIN)
    recent = []
    for step, batch in enumerate(islice(batches(folder, budget, seed), budget.steps), 1):
        left, match, other = (each.flatten(1) for each in network(batch.float(), training=True))
        loss = loss_of((left * match).sum(1), (left * other).sum(1), torch.ones(len(batch)))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        recent.append(loss.detach())
        if step % 1000 == 0 or step == budget.steps:
            tell(f"step {step} of {budget.steps}: loss {float(torch.stack(recent[-1000:]).mean()):.4f}")
    return network.eval()


def untrained(seed: int) -> FastMcCnn:
    """Return a network with random weights."""
    torch.manual_seed(seed)
    return FastMcCnn().eval()


def shipped(learnt_from: str) -> FastMcCnn:
    """Return the network with weights of the package, learnt from ``middlebury`` or ``dfc``, which is of satellites."""
    network = FastMcCnn()
    network.load_state_dict(torch.load(get_weights("fast", learnt_from), map_location="cpu")["model"])
    return network.eval()


def features(network: FastMcCnn, image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the unit vectors (64, H, W) of an image (H, W, 3), whose border is repeated outwards."""
    padded = np.pad(normalised(image), RADIUS, mode="edge")
    found: NDArray[np.float32] = network(torch.from_numpy(padded), training=False).numpy()
    return found
