"""Changes of an image's colours: brightness, contrast, saturation and hue at once, then what a camera adds."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

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

    Until the camera's part, a pixel's new colour follows from its colour alone, rounded once. Where two images differ
    by a level, strong saturation and turns of the hue may make that 5 levels.

    Attributes:
        brightness: factor of all levels.
        contrast: factor of the levels' distance from the mean luminance.
        saturation: factor of the distance from grey; 0 for a grey image.
        hue_turns: turn of the hue, as a share of the colour circle.
        white_balance: factors of red, green and blue, after all that.
        camera: blur, noise, tone curve and JPEG.
    """

    brightness: float = 1.0
    contrast: float = 1.0
    saturation: float = 1.0
    hue_turns: float = 0.0
    white_balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    camera: Imperfections = field(default_factory=Imperfections)

    def applied(self, image: NDArray[np.uint8], mean: float, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Return a changed image.

        Args:
            image: (H, W, 3) uint8, or (H, W) of a monochrome camera, which has no colours to change.
            mean: the luminance from which contrast counts, see `mean_luminance`.
            rng: source of the noise.
        """
        if replace(self, camera=Imperfections()) != Colours():
            image = self._mixed(image, mean * self.brightness)
        return apply_imperfections(image, self.camera, rng)

    def _mixed(self, image: NDArray[np.uint8], mean: float) -> NDArray[np.uint8]:
        """Apply what is linear in red, green and blue, and round once."""
        if image.ndim == 2:
            levels = np.arange(256) * self.brightness * self.contrast + (1 - self.contrast) * mean
            return through_levels(image, np.rint(levels).clip(0, 255).astype(np.uint8))
        cos, sin = np.cos(2 * np.pi * self.hue_turns), np.sin(2 * np.pi * self.hue_turns)
        turn = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])
        chroma = np.diag([1.0, self.saturation, self.saturation])
        matrix = np.linalg.solve(_YIQ, turn @ chroma @ _YIQ) * self.brightness * self.contrast
        table = np.column_stack([matrix, np.full(3, (1 - self.contrast) * mean)])
        table *= np.array(self.white_balance)[:, None]
        mixed: NDArray[np.uint8] = np.asarray(Image.fromarray(image).convert("RGB", tuple(table.ravel().tolist())))
        return mixed
