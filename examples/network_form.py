"""How a network is made, what it takes and gives, and how it predicts: all that its weights do not say."""

import importlib
import inspect
import os
import sys
import traceback
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from io import StringIO
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, Self

import numpy as np
import torch
from network_losses import estimates_of
from numpy.typing import NDArray
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from torch import Tensor, nn
from torch.nn import functional

from semisynth_gl.inputs.errors import InputError, SemisynthError, cut, described

LEVELS: Mapping[str, Callable[[Tensor], Tensor]] = {
    "unit": lambda images: images / 255,
    "byte": lambda images: images,
    "imagenet": lambda images: (images / 255 - _per_channel(_MEAN, images)) / _per_channel(_DEVIATION, images),
}
"""What networks take images as: in [0, 1], in [0, 255], or normalised by ImageNet's mean and deviation."""
_MEAN, _DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
_WRAPPED = "module."
_STATES = ("network", "state_dict", "model")
_TAKES = (
    "expected a forward(left, right) that takes images (B, 3, H, W) and gives the left disparity: a tensor (B, H, W) "
    "or (B, 1, H, W), px, or a list of estimates with the best one last"
)
_PADDED = 32
"""Networks with more levels than fit into multiples of this, px, are rare."""
LARGEST_MULTIPLE = 512
"""Images padded to multiples of more px would be padding for the most part."""


