"""Imperfections of a real rig, put on the images after rendering; the truth stays what it is.

In this order: the lens blurs, the exposure scales, the sensor adds noise, the tone curve bends. All act on the 8-bit
values as they are, since photographs come without the curve that made them.
"""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFilter

from semisynth_gl.camera import EYES
from semisynth_gl.config.model import ImperfectionsSection
from semisynth_gl.frame import Frame, through_levels

# Values that are worked on at a time.
_BLOCK = 1 << 17


@dataclass(frozen=True, slots=True)
class Imperfections:
    """The imperfections of a view.

    Attributes:
        blur_px: standard deviation of the lens blur.
        exposure_stops: the image is multiplied by 2 to this power.
        noise: standard deviation of the sensor's noise, 8-bit levels.
        gamma: exponent of the tone curve on [0, 1].
    """

    blur_px: float
    exposure_stops: float
    noise: float
    gamma: float


def apply_imperfections(image: NDArray[np.uint8], drawn: Imperfections, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Put imperfections on an image, (H, W, 3) uint8; none at all returns it bit for bit."""
    if drawn == Imperfections(0.0, 0.0, 0.0, 1.0):
        return image
    if drawn.blur_px > 0:
        image = np.asarray(Image.fromarray(image).filter(ImageFilter.GaussianBlur(drawn.blur_px)))
    if drawn.noise <= 0:
        return through_levels(image, _curved(np.arange(256, dtype=np.float32), drawn).astype(np.uint8))
    result, rows = np.empty_like(image, order="C"), max(1, _BLOCK // image[0].size)
    # Block by block, so that all values stay in the cache; a generator goes on where the block before it ended.
    for first in range(0, len(image), rows):
        block = image[first : first + rows]
        noise = rng.standard_normal(block.shape, np.float32)
        noise *= np.float32(drawn.noise)
        np.copyto(result[first : first + rows], _curved(block.astype(np.float32), drawn, noise), casting="unsafe")
    return result


def _curved(
    values: NDArray[np.float32], drawn: Imperfections, noise: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """Scale, add noise and bend in place; the result has whole levels."""
    values *= np.float32(2.0**drawn.exposure_stops)
    if noise is not None:
        values += noise
    np.clip(values, 0, 255, out=values)
    if drawn.gamma != 1:
        values /= 255
        values **= np.float32(drawn.gamma)
        values *= 255
    return np.rint(values, out=values)


def with_imperfections(
    frame: Frame,
    section: ImperfectionsSection,
    rng: np.random.Generator,
    right_rng: np.random.Generator | None = None,
    left_image: NDArray[np.uint8] | None = None,
) -> tuple[Frame, dict[str, Any]]:
    """Put imperfections on both images of a frame; also return the imperfections of each eye in JSON's types.

    Args:
        frame: as it was rendered.
        section: the ranges.
        rng: of the scene, draws the left eye's, and those of the right eye that sees the scene first.
        right_rng: of the pair, draws the right eye's where another right eye has seen the scene before.
        left_image: with a ``right_rng``, the left image of another pair of the scene, which this pair has too.
    """
    ranges = (section.blur_px, section.exposure_stops, section.noise, section.gamma)
    drawn = {eye: Imperfections(*(values.draw(rng) for values in ranges)) for eye in EYES}
    if right_rng is not None:
        drawn["right"] = Imperfections(*(values.draw(right_rng) for values in ranges))
    if right_rng is None or left_image is None:
        left_image = apply_imperfections(frame.left.image, drawn["left"], rng)
    right_image = apply_imperfections(frame.right.image, drawn["right"], right_rng or rng)
    left = frame.left.with_channels({"image": left_image})
    right = frame.right.with_channels({"image": right_image})
    return Frame(frame.camera, left, right), {eye: asdict(values) for eye, values in drawn.items()}
