"""The content of a model's file as it is read, before it becomes a mesh."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


class BrokenModelError(Exception):
    """A model is unusable; the message is a clause about the file, such as ``"has no triangles"``."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A triangle mesh as its file has it.

    Attributes:
        vertices: (V, 3) float64, not necessarily finite.
        triangles: (T, 3) int64, indices of vertices, not necessarily in range.
        uv: (V, 2) float64 with v upwards, not necessarily finite; None where the file has no UV map.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]
    uv: NDArray[np.float64] | None


@dataclass(frozen=True, slots=True, eq=False)
class PlacedParts:
    """The parts of a model, each placed by one or more of N nodes.

    Attributes:
        parts: the parts, each once.
        placed: (N,) int64, the index of the part that each node places.
        scene_from_part: (N, 4, 4) float64, each node's transform from its part's frame to the scene's, for column
            vectors.
    """

    parts: tuple[Part, ...]
    placed: NDArray[np.int64]
    scene_from_part: NDArray[np.float64]
