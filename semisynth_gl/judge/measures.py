"""The table of measures by which the views of a dataset and of its place are compared."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.judge.measured_view import MeasuredView
from semisynth_gl.judge.quantities import (
    border_hardness,
    corner_sharpness,
    hidden,
    jumps,
    rectification_border,
)

_FLAT_LEVELS = 4.0
# Predictions and measured maps have a few values that are far off.
_LARGEST = 0.995

_OF_IMAGES = frozenset({"luminance", "gradients", "local_contrasts", "octave_contrasts"})


@dataclass(frozen=True, slots=True)
class Measure:
    """A quantity that is one number for each view.

    Attributes:
        key: the measure's name in JSON.
        name: the measure's name in tables and plots.
        of: names of the arrays of a `MeasuredView` that the number is computed from; see `MeasuredView.array`.
        unit: the unit of the number.
        value: computes the number from the arrays ``of``; returns nan where they do not determine it.
        fine: whether it depends on the finest detail, which images narrower than the working width lack.
    """

    key: str
    name: str
    of: tuple[str, ...]
    unit: str
    value: Callable[..., float]
    fine: bool = False

    @property
    def of_images(self) -> bool:
        """Whether the measure needs only an image."""
        return _OF_IMAGES.issuperset(self.of)

    @property
    def of_maps(self) -> bool:
        """Whether the measure needs no image."""
        return _OF_IMAGES.isdisjoint(self.of)

    def measure(self, view: MeasuredView) -> float | None:
        """Return the number for a view; None where the view lacks an array, or its arrays do not determine it."""
        arrays = [array for name in self.of if (array := view.array(name)) is not None]
        if (self.fine and view.enlarged) or len(arrays) < len(self.of):
            return None
        value = float(self.value(*arrays))
        return value if np.isfinite(value) else None


def _mean(values: NDArray[Any]) -> float:
    return float(values.mean()) if values.size else float("nan")


def _percent(mask: NDArray[np.bool_]) -> float:
    return 100 * _mean(mask)


def _flat(contrasts: NDArray[np.float64]) -> float:
    return _percent(contrasts < _FLAT_LEVELS)


def _weighted_by_itself(sizes: NDArray[np.int64]) -> float:
    """Return the mean over pixels of the size of the run or region that the pixel belongs to."""
    return float(np.average(sizes.astype(np.float64), weights=sizes))


def _occluded(disparity: NDArray[np.float32], _: NDArray[np.float32]) -> float:
    return 100 * float(hidden(disparity).sum() / np.isfinite(disparity).sum())


def _known(disparity: NDArray[np.float32]) -> NDArray[np.float32]:
    known: NDArray[np.float32] = disparity[np.isfinite(disparity)]
    return known


def _of_width(px: float, disparity: NDArray[np.float32]) -> float:
    return 100 * px / float(disparity.shape[1])


def _mean_disparity(disparity: NDArray[np.float32]) -> float:
    return _of_width(_mean(_known(disparity)), disparity)


def _largest_disparity(disparity: NDArray[np.float32]) -> float:
    known = _known(disparity)
    return _of_width(float(np.quantile(known, _LARGEST)), disparity) if known.size else float("nan")


def _detail(octaves: NDArray[np.float64]) -> float:
    finest, _, third, *_ = octaves.tolist()
    return finest / third if third > 0 else float("nan")


MEASURES: tuple[Measure, ...] = (
    Measure("jumps", "depth jumps above 1 px", ("surfaces",), "per 100 px", lambda each: _percent(jumps(each, 1))),
    Measure("runs", "length of smooth runs", ("run_lengths",), "px", _weighted_by_itself),
    Measure("occluded", "occluded, of known", ("disparity", "surfaces"), "%", _occluded),
    Measure("slant", "slant, mean", ("slants",), "px per px", _mean),
    Measure("disparity", "disparity, mean", ("disparity",), "% of width", _mean_disparity),
    Measure("largest_disparity", "disparity, largest", ("disparity",), "% of width", _largest_disparity),
    Measure(
        "border_hardness", "borders: step over contrast", ("luminance", "surfaces"), "ratio", border_hardness, fine=True
    ),
    Measure("flat", "local contrast below 4 levels", ("local_contrasts",), "%", _flat, fine=True),
    Measure("octaves", "contrast, finest over third octave", ("octave_contrasts",), "ratio", _detail, fine=True),
    Measure("gradient", "gradient, mean", ("gradients",), "levels per px", _mean, fine=True),
    Measure("luminance", "luminance, mean", ("luminance",), "levels", _mean),
    Measure("contrast", "luminance, deviation", ("luminance",), "levels", lambda each: float(each.std())),
    Measure("border", "black border of rectification", ("luminance",), "%", rectification_border),
    Measure("corners", "sharpness, corners over middle", ("luminance",), "ratio", corner_sharpness, fine=True),
)
"""All measures, in the order of tables; for each, keys of a config move it."""
