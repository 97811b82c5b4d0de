"""Quantities measured in a picture, pixel by pixel: jumps, runs, slants, contrasts.

Below, ``surfaces`` is (H, W) float32 px without holes, as in a `MeasuredView`, and ``luminance`` is (H, W) float32
8-bit levels.
"""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.textures.borders import border_share, inside_borders

JUMP_PX = 1.0
"""Larger differences between the disparities of neighbours are jumps: two surfaces, or one surface seen edge-on."""
HIGH_JUMP_PX = 2.0
"""Larger jumps count as the border of an object."""
SLANT_SPAN_PX = 16
"""Distance over which the slant of a surface is measured: in maps that are rounded to 1/2 px, 1 px is too short."""

_CONTRAST_SIDE = 9
_OCTAVES = 5
# Columns on each side of a border: the first two may be mixed from both surfaces, the next three tell their levels.
_MIXED, _PLAIN = 2, 3
_LEAST_CONTRAST = 10.0
_FEWEST_BORDERS = 20

Mask = NDArray[np.bool_]

_Value = TypeVar("_Value", bound=np.generic)

Values = NDArray[np.float32] | NDArray[np.float64]


def jumps(surfaces: NDArray[np.float32], axis: int, least_px: float = JUMP_PX) -> Mask:
    """Return where two neighbours in a column (axis 0) or in a row (axis 1) differ by more than ``least_px``.

    The result is (H - 1, W) or (H, W - 1) bool.
    """
    return np.abs(np.diff(surfaces, axis=axis)) > least_px


