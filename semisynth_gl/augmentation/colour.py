"""Changes of an image's colours: brightness, contrast, saturation and hue at once, then what a camera adds."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageStat

from semisynth_gl.frame.frame import through_levels
from semisynth_gl.pairs.imperfections import LUMINANCE, Imperfections, apply_imperfections

# The axes of YIQ, from NTSC.
_YIQ = np.array([LUMINANCE, [0.5959, -0.2746, -0.3213], [0.2115, -0.5227, 0.3112]])


def mean_luminance(images: Sequence[NDArray[np.uint8]]) -> float:
    """Return the mean luminance of images (H, W, 3) or (H, W) of one size, in levels."""
    means = [np.array(ImageStat.Stat(Image.fromarray(image)).mean) for image in images]
    return float(np.mean([mean @ LUMINANCE if len(mean) == 3 else mean[0] for mean in means]))


@dataclass(frozen=True, slots=True)
class Colours:
    """Changes of one image. The default leaves it as it is.

    Brightness to white balance change a pixel's colour at once, rounded once; the rest is a camera's, see
    `Imperfections`. Where two images differ by a level, strong saturation and turns of the hue may make that 5 levels.

    Attributes:
        brightness: factor of all levels.
        contrast: factor of the levels' distance from the mean luminance.
        saturation: factor of the distance from grey; 0 for a grey image.
        hue_turns: turn of the hue, as a share of the colour circle.
        white_balance: factors of red, green and blue, after all that.
        gamma: exponent of the tone curve.
        blur_px: standard deviation of a blur, px.
        noise: standard deviation of the noise, levels.
    """

    brightness: float = 1.0
    contrast: float = 1.0
    saturation: float = 1.0
    hue_turns: float = 0.0
    white_balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    gamma: float = 1.0
    blur_px: float = 0.0
    noise: float = 0.0

    def applied(self, image: NDArray[np.uint8], mean: float, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Return a changed image.

        Args:
            image: (H, W, 3) uint8, or (H, W) of a monochrome camera, which has no colours to change.
            mean: the luminance from which contrast counts, see `mean_luminance`.
            rng: source of the noise.
        """
        if self == Colours():
            return image
        camera = Imperfections(blur_px=self.blur_px, noise=self.noise, gamma=self.gamma)
        factor, offset = self.brightness * self.contrast, (1 - self.contrast) * mean * self.brightness
        if image.ndim == 2:
            levels = np.rint(np.arange(256) * factor + offset).clip(0, 255).astype(np.uint8)
            return apply_imperfections(through_levels(image, levels), camera, rng)
        cos, sin = np.cos(2 * np.pi * self.hue_turns), np.sin(2 * np.pi * self.hue_turns)
        mixing = np.eye(3)
        mixing[1:, 1:] = self.saturation * np.array([[cos, -sin], [sin, cos]])
        table = np.column_stack([np.linalg.solve(_YIQ, mixing @ _YIQ) * factor, np.full(3, offset)])
        table *= np.array(self.white_balance)[:, None]
        mixed = np.asarray(Image.fromarray(image).convert("RGB", tuple(table.ravel().tolist())))
        return apply_imperfections(mixed, camera, rng)
