"""Point clouds as binary PLY, written for other programs and never read back."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

_POINT = np.dtype([("position", "<f4", 3), ("colour", "u1", 3)])
_PROPERTIES = "".join(
    f"property {kind} {name}\n"
    for kind, names in (("float", "xyz"), ("uchar", ("red", "green", "blue")))
    for name in names
)


def encode_points(points: NDArray[np.floating[Any]], colours: NDArray[np.uint8]) -> bytes:
    """Return the bytes of a little-endian PLY of points, (N, 3), stored as float32, with RGB colours, (N, 3) uint8."""
    values = np.empty(len(points), _POINT)
    values["position"], values["colour"] = points, colours
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{_PROPERTIES}end_header\n"
    return head.encode() + values.tobytes()
