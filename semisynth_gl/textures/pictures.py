"""Painted pictures in memory, from which patches are cut as from photographs."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.inputs.errors import InputError


@dataclass(frozen=True, slots=True, eq=False)
class PaintedPicture:
    """A painted picture, (H, W, 3) uint8 RGB, top row first, under a name such as ``drawn/tartan``.

    Names are unique within a source. Raises InputError if the pixels have a wrong shape or type.
    """

    name: str
    pixels: NDArray[np.uint8]

    def __post_init__(self) -> None:
        shape, kind = np.shape(self.pixels), getattr(self.pixels, "dtype", None)
        if len(shape) != 3 or shape[2] != 3 or kind != np.uint8:
            raise InputError(f"picture {self.name!r}: expected an array (H, W, 3) of uint8, got {shape} {kind}")
