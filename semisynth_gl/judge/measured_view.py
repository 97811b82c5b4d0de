"""A view to measure: its luminance, disparity and masks at one working width, so that views of all sizes compare."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.inputs.errors import InputError
from semisynth_gl.judge import quantities
from semisynth_gl.judge.holes import fill_rows
from semisynth_gl.seeds.spread import centres
from semisynth_gl.textures.crops import LUMINANCE_PARTS

WORKING_WIDTH = 512
"""Width to which all images and maps are brought, px; see `working_width`."""

_DENSE = 0.5
_STRIP_PIXELS = 1 << 20
# The function that computes each quantity, and the array of a view that it takes.
_QUANTITIES: Mapping[str, tuple[Callable[[NDArray[np.float32]], NDArray[Any]], str]] = {
    "run_lengths": (quantities.run_lengths, "surfaces"),
    "slants": (quantities.slants, "surfaces"),
    "gradients": (quantities.gradients, "luminance"),
    "local_contrasts": (quantities.local_contrasts, "luminance"),
    "octave_contrasts": (quantities.octave_contrasts, "luminance"),
}


@dataclass(frozen=True, eq=False)
class MeasuredView:
    """The arrays of one view at the working width.

    Attributes:
        name: for messages.
        luminance: (H, W) float32, 8-bit levels; None for a map without an image.
        disparity: (H, W) float32, px of the working width, nan where unknown; None for a photograph.
        surfaces: (H, W) float32, the disparity with its holes filled; see `fill_holes`. None for a photograph, and for
            a map in which fewer than half of the pixels have a disparity, as from lidar.
        enlarged: whether the view's arrays were narrower than the working width, so that it lacks the finest detail.
        worked_out: quantities of these arrays that have been computed, by name; see `array`.
    """

    name: str
    luminance: NDArray[np.float32] | None = None
    disparity: NDArray[np.float32] | None = None
    surfaces: NDArray[np.float32] | None = None
    enlarged: bool = False
    worked_out: dict[str, NDArray[Any] | None] = field(default_factory=dict, init=False)

    def array(self, name: str) -> NDArray[Any] | None:
        """Return the array or the quantity of this name, or None if the view lacks it.

        A quantity is computed when it is first asked for, and then kept.
        """
        if name not in _QUANTITIES:
            own: NDArray[Any] | None = getattr(self, name)
            return own
        if name not in self.worked_out:
            quantity, source = _QUANTITIES[name]
            array = getattr(self, source)
            self.worked_out[name] = None if array is None else quantity(array)
        return self.worked_out[name]

    def with_image(self, image: NDArray[np.uint8]) -> "MeasuredView":
        """Return the view with another image, (H, W, 3) uint8 RGB or (H, W) grey of any size.

        Raises:
            InputError: where the view has no image to replace.
        """
        if self.luminance is None:
            raise InputError(f"{self.name}: expected a view with an image, got one without")
        return replace(self, luminance=mean_luminance(image, self.luminance.shape))

    def exposed(self, stops: float) -> "MeasuredView":
        """Return the view with its luminance multiplied by 2 to the power of ``stops``."""
        factor = np.float32(2.0**stops)
        exposed = replace(self, luminance=None if self.luminance is None else self.luminance * factor)
        for name, (_, source) in _QUANTITIES.items():
            if source == "luminance":
                levels = self.array(name)
                # These quantities are in levels, so they scale with the luminance, which is faster than computing anew.
                exposed.worked_out[name] = None if levels is None else levels * factor
        return exposed


def working_width(width_px: int) -> int:
    """Return `WORKING_WIDTH`, or the pairs' width if that is less, since enlarged images lack the finest detail."""
    return min(WORKING_WIDTH, width_px)


def make_view(
    name: str,
    width_px: int,
    *,
    image: NDArray[np.uint8] | None = None,
    disparity: NDArray[np.float32] | None = None,
    signed: bool = False,
) -> MeasuredView:
    """Bring the arrays of a view to the working width.

    Images are averaged over areas. In disparities a pixel takes the value at its centre, since the mean of two
    surfaces would be a surface between them that does not exist.

    Args:
        name: for messages.
        width_px: the working width.
        image: (H, W, 3) uint8 RGB, or (H, W) grey.
        disparity: (H, W) float32, px of its own width. inf and nan mean no value; so do 0 and below, unless
            ``signed``.
        signed: whether disparities of 0 and below are valid.

    Raises:
        InputError: where the arrays have different sizes, or no array is given.
    """
    shapes = {array.shape[:2] for array in (image, disparity) if array is not None}
    if len(shapes) != 1:
        sizes = " and ".join(sorted(f"{width} x {height}" for height, width in shapes))
        raise InputError(f"{name}: its arrays have sizes of {sizes}: expected one size")
    ((height, width),) = shapes
    size = max(1, round(height * width_px / width)), width_px
    scaled = surfaces = None
    if disparity is not None:
        values = disparity[np.ix_(centres(height, size[0]), centres(width, width_px))]
        known = np.isfinite(values) & (signed | (values > 0))
        scaled = np.where(known, values * np.float32(width_px / width), np.float32(np.nan))
        surfaces = fill_holes(scaled) if known.mean() >= _DENSE else None
    return MeasuredView(
        name,
        None if image is None else mean_luminance(image, size),
        scaled,
        surfaces,
        width < width_px,
    )


def mean_luminance(image: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.float32]:
    """Return the luminance of an image (H, W, 3) or (H, W) in another size (h, w), (h, w) float32 levels.

    Each pixel is the mean over its area. Luminance has the weights of ITU-R BT.601. Levels are not rounded, so that
    images that keep their size compare with averaged images.
    """
    height, width = image.shape[:2]
    rows = max(1, _STRIP_PIXELS // width)
    # Averaging columns first, and in strips, keeps the memory for large images small.
    parts = (image[top : top + rows] for top in range(0, height, rows))
    luminances = (part.astype(np.float64) if part.ndim == 2 else part @ LUMINANCE_PARTS for part in parts)
    strips = [_mean_along_rows(luminance, size[1]) for luminance in luminances]
    return np.ascontiguousarray(_mean_along_rows(np.concatenate(strips).T, size[0]).T, np.float32)


def fill_holes(disparity: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return a disparity (H, W) px in which each nan pixel has the smaller of the nearest values to its left and right.

    The smaller value is taken since most holes are background that only one eye sees. A row without any value becomes a
    copy of the nearest row with values; at least one row must have some.
    """
    rows = np.flatnonzero(np.isfinite(disparity).any(axis=1))
    nearest = rows[np.abs(rows[:, None] - np.arange(len(disparity))).argmin(axis=0)]
    return fill_rows(disparity[nearest])


def _mean_along_rows(values: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return (H, ``count``) float64, the means over ``count`` equal parts of each row of ``values`` (H, W)."""
    width = values.shape[1]
    if count == width:
        return values
    # The integral over a row is linear within each of its elements.
    integral = np.zeros((len(values), width + 1))
    np.cumsum(values, axis=1, out=integral[:, 1:])
    edges = np.arange(count + 1) * (width / count)
    element = np.minimum(edges.astype(np.int64), width - 1)
    at_edges = integral[:, element] + (edges - element) * values[:, element]
    means: NDArray[np.float64] = np.diff(at_edges, axis=1) * (count / width)
    return means
