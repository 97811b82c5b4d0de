"""Changes of pairs for training that keep the truth exact: `Augmentation`, and `PRESETS` by name.

It needs no PyTorch; `semisynth_gl.torch` applies it to samples.
"""

from semisynth_gl.augmentation.augmentation import PRESETS, Augmentation, Changes

__all__ = ["PRESETS", "Augmentation", "Changes"]
