"""Products and lengths of vectors: bit for bit what numpy computes, without what numpy spends on small arrays."""

import numpy as np
from numpy.typing import NDArray


def cross(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cross products of vectors along the last axis, (..., 3) each."""
    a, b, c = first[..., 0], first[..., 1], first[..., 2]
    p, q, r = second[..., 0], second[..., 1], second[..., 2]
    x = b * r - c * q
    product = np.empty((*np.shape(x), 3))
    product[..., 0] = x
    product[..., 1] = c * p - a * r
    product[..., 2] = a * q - b * p
    return product


def lengths(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lengths of vectors along the last axis, (..., D)."""
    result: NDArray[np.float64] = np.sqrt(np.add.reduce(vectors * vectors, axis=-1))
    return result
