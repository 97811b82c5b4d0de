"""Changes of an image's colours: brightness, contrast, saturation, hue, white balance, gamma, blur and noise."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageStat

from semisynth_gl.pairs.imperfections import LUMINANCE, ImageImperfections, apply_imperfections

# NTSC's axes Y, I and Q.
_YIQ = np.array([LUMINANCE, [0.5959, -0.2746, -0.3213], [0.2115, -0.5227, 0.3112]])


def mean_luminance(images: Sequence[NDArray[np.uint8]]) -> float:
    """Return the mean luminance of images (H, W, 3) or (H, W) of one size, in levels."""
    means = [np.array(ImageStat.Stat(Image.fromarray(image)).mean) for image in images]
    return float(np.mean([mean @ LUMINANCE if len(mean) == 3 else mean[0] for mean in means]))


def recoloured(
    image: NDArray[np.uint8],
    mean: float,
    rng: np.random.Generator,
    *,
    brightness: float = 1.0,
    contrast: float = 1.0,
    saturation: float = 1.0,
    hue_turns: float = 0.0,
    white_balance: tuple[float, float, float] = (1.0, 1.0, 1.0),
    gamma: float = 1.0,
    blur_px: float = 0.0,
    noise: float = 0.0,
) -> NDArray[np.uint8]:
    """Return an image, (H, W, 3) uint8 or monochrome (H, W), with changed colours; see `Augmentation`.

    Contrast scales differences from the luminance ``mean``. Brightness, contrast, saturation, hue and white balance, in
    this order, are one linear step with one rounding; `ImageImperfections` makes the other changes. Strong saturation
    and rotation of the hue may increase a difference of one level between two images to 5 levels.
    """
    factor, offset = brightness * contrast, (1 - contrast) * mean * brightness
    if image.ndim == 2:
        changed = np.rint(np.arange(256) * factor + offset).clip(0, 255).astype(np.uint8)[image]
    else:
        cos, sin = np.cos(2 * np.pi * hue_turns), np.sin(2 * np.pi * hue_turns)
        mixing = np.eye(3)
        mixing[1:, 1:] = saturation * np.array([[cos, -sin], [sin, cos]])
        table = np.column_stack([np.linalg.solve(_YIQ, mixing @ _YIQ) * factor, np.full(3, offset)])
        table *= np.array(white_balance)[:, None]
        changed = np.asarray(Image.fromarray(image).convert("RGB", tuple(table.ravel().tolist())))
    return apply_imperfections(changed, ImageImperfections(blur_px=blur_px, noise=noise, gamma=gamma), rng)
