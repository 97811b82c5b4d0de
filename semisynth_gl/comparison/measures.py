"""The tables of measures and profiles by which views are compared, with their units."""

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.comparison.measured_view import MeasuredView
from semisynth_gl.comparison.quantities import (
    border_hardness,
    corner_sharpness,
    hidden,
    jumps,
    near_jumps,
    rectification_border,
)

_FLAT_LEVELS = 4.0
_SMOOTH_LEVELS = 2.0
_STEEP = 0.1
# Predictions and measured maps have a few values that are far off.
_LARGEST = 0.995

_OF_IMAGES = frozenset({"luminance", "gradients", "local_contrasts", "octave_contrasts"})


@dataclass(frozen=True, slots=True)
class _Quantity:
    """The common part of `Measure` and `Profile`: a quantity that is computed from a view.

    Attributes:
        key: the quantity's name in JSON.
        name: the quantity's name in tables and plots.
        of: names of the arrays of a `MeasuredView` that the quantity is computed from; see `MeasuredView.array`.
        fine: whether the quantity depends on the finest detail, which images narrower than the working width lack.
    """

    key: str
    name: str
    of: tuple[str, ...]
    _: KW_ONLY
    fine: bool = False

    @property
    def of_images(self) -> bool:
        """Whether the quantity needs only an image."""
        return _OF_IMAGES.issuperset(self.of)

    @property
    def of_maps(self) -> bool:
        """Whether the quantity needs no image."""
        return _OF_IMAGES.isdisjoint(self.of)

    def arrays(self, view: MeasuredView) -> list[NDArray[Any]] | None:
        """Return the arrays ``of`` the view; None where it lacks one, or was enlarged and the quantity is ``fine``."""
        arrays = [array for name in self.of if (array := view.array(name)) is not None]
        return None if (self.fine and view.enlarged) or len(arrays) < len(self.of) else arrays


@dataclass(frozen=True, slots=True)
class Measure(_Quantity):
    """A quantity that is one number for each view.

    Attributes:
        unit: the unit of the number.
        value: computes the number from the arrays ``of``; returns nan where they do not determine it.
    """

    unit: str
    value: Callable[..., float]

    def measure(self, view: MeasuredView) -> float | None:
        """Return the number for a view; None where the view lacks an array, or its arrays do not determine it."""
        arrays = self.arrays(view)
        value = float("nan") if arrays is None else float(self.value(*arrays))
        return value if np.isfinite(value) else None


@dataclass(frozen=True, slots=True)
class Profile(_Quantity):
    """A quantity that is a distribution for each view, or its contrast by octave.

    Attributes:
        label: the quantity on the axis of the bins, with its unit.
        edges: (K + 1,) float64, edges of the bins; if the first edge is above 0, the bins have equal ratios.
        values: computes (K,) values from the arrays ``of`` and the edges: the share of each bin in %, unless ``name``
            says otherwise; nan where the arrays do not determine them.
    """

    label: str
    edges: NDArray[np.float64]
    values: Callable[..., NDArray[np.float64]]

    def measure(self, view: MeasuredView) -> NDArray[np.float64] | None:
        """Return the values (K,) for a view; None where it lacks an array, or its arrays do not determine them."""
        arrays = self.arrays(view)
        values = None if arrays is None else self.values(*arrays, self.edges)
        return values if values is not None and np.isfinite(values).all() else None


def _mean(values: NDArray[Any]) -> float:
    return float(values.mean()) if values.size else float("nan")


def _percent(mask: NDArray[np.bool_]) -> float:
    return 100 * _mean(mask)


def _percent_below(bound: float) -> Callable[[NDArray[Any]], float]:
    return lambda values: _percent(values < bound)


def _weighted_by_itself(sizes: NDArray[np.int64]) -> float:
    """Return the mean over pixels of the size of the run or region that the pixel belongs to."""
    return float(np.average(sizes.astype(np.float64), weights=sizes))


def _percent_of_image(sizes: NDArray[np.int64]) -> float:
    return 100 * _weighted_by_itself(sizes) / float(sizes.sum())


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


def _finest_over_third(octaves: NDArray[np.float64]) -> float:
    finest, _, third, *_ = octaves.tolist()
    return finest / third if third > 0 else float("nan")


