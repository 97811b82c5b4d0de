"""A training that can be killed at any time and goes on exactly where its last checkpoint was.

Three things make it exact: the checkpoint has everything that steps change; each step seeds PyTorch's generators anew,
by its number and the process's; and batch n of a process has the same samples whenever it is asked for.
"""

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import torch
from network_form import Form, read_state
from network_losses import LOSSES
from torch import Tensor, distributed, nn
from torch.nn.parallel import DistributedDataParallel

from semisynth_gl.dataset.plan import differences
from semisynth_gl.inputs.errors import InputError, SemisynthError, abbreviate

PRECISIONS: Mapping[str, torch.dtype] = {
    "float32": torch.float32, "bfloat16": torch.bfloat16, "float16": torch.float16,
}  # fmt: skip
_RISING = 0.05
"""Share of the steps in which the learning rate rises."""
_WEIGHT_DECAY = 1e-4
_LARGEST_GRADIENT = 1.0

Batch = Mapping[str, Tensor]


@dataclass(frozen=True, slots=True)
class Plan:
    """What decides a training, beside its network and its data.

    Attributes:
        steps: batches to learn from.
        loss: a name of `LOSSES`.
        learning_rate: at its highest.
        precision: a name of `PRECISIONS`, of convolutions and products.
        fixed_norms: whether batch normalisation keeps its running means, as for small batches and tuned weights.
        seed: of everything that is random.
    """

    steps: int
    loss: str
    learning_rate: float
    precision: str
    fixed_norms: bool
    seed: int


def join_processes(device: torch.device) -> tuple[int, int]:
    """Join the other processes where torchrun started this one; return its number and the number of all.

    Args:
        device: of this process.
    """
    if "LOCAL_RANK" not in os.environ:
        return 0, 1
    if device.type == "cuda":
        torch.cuda.set_device(device)
    distributed.init_process_group("nccl" if device.type == "cuda" else "gloo")
    return distributed.get_rank(), distributed.get_world_size()


class _Losing(nn.Module):
    """From a batch to its loss.

    It is one module so that DistributedDataParallel learns from the loss which parameters take no part, as RAFT-Stereo
    has some. It cannot learn it from outputs that it does not know, or that the loss leaves out.
    """

    def __init__(self, network: nn.Module, form: Form, plan: Plan, device: torch.device) -> None:
        super().__init__()
        self.network, self._form, self._plan, self._device = network, form, plan, device
        # With a parameter that takes no part, PyTorch does not warn of networks that have none.
        self.idle = nn.Parameter(torch.zeros((), device=device))

    def forward(self, left: Tensor, right: Tensor, truth: Tensor) -> Tensor:
        precision = PRECISIONS[self._plan.precision]
        images = self._form.images(left), self._form.images(right)
        with torch.autocast(self._device.type, precision, enabled=precision != torch.float32):
            output = self._form.run(self.network, *images, "give them to --crop")
        return LOSSES[self._plan.loss](output, truth, self._form.max_disparity_px)


class Training:
    """A network, what changes it, and how far it is.

    Args:
        network: on its device; takes (left, right), each (B, 3, H, W) float32, and gives what `estimates_of` takes.
        form: the network's.
        plan: the rest.
        device: the network's.
        rank: number of this process.
        identity: everything else that decides the losses, in JSON's types; a checkpoint of another one is refused.

    Attributes:
        step: how many batches it has learnt from.
        losses: of each step, of this process's batches.
        identity: with the values of form and plan.
    """

    def __init__(
        self,
        network: nn.Module,
        form: Form,
        plan: Plan,
        device: torch.device,
        rank: int,
        identity: Mapping[str, Any],
    ) -> None:
        self.network, self.form, self.plan, self.step, self.losses = network, form, plan, 0, list[float]()
        self._device, self._rank, self.identity = device, rank, {**form.values, **asdict(plan), **identity}
        several = distributed.is_available() and distributed.is_initialized()
        losing: nn.Module = _Losing(network, form, plan, device)
        self._losing = DistributedDataParallel(losing, find_unused_parameters=True) if several else losing
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
            SemisynthError: where the loss is not finite, or the network cannot learn from it.
        """
        plan = self.plan
        torch.manual_seed((plan.seed * plan.steps + self.step) * 1000 + self._rank)
        self._losing.train()
        if plan.fixed_norms:
            for module in self.network.modules():
                if isinstance(module, nn.modules.batchnorm._BatchNorm):  # noqa: SLF001 - all dimensions' common class
                    module.eval()
        loss = self._losing(*(batch[name].to(self._device) for name in ("left", "right", "disparity_left")))
        if not loss.requires_grad:
            raise InputError(
                f"network {self.form.address}: expected disparities that depend on its parameters, got some that do "
                "not: argmax, rounding, detach() and no_grad() cut them off"
            )
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
        state = read_state(path, self._device)
        if not {*self._parts(), "step", "losses", "identity"} <= set(state):
            raise InputError(f"--resume: {path} is no checkpoint of this program: give its weights to --pretrained")
        changed = differences(state["identity"], self.identity)
        if changed:
            raise InputError(
                f"--resume: {path} is from another training: {abbreviate(changed)}. Give the options, configs and "
                "photographs of then, or begin anew with another --out"
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
