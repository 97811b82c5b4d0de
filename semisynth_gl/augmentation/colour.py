"""Changes of an image's colours: brightness, contrast, saturation and hue at once, then what a camera adds."""

from collections.abc import Sequence
from dataclasses import dataclass, field

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

    Until the exposure rises, a pixel's new colour follows from its colour alone, rounded once. Where two images differ
    by a level, strong saturation and turns of the hue may make that 5 levels.

    Attributes:
        brightness: factor of all levels.
        contrast: factor of the levels' distance from the mean luminance.
        saturation: factor of the distance from grey; 0 for a grey image.
        hue_turns: turn of the hue, as a share of the colour circle.
        white_balance: factors of red, green and blue, after all that.
        gradient_stops: by how many stops the exposure rises from one side of the image to the other.
        gradient_rad: direction in which it rises, from the right, clockwise.
        camera: blur, noise, tone curve and JPEG.
    """

    brightness: float = 1.0
    contrast: float = 1.0
    saturation: float = 1.0
    hue_turns: float = 0.0
    white_balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    gradient_stops: float = 0.0
    gradient_rad: float = 0.0
    camera: Imperfections = field(default_factory=Imperfections)

    def applied(self, image: NDArray[np.uint8], mean: float, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Return a changed image.

        Args:
            image: (H, W, 3) uint8, or (H, W) of a monochrome camera, which has no colours to change.
            mean: the luminance from which contrast counts, see `mean_luminance`.
            rng: source of the noise.
        """
        if (self.brightness, self.contrast, self.saturation, self.hue_turns, *self.white_balance) != (
            1,
            1,
            1,
            0,
            1,
            1,
            1,
        ):
            image = self._mixed(image, mean * self.brightness)
        if self.gradient_stops:
            image = self._graded(image)
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

    def _graded(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Let the exposure rise from one side to the other."""
        height, width = image.shape[:2]
        across, down = np.linspace(-0.5, 0.5, width), np.linspace(-0.5, 0.5, height)
        ramp = across * np.cos(self.gradient_rad) + down[:, None] * np.sin(self.gradient_rad)
        gains = np.exp2(self.gradient_stops * ramp).astype(np.float32)
        values = image * (gains if image.ndim == 2 else gains[..., None])
        graded: NDArray[np.uint8] = np.rint(values).clip(0, 255).astype(np.uint8)
        return graded
