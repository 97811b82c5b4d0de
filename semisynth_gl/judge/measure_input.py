"""Resizes the luminance and disparity of views to one width, the working width; then all views are comparable."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.judge.interpolation import fill_holes
from semisynth_gl.seeds.seeds import centres
from semisynth_gl.textures.crops import LUMINANCE_PARTS

_WORKING_WIDTH = 512

DENSE = 0.5
"""Minimum share of pixels with a disparity in dense maps."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasureInput:
    """The arrays of one view at the working width.

    Attributes:
        luminance: (H, W) float32, 8-bit levels; None for a map without an image.
        disparity: (H, W) float32, px of the working width, nan where unknown; None for a photograph.
        surfaces: (H, W) float32, the disparity with its holes filled, see `fill_holes`; rows without any value are
            copies of the nearest row. None for a photograph, and for a map in which fewer than half of the pixels have
            a disparity, as from lidar.
        enlarged: whether the view was narrower than the working width, and so lacks the finest detail.
    """

    luminance: NDArray[np.float32] | None
    disparity: NDArray[np.float32] | None
    surfaces: NDArray[np.float32] | None
    enlarged: bool


def working_width(width_px: int) -> int:
    """Return the width to which images and maps are resized: 512 px, or the pairs' width if that is smaller."""
    return min(_WORKING_WIDTH, width_px)


def make_measure_input(
    width_px: int,
    image: NDArray[np.uint8] | None = None,
    disparity: NDArray[np.float32] | None = None,
    *,
    signed: bool = False,
) -> MeasureInput:
    """Resize an image, a disparity map, or both of the same size, to the working width ``width_px``.

    Images are averaged over areas. Disparities are sampled at the centres of pixels, since the mean of two surfaces
    would be a surface between them that does not exist.

    The ``image`` is (H, W, 3) uint8 RGB, or (H, W) grey; the ``disparity`` (H, W) float32, px of the width W, where inf
    and nan mean no value. So do 0 and negative disparities, unless ``signed``.
    """
    height, width = next(array.shape[:2] for array in (image, disparity) if array is not None)
    size = max(1, round(height * width_px / width)), width_px
    scaled = surfaces = None
    if disparity is not None:
        values = disparity[np.ix_(centres(height, size[0]), centres(width, width_px))]
        known = np.isfinite(values) & (signed | (values > 0))
        scaled = np.where(known, values * np.float32(width_px / width), np.float32(np.nan))
        if known.mean() >= DENSE:
            # `fill_holes` would set rows without any disparity to -1, and the jumps would be measured as edges. So copy
            # the nearest row.
            rows = np.flatnonzero(known.any(axis=1))
            surfaces = fill_holes(scaled[rows[np.abs(rows[:, None] - np.arange(size[0])).argmin(axis=0)]])
    luminance = None if image is None else mean_luminance(image, size)
    return MeasureInput(luminance, scaled, surfaces, width < width_px)


def mean_luminance(image: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.float32]:
    """Return the luminance of an image (H, W, 3) or (H, W), resized to (h, w), as float32 levels.

    Each pixel is the mean over its area. Luminance has the weights of ITU-R BT.601. Levels are not rounded, so that
    images of unchanged size are comparable with averaged images.
    """
    rows, columns = (_mean_parts(count, parts) for count, parts in zip(image.shape[:2], size, strict=True))
    # Sum channel by channel: a large image as float32 RGB would fill the memory.
    parts = enumerate(LUMINANCE_PARTS.astype(np.float32))
    luminance = image if image.ndim == 2 else sum(part * image[..., number] for number, part in parts)
    return np.asarray(rows @ (luminance @ columns.T), np.float32)


def _mean_parts(count: int, parts: int) -> NDArray[np.float32]:
    """Return the matrix (``parts``, ``count``), float32, that averages a row of values over equal intervals."""
    edges = np.linspace(0, count, parts + 1)
    element = np.arange(count)
    overlap = np.minimum(edges[1:, None], element + 1) - np.maximum(edges[:-1, None], element)
    return np.asarray(np.maximum(overlap, 0) * (parts / count), np.float32)
