"""A training that can be killed at any time and goes on exactly where its last checkpoint was.

Three things make it exact: the checkpoint has everything that steps change; each step seeds PyTorch's generators anew,
by its own number; and batch n is made of the same samples whenever, and by whomever, it is asked for.
"""

import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from math import isfinite
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch
from network_losses import LOSSES
from torch import Tensor, distributed, nn
from torch.nn.parallel import DistributedDataParallel

from semisynth_gl.inputs.errors import InputError, SemisynthError

PRECISIONS: Mapping[str, torch.dtype] = {
    "float32": torch.float32, "bfloat16": torch.bfloat16, "float16": torch.float16,
}  # fmt: skip
LEVELS: Mapping[str, Callable[[Tensor], Tensor]] = {
    "unit": lambda images: images / 255,
    "byte": lambda images: images,
    "imagenet": lambda images: (images / 255 - _per_channel(_MEAN, images)) / _per_channel(_DEVIATION, images),
}
"""What networks take images as: in [0, 1], in [0, 255], or normalised by ImageNet's mean and deviation."""
_MEAN, _DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
_RISING = 0.05
"""Share of the steps in which the learning rate rises."""
_WEIGHT_DECAY = 1e-4
_LARGEST_GRADIENT = 1.0
_WRAPPED = "module."

Batch = Mapping[str, Tensor]


@dataclass(frozen=True, slots=True)
class Plan:
    """What decides a training, beside its network and its data.

    Attributes:
        steps: batches to learn from.
        loss: a name of `LOSSES`.
        levels: a name of `LEVELS`.
        max_disparity_px: pixels at or above it are left out.
        learning_rate: at its highest.
        precision: a name of `PRECISIONS`, of convolutions and products.
        fixed_norms: whether batch normalisation keeps its running means, as for small batches and tuned weights.
        seed: of everything that is random.
    """

    steps: int
    loss: str
    levels: str
    max_disparity_px: int
    learning_rate: float
    precision: str
    fixed_norms: bool
    seed: int


def start_process(device: str) -> tuple[torch.device, int, int]:
    """Join the other processes where torchrun started this one.

    Args:
        device: auto, cpu or cuda.

    Returns:
        The device of this process, its number and the number of all.

    Raises:
        InputError: where PyTorch has no CUDA here.
    """
    if device == "cuda" and not torch.cuda.is_available():
        raise InputError("--device cuda: PyTorch finds no CUDA here; give --device cpu, or auto for what there is")
    cuda = device == "cuda" or (device == "auto" and torch.cuda.is_available())
    if "LOCAL_RANK" not in os.environ:
        return torch.device("cuda" if cuda else "cpu"), 0, 1
    own = torch.device("cuda", int(os.environ["LOCAL_RANK"])) if cuda else torch.device("cpu")
    if cuda:
        torch.cuda.set_device(own)
    distributed.init_process_group("nccl" if cuda else "gloo")
    return own, distributed.get_rank(), distributed.get_world_size()


