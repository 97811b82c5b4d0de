"""Disparities from the likeness of single pixels: costs of all disparities, the least of them, or semi-global matching.

Costs (H, W, D) are float32 in [0, 1]; the last axis is the disparity in whole px from 0. Where the right image has no
such pixel, the cost is 1.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Costs = NDArray[np.float32]
_CENSUS_RADIUS = 5
_NEIGHBOURS = (2 * _CENSUS_RADIUS + 1) ** 2 - 1
_DIRECTIONS = np.array(
    [[0, 1], [1, 0], [1, 1], [1, -1], [0, -1], [-1, 0], [-1, -1], [-1, 1]], np.int32
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Penalties:
    """Costs of a disparity that differs from its neighbour's by 1 px, and by more."""

    small: float
    large: float


def learnt_costs(left: NDArray[np.float32], right: NDArray[np.float32], levels: int) -> Costs:
    """Return the costs of two images' unit vectors (C, H, W): half of 1 less their cosine."""
    _, height, width = left.shape
    costs = np.ones((height, width, levels), np.float32)
    columns, disparities = np.arange(width)[:, None], np.arange(levels)
    matches = columns - disparities
    inside = matches >= 0
    # All columns of a row against all others, of which a band is wanted: faster than the band alone without a product
    # of matrices.
    for row in range(height):
        cosines = left[:, row].T @ right[:, row]
        costs[row][inside] = ((1 - cosines[columns, np.maximum(matches, 0)]) / 2)[inside]
    return costs


def census_costs(left: NDArray[np.uint8], right: NDArray[np.uint8], levels: int) -> Costs:
    """Return the costs of two grey images (H, W) by census.

    A cost is the share of the 120 neighbours, in the 11 x 11 pixels that the network sees too, that are darker than
    the middle in one image alone (Zabih and Woodfill, ECCV 1994).
    """
    bits = [_census(image) for image in (left, right)]
    height, width = left.shape
    costs = np.ones((height, width, levels), np.float32)
    for level in range(min(levels, width)):
        unlike = np.bitwise_count(bits[0][:, level:] ^ bits[1][:, : width - level])
        costs[:, level:, level] = unlike.sum(-1) / _NEIGHBOURS
    return costs


def _census(image: NDArray[np.uint8]) -> NDArray[np.uint64]:
    padded = np.pad(image, _CENSUS_RADIUS, mode="edge")
    side = 2 * _CENSUS_RADIUS + 1
    windows = np.lib.stride_tricks.sliding_window_view(padded, (side, side)).reshape(*image.shape, side * side)
    darker = np.packbits(windows < image[..., None], axis=-1)
    return np.ascontiguousarray(darker).view(np.uint64)


def winner(costs: Costs) -> NDArray[np.float32]:
    """Return the disparity (H, W) of the least cost."""
    return costs.argmin(-1).astype(np.float32)


def smoothed(costs: Costs, penalties: Penalties) -> Costs:
    """Return the costs of semi-global matching along eight directions (Hirschmueller, CVPR 2005), by libsgm."""
    from c_libsgm import sgm_api  # noqa: PLC0415 - tests of the rest do without it

    height, width, _ = costs.shape
    small, large = (
        np.full((height, width, len(_DIRECTIONS)), value, np.float32) for value in (penalties.small, penalties.large)
    )
    whole = np.zeros((height, width), np.float32)
    summed: Costs = sgm_api(np.ascontiguousarray(costs), small, large, _DIRECTIONS, np.nan, whole)["cv"]
    return summed
