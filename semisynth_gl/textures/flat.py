"""Patches nearly without texture, made by lowering the contrast of others: photographs have few flat crops."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.textures.crops import texture_measure

# Range of the texture that is left, as a part of the limit below which a patch is flat.
_LEFT = (0.2, 0.9)


def flat_count(share: float, count: int) -> int:
    """Return how many of ``count`` patches are to be flat; with a share above 0 at least one, but never all."""
    return min(max(1, round(share * count)), count - 1) if share else 0


def lower_contrast(
    frames: NDArray[np.uint8], min_texture: float, rng: np.random.Generator
) -> tuple[NDArray[np.uint8], float, float]:
    """Lower the contrast of a patch, (F, P, P, 3) uint8 RGB, until it is flat; its mean colour stays.

    What is left of the texture is a random part of ``min_texture``, which must be above 0.

    Returns:
        The new frames, (F, P, P, 3) uint8; the part of their contrast that is left, up to rounding; and the least
        `texture_measure` of the new frames.
    """
    most = max(map(texture_measure, frames))
    contrast = min(1.0, min_texture * rng.uniform(*_LEFT) / max(most, 1e-9))
    means = frames.mean(axis=(0, 1, 2), dtype=np.float64)
    while True:
        lowered = np.empty_like(frames)
        for channel, mean in enumerate(means):
            levels = np.rint(mean + (np.arange(256) - mean) * contrast).astype(np.uint8)
            lowered[..., channel] = levels[frames[..., channel]]
        textures = [texture_measure(frame) for frame in lowered]
        # Rounding to whole levels adds a little texture.
        if max(textures) < min_texture:
            return lowered, contrast, min(textures)
        contrast /= 2
