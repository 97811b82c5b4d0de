"""Pairs for PyTorch, as map-style datasets: `StereoDataset` reads them from files, `StereoStream` renders them.

No other subpackage imports torch.
"""

from semisynth_gl.inputs.errors import how_to_install

try:
    import torch as _torch  # noqa: F401 - imported here for a helpful message
except ModuleNotFoundError as error:
    raise ImportError(f"semisynth_gl.torch needs PyTorch, which is not installed: {how_to_install('torch')}") from error

from semisynth_gl.augmentation.augmentation import PRESETS, Augmentation
from semisynth_gl.torch.dataset import Sample, StereoDataset
from semisynth_gl.torch.stream import StereoStream

__all__ = ["PRESETS", "Augmentation", "Sample", "StereoDataset", "StereoStream"]
