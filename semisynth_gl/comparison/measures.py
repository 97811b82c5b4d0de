"""The tables of measures and profiles: what is compared, in which unit, and which keys of a config move it."""

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.comparison.picture import Picture
from semisynth_gl.comparison.quantities import border_hardness, hidden, jumps, near_jumps

_FLAT_LEVELS = 4.0
_SMOOTH_LEVELS = 2.0
_STEEP = 0.1
# Predictions and measured maps have a few values that are far off.
_LARGEST = 0.995

_OF_IMAGES = frozenset({"luminance", "gradients", "local_contrasts", "octave_contrasts"})

_FEWER_OBJECTS = "lower particles.density or models.complex, raise particles.size_px"
_MORE_OBJECTS = "raise particles.density or models.complex, lower particles.size_px"
_STEEPER = "raise structures.panels with structures.panel_slant_deg, lower particles.thinness"
_LESS_STEEP = "raise structures.panels, lower structures.panel_slant_deg"


@dataclass(frozen=True, slots=True)
class Measure:
    """A number that a picture has.

    Attributes:
        key: its name in JSON.
        name: its name in tables.
        unit: its unit.
        of: the arrays and properties of a `Picture` that it is computed from, by name.
        value: the number from these arrays, nan where they do not have it.
        more: what to change in a config for more of it, with the keys; "" where the measure is for information.
        less: what to change for less of it.
        fine: whether it depends on the finest detail, which images narrower than the working width lack.
    """

    key: str
    name: str
    unit: str
    of: tuple[str, ...]
    value: Callable[..., float]
    _: KW_ONLY
    more: str = ""
    less: str = ""
    fine: bool = False

    @property
    def of_images(self) -> bool:
        """Whether an image is enough for it, without a disparity map."""
        return _OF_IMAGES.issuperset(self.of)

    def measure(self, picture: Picture) -> float | None:
        """Return the number of a picture, or None where the picture does not have it."""
        arrays = None if self.fine and picture.enlarged else _arrays(picture, self.of)
        if arrays is None:
            return None
        value = float(self.value(*arrays))
        return value if np.isfinite(value) else None


@dataclass(frozen=True, slots=True)
class Profile:
    """A distribution that a picture has, or its contrast by octave.

    Attributes:
        key: its name in JSON.
        name: its name in plots.
        label: what its bins are of, with the unit.
        of: the arrays and properties of a `Picture` that it is computed from, by name.
        edges: (K + 1,) float64, edges of the bins.
        values: (K,) from these arrays and the edges: the share of each bin in %, unless `name` says otherwise; nan
            where they do not have it.
        log: whether the bins have equal ratios.
        fine: as of a `Measure`.
    """

    key: str
    name: str
    label: str
    of: tuple[str, ...]
    edges: NDArray[np.float64]
    values: Callable[..., NDArray[np.float64]]
    _: KW_ONLY
    log: bool = False
    fine: bool = False

    @property
    def of_images(self) -> bool:
        """Whether an image is enough for it, without a disparity map."""
        return _OF_IMAGES.issuperset(self.of)

    def measure(self, picture: Picture) -> NDArray[np.float64] | None:
        """Return the values of a picture, (K,), or None where the picture does not have them."""
        arrays = None if self.fine and picture.enlarged else _arrays(picture, self.of)
        if arrays is None:
            return None
        values = self.values(*arrays, self.edges)
        return values if np.isfinite(values).all() else None


def _arrays(picture: Picture, names: tuple[str, ...]) -> list[NDArray[Any]] | None:
    arrays = [getattr(picture, name) for name in names]
    return None if any(array is None for array in arrays) else arrays


def _mean(values: NDArray[Any]) -> float:
    return float(values.mean()) if values.size else float("nan")


def _percent(mask: NDArray[np.bool_]) -> float:
    return 100 * _mean(mask)


def _weighted_by_itself(sizes: NDArray[np.int64]) -> float:
    """Return the mean over pixels of the size of what each pixel is in."""
    return float(np.average(sizes.astype(np.float64), weights=sizes))


