"""How models are stretched, each along its own axes, when they are thrown."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.config.model import ParticlesSection


def draw_scales(section: ParticlesSection, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw scales along the three axes of models, (count, 3) float64, the largest of each 1.

    Args:
        section: stretch and thinness.
        count: for how many models.
        rng: randomness.
    """
    scales = section.stretch.draw_many(rng, 3 * count).reshape(count, 3)
    scales[:, 2] *= section.thinness.draw_log(rng, count)
    scales /= scales.max(axis=1, keepdims=True)
    return scales
