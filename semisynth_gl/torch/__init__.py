"""Pairs for PyTorch, rendered while a network trains: `StereoStream`.

No other room of the package imports torch.
"""

try:
    import torch as _torch  # noqa: F401 - imported here, so that the message says what to do
except ModuleNotFoundError as error:
    raise ImportError(
        "semisynth_gl.torch needs PyTorch, which is not installed: pip install 'semisynth-gl[torch]'"
    ) from error

from semisynth_gl.torch.dealing import Selection, TrainingProcess
from semisynth_gl.torch.stream import Hardware, StereoStream

__all__ = ["Hardware", "Selection", "StereoStream", "TrainingProcess"]
