"""Augmentations by name, with what they are taken from."""

from collections.abc import Mapping
from math import pi

from semisynth_gl.augmentation.augmentation import Augmentation

PRESETS: Mapping[str, Augmentation] = {
    # RAFT-Stereo's augmentor with the options of its training (--spatial_scale -0.2 0.4 --saturation_range 0 1.4), also
    # IGEV-Stereo's. Its right image moves by whole rows, and its width and height stretch by 2 ** +-0.2 each in
    # four of five samples; here all samples stretch.
    "raft-stereo": Augmentation(
        scale=(2**-0.2, 2**0.4),
        stretch=(2**-0.2, 2**0.2),
        right_y_px=(-2, 2),
        brightness=(0.6, 1.4),
        contrast=(0.6, 1.4),
        saturation=(0, 1.4),
        hue_turns=(-0.5 / pi, 0.5 / pi),
        asymmetric=0.2,
        occluded=0.5,
        rectangles=(1, 2),
        rectangle_px=(50, 100),
    ),
    # Ours, as benchmarks/training/compare_sets.py chose it: each camera has another exposure, white balance, tone
    # curve and noise. It does not scale: rendered pairs show many scales already, and scaling them taught no more.
    "semisynth": Augmentation(
        brightness=(0.8, 1.2), white_balance=(0.95, 1.05), gamma=(0.75, 1.33), noise=(0, 5), asymmetric=1.0
    ),
    # PSMNet trains on crops that are not changed.
    "psmnet": Augmentation(),
}