def _known(disparity: NDArray[np.float32]) -> NDArray[np.float32]:
    known: NDArray[np.float32] = disparity[np.isfinite(disparity)]
    return known


def _of_width(px: float, disparity: NDArray[np.float32]) -> float:
    return 100 * px / float(disparity.shape[1])


def _largest(disparity: NDArray[np.float32]) -> float:
    known = _known(disparity)
    return _of_width(float(np.quantile(known, _LARGEST)), disparity) if known.size else float("nan")


def _finest_over_third(octaves: NDArray[np.float64]) -> float:
    finest, _, third, *_ = octaves.tolist()
    return finest / third if third > 0 else float("nan")


def _shares(
    values: NDArray[Any], edges: NDArray[np.float64], weights: NDArray[Any] | None = None
) -> NDArray[np.float64]:
    """Return the share of each bin in %; the outer bins count what lies beyond them."""
    # A shade below the last edge, which is a part of the last bin anyway.
    counts = np.histogram(np.clip(values, edges[0], edges[-1]), edges, weights=weights)[0]
    total = counts.sum()
    return 100 * counts / total if total > 0 else np.full(len(counts), np.nan)


MEASURES: tuple[Measure, ...] = (
    Measure(
        "jumps",
        "depth jumps above 1 px",
        "per 100 px",
        ("surfaces",),
        lambda surfaces: _percent(jumps(surfaces, 1)),
        more=_MORE_OBJECTS,
        less=_FEWER_OBJECTS,
    ),
    Measure(
        "runs",
        "length of smooth runs",
        "px",
        ("run_lengths",),
        _weighted_by_itself,
        more=_FEWER_OBJECTS,
        less=_MORE_OBJECTS,
    ),
    Measure(
        "near_jumps",
        "near a jump above 2 px",
        "%",
        ("surfaces",),
        lambda surfaces: _percent(near_jumps(surfaces)),
        more=_MORE_OBJECTS,
        less=_FEWER_OBJECTS,
    ),
    Measure(
        "occluded",
        "occluded, of known",
        "%",
        ("disparity", "surfaces"),
        lambda disparity, _: 100 * float(hidden(disparity).sum() / np.isfinite(disparity).sum()),
        more=f"{_MORE_OBJECTS}; widen disparity.target",
        less=f"{_FEWER_OBJECTS}; narrow disparity.target",
    ),
    Measure(
        "regions",
        "size of regions",
        "% of image",
        ("region_sizes",),
        lambda sizes: 100 * _weighted_by_itself(sizes) / float(sizes.sum()),
        more=_FEWER_OBJECTS,
        less=_MORE_OBJECTS,
    ),
    Measure(
        "slant",
        "slant, mean",
        "px per px",
        ("slants",),
        _mean,
        more=_STEEPER,
        less=_LESS_STEEP,
    ),
    Measure(
        "steep",
        "slanted above 0.1 px per px",
        "%",
        ("slants",),
        lambda slants: _percent(slants > _STEEP),
        more=_STEEPER,
        less=_LESS_STEEP,
    ),
    Measure(
        "disparity",
        "disparity, mean",
        "% of width",
        ("disparity",),
        lambda disparity: _of_width(_mean(_known(disparity)), disparity),
        more="raise disparity.target, camera.baseline_m",
        less="lower disparity.target, camera.baseline_m",
    ),
    Measure(
        "largest_disparity",
        "disparity, largest",
        "% of width",
        ("disparity",),
        _largest,
        more="raise disparity.max_px with disparity.target",
        less="lower disparity.max_px with disparity.target",
    ),
    Measure(
        "border_hardness",
        "borders: step over contrast",
        "ratio",
        ("luminance", "surfaces"),
        border_hardness,
        more="antialias: none, lower imperfections.blur_px",
        less="antialias: ssaa2, raise imperfections.blur_px",
        fine=True,
    ),
    Measure(
        "flat",
        "local contrast below 4 levels",
        "%",
        ("local_contrasts",),
        lambda contrasts: _percent(contrasts < _FLAT_LEVELS),
        more="raise textures.flat_share, lower textures.texels_per_pixel, particles.density or models.complex",
        less="lower textures.flat_share, raise textures.min_texture, textures.texels_per_pixel or particles.density",
        fine=True,
    ),
    Measure(
        "octaves",
        "contrast, finest over third octave",
        "ratio",
        ("octave_contrasts",),
        _finest_over_third,
        more="antialias: none, raise particles.density or models.complex",
        less="antialias: ssaa2, raise imperfections.blur_px, lower particles.density or models.complex",
        fine=True,
    ),
    Measure(
        "gradient",
        "gradient, mean",
        "levels per px",
        ("gradients",),
        _mean,
        more="raise textures.texels_per_pixel, textures.min_texture or particles.density",
        less="raise imperfections.blur_px, lower textures.texels_per_pixel, particles.density or models.complex",
        fine=True,
    ),
    Measure(
        "smooth",
        "gradient below 2 levels",
        "%",
        ("gradients",),
        lambda gradients: _percent(gradients < _SMOOTH_LEVELS),
        more="lower textures.texels_per_pixel or textures.min_texture, raise textures.flat_share",
        less="antialias: ssaa2, raise textures.texels_per_pixel, textures.min_texture or imperfections.noise",
        fine=True,
    ),
    Measure(
        "luminance",
        "luminance, mean",
        "levels",
        ("luminance",),
        _mean,
        more="raise imperfections.exposure_stops, lower imperfections.gamma",
        less="lower imperfections.exposure_stops, raise imperfections.gamma",
    ),
    Measure(
        "contrast",
        "luminance, deviation",
        "levels",
        ("luminance",),
        lambda luminance: float(luminance.std()),
        more="raise imperfections.exposure_stops, or textures.images of more contrast",
        less="lower imperfections.exposure_stops, or textures.images of less contrast",
    ),
    Measure("background", "background in view", "%", ("background",), _percent),
)
"""All measures, in the order of tables."""