def run_lengths(surfaces: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return the length of each smooth run, (R,) px.

    A run is the pixels of a row between two jumps, or between a jump and the image's border.
    """
    height, width = surfaces.shape
    ends = np.ones((height, width), np.bool_)
    ends[:, :-1] = jumps(surfaces, 1)
    return np.diff(np.flatnonzero(ends), prepend=-1)


def hidden(disparity: NDArray[np.float32]) -> Mask:
    """Return the pixels of a left view that the right view cannot show, (H, W) bool, by the left disparity.

    A pixel is hidden where a nearer pixel has the same place in the right view, or where that place is outside the
    image. Pairs with a mask are judged in the same way, so that both sides of a comparison have one definition.

    Args:
        disparity: (H, W) float32 px; pixels with nan are not hidden.
    """
    height, width = disparity.shape
    known = np.isfinite(disparity)
    place = np.arange(width) - np.where(known, disparity, 0)
    outside: Mask = known & ((place < -0.5) | (place >= width - 0.5))
    inside = known & ~outside
    column = np.clip(np.rint(place), 0, width - 1).astype(np.int64)
    # The nearest surface in each pixel of the right view. A surface that faces to the left has gaps of one pixel there.
    nearest = np.full((height, width + 2), float(disparity[inside].min(initial=0.0)), np.float32)
    at = (column + (np.arange(height) * (width + 2) + 1)[:, None])[inside]
    np.maximum.at(nearest.reshape(-1), at, disparity[inside])
    closed = np.maximum(nearest[:, 1:-1], np.minimum(nearest[:, :-2], nearest[:, 2:]))
    return outside | (inside & (np.take_along_axis(closed, column, axis=1) > disparity + JUMP_PX))


def slants(surfaces: NDArray[np.float32]) -> Values:
    """Return the slant of surfaces, (N,) px per px: the length of the gradient of disparity, over `SLANT_SPAN_PX`.

    It is measured at all pixels around which neither row nor column has a jump within that span.
    """
    span, half = SLANT_SPAN_PX, SLANT_SPAN_PX // 2
    height, width = surfaces.shape
    if min(height, width) <= span:
        return np.zeros(0)
    along = []
    for axis in (0, 1):
        passed = np.zeros(surfaces.shape, np.int32)
        _shifted(passed, axis, 1)[1][:] = np.cumsum(jumps(surfaces, axis), axis=axis)
        begin, end = _shifted(surfaces, axis, span)
        jumps_before, jumps_after = _shifted(passed, axis, span)
        slope = np.where(jumps_before == jumps_after, (end - begin) / span, np.nan)
        along.append(slope[:, half : width - half] if axis == 0 else slope[half : height - half])
    lengths = np.hypot(*along)
    return lengths[np.isfinite(lengths)]


def gradients(luminance: NDArray[np.float32]) -> Values:
    """Return the length of the luminance's gradient between neighbouring pixels, levels per px, (H - 1, W - 1)."""
    return np.hypot(np.diff(luminance, axis=1)[1:], np.diff(luminance, axis=0)[:, 1:])


def local_contrasts(luminance: NDArray[np.float32]) -> Values:
    """Return the standard deviation in each 9 x 9 window, levels, (H - 8, W - 8); empty for smaller images."""
    side = _CONTRAST_SIDE
    if min(luminance.shape) < side:
        return np.zeros(0)
    # Without the mean, the sums of squares are small, so their difference keeps its digits.
    levels = luminance.astype(np.float64) - luminance.mean()
    mean, mean_square = (_window_sums(values, side) / side**2 for values in (levels, levels**2))
    return np.sqrt(np.maximum(mean_square - mean**2, 0))


def octave_contrasts(luminance: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the contrast of each of five octaves of detail, the finest first, (5,) levels.

    It is the root mean square deviation within blocks of 2 x 2. The first octave has blocks of pixels, and each further
    octave has blocks of the means of the previous octave's blocks. Octaves for which the image is too small are nan.
    """
    contrasts = np.full(_OCTAVES, np.nan)
    levels = luminance.astype(np.float64)
    for octave in range(_OCTAVES):
        height, width = levels.shape[0] // 2, levels.shape[1] // 2
        if min(height, width) == 0:
            break
        levels = levels[: 2 * height, : 2 * width]
        corners = [levels[row::2, column::2] for row in (0, 1) for column in (0, 1)]
        means: NDArray[np.float64] = sum(corners[1:], corners[0]) / 4
        contrasts[octave] = np.sqrt(np.mean([(corner - means) ** 2 for corner in corners]))
        levels = means
    return contrasts


def rectification_border(luminance: NDArray[np.float32]) -> float:
    """Return the share of an image that rectification left black, %."""
    return 100 * border_share(_levels(luminance))


def corner_sharpness(luminance: NDArray[np.float32]) -> float:
    """Return how sharp an image's corners are beside its middle: 1 where they are alike.

    Sharpness is the contrast of the finest octave over the third; noise in plain corners counts as sharp.
    Corners are quarters of the width and height, inside black borders; the middle is half of both.

    Returns:
        The ratio; nan where a part is too small or has no contrast.
    """
    left, top, width, height = inside_borders(_levels(luminance))
    inside = luminance[top : top + height, left : left + width]
    corners = [
        inside[rows, columns]
        for rows in (slice(0, height // 4), slice(height - height // 4, None))
        for columns in (slice(0, width // 4), slice(width - width // 4, None))
    ]
    middle = inside[height // 4 : height - height // 4, width // 4 : width - width // 4]
    sharp = []
    for parts in (corners, [middle]):
        octaves = np.array([octave_contrasts(part) for part in parts])
        finest, _, third, *_ = np.sqrt((octaves**2).mean(axis=0)).tolist()
        sharp.append(finest / third if third > 0 else float("nan"))
    return sharp[0] / sharp[1] if sharp[1] > 0 else float("nan")


def _levels(luminance: NDArray[np.float32]) -> NDArray[np.uint8]:
    # Means over a border and what lies beside it are not black.
    levels: NDArray[np.uint8] = np.clip(np.ceil(luminance), 0, 255).astype(np.uint8)
    return levels


def border_steps(luminance: NDArray[np.float32], surfaces: NDArray[np.float32]) -> tuple[Values, Values]:
    """Return the luminance's step at each border of an object, and the contrast of the border's sides.

    Both are (N,) levels. Borders are high jumps in a row with five pixels of one surface on each side. The contrast is
    the difference between the means of each side's third to fifth pixels. The step is the largest difference between
    neighbours within one pixel of the jump, since measured maps are rarely better aligned with their images. Borders
    with a contrast below 10 levels are left out.
    """
    reach = _MIXED + _PLAIN
    width = surfaces.shape[1]
    if width < 2 * reach:
        return np.zeros(0), np.zeros(0)
    any_jump = jumps(surfaces, 1)
    lonely = jumps(surfaces, 1, HIGH_JUMP_PX)[:, reach - 1 : width - reach]
    for step in (*range(1 - reach, 0), *range(1, reach)):
        lonely = lonely & ~any_jump[:, reach - 1 + step : width - reach + step]
    row, column = np.nonzero(lonely)
    levels = luminance[row[:, None], column[:, None] + np.arange(2 * reach)].astype(np.float64)
    contrast = np.abs(levels[:, :_PLAIN].mean(axis=1) - levels[:, -_PLAIN:].mean(axis=1))
    step = np.abs(np.diff(levels[:, reach - 2 : reach + 2], axis=1)).max(axis=1, initial=0)
    clear = contrast >= _LEAST_CONTRAST
    return step[clear], contrast[clear]


def border_hardness(luminance: NDArray[np.float32], surfaces: NDArray[np.float32]) -> float:
    """Return the mean step divided by the mean contrast of an image's borders; nan with fewer than 20 borders."""
    step, contrast = border_steps(luminance, surfaces)
    return float(step.sum() / contrast.sum()) if len(step) >= _FEWEST_BORDERS else float("nan")


def _shifted(values: NDArray[_Value], axis: int, step: int) -> tuple[NDArray[_Value], NDArray[_Value]]:
    """Return two views of an array: without its last, and without its first ``step`` slices along an axis."""
    along = np.moveaxis(values, axis, 0)
    return np.moveaxis(along[:-step], 0, axis), np.moveaxis(along[step:], 0, axis)


def _window_sums(values: NDArray[np.float64], side: int) -> NDArray[np.float64]:
    integral = np.zeros((values.shape[0] + 1, values.shape[1] + 1))
    np.cumsum(np.cumsum(values, axis=0), axis=1, out=integral[1:, 1:])
    sums: NDArray[np.float64] = (
        integral[side:, side:] - integral[:-side, side:] - integral[side:, :-side] + integral[:-side, :-side]
    )
    return sums
