"""Pairs for PyTorch: `StereoStream` renders them, `StereoDataset` reads them from files, `StereoMix` mixes sources.

No other subpackage imports torch.
"""

from semisynth_gl.inputs.errors import how_to_install

try:
    import torch as _torch  # noqa: F401 - imported here, so that the message says what to do
except ModuleNotFoundError as error:
    raise ImportError(f"semisynth_gl.torch needs PyTorch, which is not installed: {how_to_install('torch')}") from error

from semisynth_gl.augmentation import PRESETS, Augmentation
from semisynth_gl.torch.dataset import StereoDataset
from semisynth_gl.torch.dealing import Selection, TrainingProcess
from semisynth_gl.torch.mix import StereoMix
from semisynth_gl.torch.samples import Sample, collate
from semisynth_gl.torch.stream import Hardware, StereoStream

__all__ = [
    "PRESETS",
    "Augmentation",
    "Hardware",
    "Sample",
    "Selection",
    "StereoDataset",
    "StereoMix",
    "StereoStream",
    "TrainingProcess",
    "collate",
]