PROFILES: tuple[Profile, ...] = (
    Profile(
        "disparity",
        "disparity, % of pixels",
        "% of width",
        ("disparity",),
        np.linspace(0, 30, 31),
        lambda disparity, edges: _shares(100 * _known(disparity) / disparity.shape[1], edges),
    ),
    Profile(
        "runs",
        "smooth runs, % of pixels",
        "length, % of width",
        ("run_lengths", "surfaces"),
        np.geomspace(0.2, 100, 28),
        lambda lengths, surfaces, edges: _shares(100 * lengths / surfaces.shape[1], edges, weights=lengths),
        log=True,
    ),
    Profile(
        "regions",
        "regions, % of pixels",
        "size, % of image",
        ("region_sizes",),
        np.geomspace(0.001, 100, 26),
        lambda sizes, edges: _shares(100 * sizes / sizes.sum(), edges, weights=sizes),
        log=True,
    ),
    Profile(
        "slant",
        "slant, % of smooth pixels",
        "px per px",
        ("slants",),
        np.linspace(0, 0.4, 33),
        _shares,
    ),
    Profile(
        "luminance",
        "luminance, % of pixels",
        "levels",
        ("luminance",),
        np.linspace(0, 256, 33),
        _shares,
    ),
    Profile(
        "gradient",
        "gradient, % of pixels",
        "levels per px",
        ("gradients",),
        np.geomspace(0.5, 200, 20),
        _shares,
        log=True,
        fine=True,
    ),
    Profile(
        "local_contrast",
        "contrast in 9 x 9, % of windows",
        "levels",
        ("local_contrasts",),
        np.geomspace(0.25, 128, 28),
        _shares,
        log=True,
        fine=True,
    ),
    Profile(
        "octaves",
        "contrast by octave, levels",
        "size of detail, px",
        ("octave_contrasts",),
        np.geomspace(1, 32, 6),
        lambda contrasts, _: contrasts,
        log=True,
        fine=True,
    ),
)
"""All profiles, in the order of plots."""
