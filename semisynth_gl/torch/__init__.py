"""Pairs for PyTorch, rendered while a network trains: `StereoStream`.

Nothing else of the package imports torch.
"""

try:
    import torch as _torch  # noqa: F401 - asked for here, so that the message tells what to do
except ModuleNotFoundError as error:
    raise ImportError(
        "semisynth_gl.torch needs PyTorch, which is not installed: pip install 'semisynth-gl[torch]'"
    ) from error

from semisynth_gl.torch.stream import StereoStream

__all__ = ["StereoStream"]