class Training:
    """A network, what changes it, and how far it is.

    Args:
        network: on its device; takes (left, right), each (B, 3, H, W) float32, and gives what `estimates_of` takes.
        plan: the rest.
        device: the network's.
        rank: number of this process.
        identity: everything else that decides the losses, in JSON's types; a checkpoint of another one is refused.

    Attributes:
        step: how many batches it has learnt from.
        losses: of each step, of this process's batches.
        identity: with the plan's values.
    """

    def __init__(
        self, network: nn.Module, plan: Plan, device: torch.device, rank: int, identity: Mapping[str, Any]
    ) -> None:
        self.network, self.plan, self.step, self.losses = network, plan, 0, list[float]()
        self._device, self._rank, self.identity = device, rank, {**asdict(plan), **identity}
        several = distributed.is_available() and distributed.is_initialized()
        # RAFT-Stereo, for one, has parameters that take no part.
        self._learning: nn.Module = (
            DistributedDataParallel(network, find_unused_parameters=True) if several else network
        )
        learnt = [each for each in network.parameters() if each.requires_grad]
        self._optimizer = torch.optim.AdamW(learnt, lr=plan.learning_rate, weight_decay=_WEIGHT_DECAY)
        # PyTorch divides by zero where the rate is to rise for exactly one step; so few steps get one and a half.
        rising = min(max(_RISING, 1.5 / plan.steps), 0.75)
        self._schedule = torch.optim.lr_scheduler.OneCycleLR(
            self._optimizer, plan.learning_rate, total_steps=plan.steps, pct_start=rising
        )
        self._scaler = torch.amp.GradScaler(device.type, enabled=plan.precision == "float16")

    def learn(self, batch: Batch) -> float:
        """Take a step, and return its loss.

        Args:
            batch: ``left`` and ``right`` (B, 3 or 1, H, W) uint8, ``disparity_left`` (B, H, W) px.

        Raises:
            SemisynthError: where the loss is not finite.
        """
        plan, precision = self.plan, PRECISIONS[self.plan.precision]
        torch.manual_seed((plan.seed * plan.steps + self.step) * 1000 + self._rank)
        self._learning.train()
        if plan.fixed_norms:
            for module in self.network.modules():
                if isinstance(module, nn.modules.batchnorm._BatchNorm):  # noqa: SLF001 - all dimensions' common class
                    module.eval()
        views = (self._images(batch[name]) for name in ("left", "right"))
        with torch.autocast(self._device.type, precision, enabled=precision != torch.float32):
            output = self._learning(*views)
        loss = LOSSES[plan.loss](output, batch["disparity_left"].to(self._device), plan.max_disparity_px)
        found = float(loss.item())
        if not isfinite(found):
            raise SemisynthError(
                f"step {self.step + 1}: the loss is {found}, in {plan.precision}: lower --learning-rate, or train in "
                "--precision float32; the last checkpoint is from before"
            )
        self._optimizer.zero_grad()
        self._scaler.scale(loss).backward()
        self._scaler.unscale_(self._optimizer)
        nn.utils.clip_grad_norm_(self.network.parameters(), _LARGEST_GRADIENT)
        self._scaler.step(self._optimizer)
        self._scaler.update()
        self._schedule.step()
        self.step += 1
        self.losses.append(found)
        return found

    def estimate(self, left: Tensor, right: Tensor) -> Any:  # noqa: ANN401 - what the network gives
        """Ask the network, without learning, in full precision.

        Args:
            left: (B, 3 or 1, H, W), levels from 0 to 255.
            right: likewise.
        """
        self.network.eval()
        with torch.inference_mode():
            return self.network(self._images(left), self._images(right))

    def save(self, path: Path) -> None:
        """Write a checkpoint. A kill while it is written leaves the one before."""
        state = {name: part.state_dict() for name, part in self._parts().items()}
        written = path.with_suffix(".part")
        torch.save({**state, "step": self.step, "losses": self.losses, "identity": self.identity}, written)
        written.replace(path)

    def load(self, path: Path) -> None:
        """Go on where a checkpoint was written.

        Raises:
            InputError: where it cannot be read, or is from another training.
        """
        state = _read(path, self._device)
        if not {*self._parts(), "step", "losses", "identity"} <= set(state):
            raise InputError(f"--resume: {path} is no checkpoint of this program: give its weights to --pretrained")
        saved = state["identity"]
        changed = [name for name in {**saved, **self.identity} if saved.get(name) != self.identity.get(name)]
        if changed:
            raise InputError(
                f"--resume: {path} is from a training with other {', '.join(changed)}: give the options of then, or "
                "begin anew with another --out"
            )
        for name, part in self._parts().items():
            part.load_state_dict(state[name])
        self.step, self.losses = state["step"], state["losses"]

    def _parts(self) -> dict[str, Any]:
        return {
            "network": self.network,
            "optimizer": self._optimizer,
            "schedule": self._schedule,
            "scaler": self._scaler,
        }

    def _images(self, images: Tensor) -> Tensor:
        # Grey cameras have one channel.
        return LEVELS[self.plan.levels](images.to(self._device).float().expand(-1, 3, -1, -1))


def load_weights(network: nn.Module, path: Path, device: torch.device) -> None:
    """Give a network weights that were learnt before.

    Args:
        network: of which they are.
        path: a file of `torch.save`: the weights, or a dictionary with them under network, state_dict or model.
        device: of the network.

    Raises:
        InputError: where the file cannot be read, or has the weights of another network.
    """
    state = _read(path, device)
    for key in ("network", "state_dict", "model"):
        if isinstance(state.get(key), Mapping):
            state = state[key]
            break
    named = {name.removeprefix(_WRAPPED): value for name, value in state.items()}
    own = network.state_dict()
    shared = {name for name in own if name in named and named[name].shape == own[name].shape}
    if len(shared) < max(len(own), len(named)):
        [example, *_] = sorted({*own, *named} - shared)
        raise InputError(
            f"--pretrained {path}: {len(shared)} of its {len(named)} tensors fit the network's {len(own)}, and "
            f"{example} is not among them: expected the weights of this very network"
        )
    network.load_state_dict(named)


def _read(path: Path, device: torch.device) -> dict[str, Any]:
    try:
        state = torch.load(path, map_location=device, weights_only=True)
    except (OSError, RuntimeError, ValueError, EOFError, UnpicklingError) as error:
        raise InputError(f"{path}: expected tensors in a file of torch.save: {error}") from None
    if not isinstance(state, dict):
        raise InputError(f"{path}: expected a dictionary of tensors, got {type(state).__name__}")
    return state


def _per_channel(values: tuple[float, ...], like: Tensor) -> Tensor:
    return like.new_tensor(values).view(1, 3, 1, 1)
