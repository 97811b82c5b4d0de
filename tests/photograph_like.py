"""Random images with the contrast of photographs."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Pixels = NDArray[np.uint8]


def noise(height: int, width: int, seed: int = 0) -> Pixels:
    """Return white noise."""
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def octaves(seed: int, height: int = 256, width: int = 256) -> Pixels:
    """Return an image with the same contrast at 1, 2, 4, ... 32 pixels."""
    rng = np.random.default_rng(seed)
    layers = [
        rng.integers(0, 43, (-(-height // n), -(-width // n), 3), dtype=np.uint8).repeat(n, 0).repeat(n, 1)
        for n in (1, 2, 4, 8, 16, 32)
    ]
    return np.sum([layer[:height, :width] for layer in layers], axis=0).astype(np.uint8)


def save(folder: Path, **images: Pixels) -> list[Path]:
    """Save each image as NAME.png in a folder, and make the folder if it is missing."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, pixels in images.items():
        Image.fromarray(pixels).save(folder / f"{name}.png")
    return [folder / f"{name}.png" for name in images]