def _shares(
    values: NDArray[Any], edges: NDArray[np.float64], weights: NDArray[Any] | None = None
) -> NDArray[np.float64]:
    """Return the share of each bin in %; the outer bins also count the values beyond them."""
    # Values above the last edge move to it, and numpy's last bin includes its upper edge.
    counts = np.histogram(np.clip(values, edges[0], edges[-1]), edges, weights=weights)[0]
    total = counts.sum()
    return 100 * counts / total if total > 0 else np.full(len(counts), np.nan)


MEASURES: tuple[Measure, ...] = (
    Measure(
        "jumps", "depth jumps above 1 px", ("surfaces",), "per 100 px", lambda surfaces: _percent(jumps(surfaces, 1))
    ),
    Measure("runs", "length of smooth runs", ("run_lengths",), "px", _weighted_by_itself),
    Measure(
        "near_jumps", "near a jump above 2 px", ("surfaces",), "%", lambda surfaces: _percent(near_jumps(surfaces))
    ),
    Measure("occluded", "occluded, of known", ("disparity", "surfaces"), "%", _occluded),
    Measure("regions", "size of regions", ("region_sizes",), "% of image", _percent_of_image),
    Measure("slant", "slant, mean", ("slants",), "px per px", _mean),
    Measure("steep", "slanted above 0.1 px per px", ("slants",), "%", lambda slants: _percent(slants > _STEEP)),
    Measure("disparity", "disparity, mean", ("disparity",), "% of width", _mean_disparity),
    Measure("largest_disparity", "disparity, largest", ("disparity",), "% of width", _largest_disparity),
    Measure(
        "border_hardness", "borders: step over contrast", ("luminance", "surfaces"), "ratio", border_hardness, fine=True
    ),
    Measure(
        "flat", "local contrast below 4 levels", ("local_contrasts",), "%", _percent_below(_FLAT_LEVELS), fine=True
    ),
    Measure(
        "octaves", "contrast, finest over third octave", ("octave_contrasts",), "ratio", _finest_over_third, fine=True
    ),
    Measure("gradient", "gradient, mean", ("gradients",), "levels per px", _mean, fine=True),
    Measure("smooth", "gradient below 2 levels", ("gradients",), "%", _percent_below(_SMOOTH_LEVELS), fine=True),
    Measure("luminance", "luminance, mean", ("luminance",), "levels", _mean),
    Measure("contrast", "luminance, deviation", ("luminance",), "levels", lambda luminance: float(luminance.std())),
    Measure("border", "black border of rectification", ("luminance",), "%", rectification_border),
    Measure("corners", "sharpness, corners over middle", ("luminance",), "ratio", corner_sharpness, fine=True),
    Measure("background", "background in view", ("background",), "%", _percent),
)
"""All measures, in the order of tables."""

PROFILES: tuple[Profile, ...] = (
    Profile(
        "disparity",
        "disparity, % of pixels",
        ("disparity",),
        "% of width",
        np.linspace(0, 30, 31),
        lambda disparity, edges: _shares(100 * _known(disparity) / disparity.shape[1], edges),
    ),
    Profile(
        "runs",
        "smooth runs, % of pixels",
        ("run_lengths", "surfaces"),
        "length, % of width",
        np.geomspace(0.2, 100, 28),
        lambda lengths, surfaces, edges: _shares(100 * lengths / surfaces.shape[1], edges, weights=lengths),
    ),
    Profile(
        "regions",
        "regions, % of pixels",
        ("region_sizes",),
        "size, % of image",
        np.geomspace(0.001, 100, 26),
        lambda sizes, edges: _shares(100 * sizes / sizes.sum(), edges, weights=sizes),
    ),
    Profile("slant", "slant, % of smooth pixels", ("slants",), "px per px", np.linspace(0, 0.4, 33), _shares),
    Profile("luminance", "luminance, % of pixels", ("luminance",), "levels", np.linspace(0, 256, 33), _shares),
    Profile(
        "gradient",
        "gradient, % of pixels",
        ("gradients",),
        "levels per px",
        np.geomspace(0.5, 200, 20),
        _shares,
        fine=True,
    ),
    Profile(
        "local_contrast",
        "contrast in 9 x 9, % of windows",
        ("local_contrasts",),
        "levels",
        np.geomspace(0.25, 128, 28),
        _shares,
        fine=True,
    ),
    Profile(
        "octaves",
        "contrast by octave, levels",
        ("octave_contrasts",),
        "size of detail, px",
        np.geomspace(1, 32, 6),
        lambda contrasts, _: contrasts,
        fine=True,
    ),
)
"""All profiles, in the order of plots."""
