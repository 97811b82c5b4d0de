"""Pictures that the program draws itself, one kind after the other."""

from collections.abc import Iterator

import numpy as np

from semisynth_gl.textures.pictures import Picture


def drawn_pictures(rng: np.random.Generator) -> Iterator[Picture]:
    """Draw one picture of each kind after the other."""
    yield Picture("drawn/confetti", rng.integers(0, 256, (1024, 1024, 3), dtype=np.uint8))
