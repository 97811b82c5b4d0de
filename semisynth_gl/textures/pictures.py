"""Drawn pictures, which are held in memory: patches are cut from them as from photographs."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.inputs.errors import InputError
from semisynth_gl.textures.images import read_image


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A picture that was drawn.

    Attributes:
        name: its name in the dataset, such as ``drawn/tartan``; unique among the pictures of a source.
        pixels: (H, W, 3) uint8 RGB, top row first; a picture smaller than a patch gives no patches.

    Raises:
        InputError: where the pixels have another shape or type.
    """

    name: str
    pixels: NDArray[np.uint8]

    def __post_init__(self) -> None:
        given: Any = self.pixels
        if not isinstance(given, np.ndarray) or given.dtype != np.uint8 or given.shape[2:] != (3,):
            what = f"{given.shape} {given.dtype}" if isinstance(given, np.ndarray) else type(given).__name__
            raise InputError(f"picture {self.name!r}: expected an array (H, W, 3) of uint8, got {what}")


TextureImage = Path | Picture
"""An image that patches are cut from: a file, or a picture in memory."""


def pixels_of(image: TextureImage) -> NDArray[np.uint8]:
    """Return the pixels of an image, (H, W, 3) uint8 RGB; a file is read by `read_image`, with the same errors."""
    return image.pixels if isinstance(image, Picture) else read_image(image)