@dataclass(frozen=True, slots=True)
class Form:
    """What a network's weights do not say.

    Attributes:
        address: ``module:callable`` that returns it; the module lies here, in the current folder, or is installed.
        arguments: ``name=value`` of the callable, values in YAML.
        levels: a name of `LEVELS`.
        max_disparity_px: the end of the searched range; a callable that has ``max_disparity`` gets it.
        multiple_px: of which sides of images must be multiples.
    """

    address: str
    arguments: tuple[str, ...]
    levels: str
    max_disparity_px: int
    multiple_px: int

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        """Return the form that has these `values`."""
        return cls(**{**values, "arguments": tuple(values["arguments"])})

    @property
    def values(self) -> dict[str, Any]:
        """All values in JSON's types."""
        return {**asdict(self), "arguments": list(self.arguments)}

    def make(self) -> nn.Module:
        """Make the network, with the weights that it begins with.

        Raises:
            InputError: where there is no such callable, it fails, or it returns something else.
        """
        given = dict(argument.partition("=")[::2] for argument in self.arguments)
        told = f"--network {self.address} with --argument {' '.join(self.arguments) or 'none'}"
        try:
            values = {key: YAML(typ="safe").load(StringIO(value)) for key, value in given.items()}
        except YAMLError as error:
            raise InputError(f"{told}: expected name=value: {error}") from None
        made_by = self._find()
        if "max_disparity" in inspect.signature(made_by).parameters:
            values.setdefault("max_disparity", self.max_disparity_px)
        try:
            network = made_by(**values)
        except SemisynthError:
            raise
        except Exception as error:  # the user's own code
            raise InputError(f"{told}: {_raised(error)}") from error
        if not isinstance(network, nn.Module):
            raise InputError(f"--network {self.address}: expected a torch.nn.Module, got {type(network).__name__}")
        if not any(each.requires_grad for each in network.parameters()):
            raise InputError(f"--network {self.address}: expected parameters to learn, got a network without any")
        return network

    def _find(self) -> Callable[..., Any]:
        module, _, name = self.address.partition(":")
        if str(Path.cwd()) not in sys.path:
            sys.path.append(str(Path.cwd()))
        try:
            made_by = getattr(importlib.import_module(module), name)
        except (ImportError, AttributeError, ValueError) as error:
            raise InputError(f"--network {self.address}: expected module:callable: {error}{_place(error)}") from error
        except Exception as error:  # the user's own code
            raise InputError(f"--network {self.address}: {module} cannot be imported: {_raised(error)}") from error
        if not callable(made_by):
            raise InputError(f"--network {self.address}: expected module:callable, got {type(made_by).__name__}")
        found: Callable[..., Any] = made_by
        return found

    def images(self, images: Tensor) -> Tensor:
        """Return images as the network takes them: (B, 3, H, W) float32.

        Args:
            images: (B, 3 or 1, H, W), levels from 0 to 255; grey cameras have one channel.
        """
        return LEVELS[self.levels](images.float().expand(-1, 3, -1, -1))

    def run(self, network: nn.Module, left: Tensor, right: Tensor, remedy: str) -> Any:  # noqa: ANN401 - as estimates_of
        """Return what a network gives, which `estimates_of` takes.

        Args:
            network: of this form.
            left: (B, 3, H, W) float32, as `images` has it.
            right: likewise.
            remedy: what makes the sides multiples of what a network needs.

        Raises:
            InputError: where it fails, or gives something else than disparities of the images' size.
        """
        size = (left.shape[0], *left.shape[2:])
        told = f"network {self.address}"
        hint = ""
        if any(side % max(_PADDED, self.multiple_px) for side in size[1:]):
            hint = f"; it got images of {size[1]} x {size[2]} px: if their sides must be multiples of N, {remedy}"
        try:
            output = network(left, right)
        except SemisynthError:
            raise
        except Exception as error:  # the user's own code
            if not _place(error):
                raise InputError(f"{told}: {_raised(error)}: {_TAKES}") from error
            of_sizes = isinstance(error, (RuntimeError, ValueError, AssertionError))
            if not of_sizes or isinstance(error, torch.cuda.OutOfMemoryError):
                hint = ""
            raise InputError(f"{told}: {_raised(error)}{hint}") from error
        try:
            found = tuple(estimates_of(output)[-1].shape)
        except InputError as error:
            raise InputError(f"{told} {error}") from None
        if found != size:
            raise InputError(f"{told} gave disparities {found}: expected {size}, the images' size{hint}")
        return output

    def predict(self, network: nn.Module, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return the disparity (H, W) px of the left image, at its full size and in full precision.

        Args:
            network: of this form.
            left: (H, W, 3), or (H, W) of a grey camera.
            right: likewise.

        Raises:
            InputError: as `run`.
        """
        height, width = left.shape[:2]
        # Below and to the right, so that the padding moves no pixel.
        padding = (0, -width % self.multiple_px, 0, -height % self.multiple_px)
        device = next(network.parameters()).device
        views = []
        for image in (left, right):
            channels = image[None] if image.ndim == 2 else image.transpose(2, 0, 1)
            tensor = torch.from_numpy(np.ascontiguousarray(channels))[None].float().to(device)
            views.append(self.images(functional.pad(tensor, padding, "replicate")))
        network.eval()
        with torch.inference_mode():
            output = self.run(network, *views, "give --multiple N, such as 32, which pads them")
        found = estimates_of(output)[-1][0, :height, :width]
        disparity: NDArray[np.float32] = found.float().cpu().numpy()
        return disparity


def find_device(name: str) -> torch.device:
    """Turn auto, cpu or cuda into a device; torchrun says which of the GPUs is this process's.

    Raises:
        InputError: where PyTorch has no CUDA here.
    """
    if name == "cuda" and not torch.cuda.is_available():
        raise InputError("--device cuda: PyTorch finds no CUDA here; give --device cpu, or auto for what there is")
    if name == "cpu" or not torch.cuda.is_available():
        return torch.device("cpu")
    return torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0")))


def read_state(path: Path, device: torch.device) -> dict[str, Any]:
    """Read a dictionary that `torch.save` wrote.

    Raises:
        InputError: where it is something else.
    """
    try:
        state = torch.load(path, map_location=device, weights_only=True)
    except OSError as error:
        raise InputError(f"{path}: expected tensors in a file of torch.save: {error.strerror}") from None
    except (RuntimeError, ValueError, EOFError, UnpicklingError):
        raise InputError(f"{path}: expected tensors in a file of torch.save, got what cannot be read as one") from None
    if not isinstance(state, dict):
        raise InputError(f"{path}: expected a dictionary of tensors, got {type(state).__name__}")
    return state


def load_weights(network: nn.Module, path: Path, device: torch.device) -> None:
    """Give a network weights that were learnt before.

    Args:
        network: of which they are.
        path: a file of `torch.save`: the weights, or a dictionary with them under network, state_dict or model.
        device: of the network.

    Raises:
        InputError: where the file cannot be read, or has the weights of another network.
    """
    state = read_state(path, device)
    state = next((state[key] for key in _STATES if isinstance(state.get(key), Mapping)), state)
    named = {name.removeprefix(_WRAPPED): value for name, value in state.items()}
    own = network.state_dict()
    shared = {name for name in own if name in named and named[name].shape == own[name].shape}
    if len(shared) < max(len(own), len(named)):
        [example, *_] = sorted({*own, *named} - shared)
        raise InputError(
            f"{path}: {len(shared)} of its {len(named)} tensors fit the network's {len(own)}, and {example} is not "
            "among them: expected the weights of this very network"
        )
    network.load_state_dict(named)


def _raised(error: Exception) -> str:
    """Return what an error of the user's code says, on one line, and where it was raised."""
    return cut(" ".join(described(error).split()), 400) + _place(error)


def _place(error: Exception) -> str:
    """Return file and line of the innermost frame of other code than this and PyTorch's, in brackets; or ""."""
    inner = [Path(torch.__file__).parent, Path(importlib.__file__).parent, Path(__file__)]
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        path = Path(frame.filename)
        if path.exists() and not any(path.is_relative_to(each) for each in inner):
            return f" ({path}, line {frame.lineno})"
    return ""


def _per_channel(values: tuple[float, ...], like: Tensor) -> Tensor:
    return like.new_tensor(values).view(1, 3, 1, 1)
