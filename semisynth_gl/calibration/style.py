"""The style of a calibrated dataset: the mix of its recipes and the look of its surfaces, chosen by what a place shows.

A mean or a distribution over the pairs of a mix is the weighted mean over its recipes, so a few pairs of each recipe
suffice to predict any mix. Blur and exposure are applied to rendered images, so one pair can be measured with every
amount of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.calibration.recipes import SceneRecipe
from semisynth_gl.inputs.errors import counted
from semisynth_gl.judge.advice import moved_by
from semisynth_gl.judge.comparison import Side
from semisynth_gl.judge.measures import MEASURES, Measure

# Tried values of textures.texels_per_pixel, imperfections.blur_px (in pixels at the working width) and
# imperfections.exposure_stops.
TEXELS = ((0.8, 1.5), (0.4, 0.75))
BLURS = (0.0, 0.3, 0.5, 0.7, 1.0)
EXPOSURES = (-0.6, 0.0)

_OF_MIX = ("background.room", "background.street", "structures.panels", "particles.density", "disparity.target")
_OF_LOOK = "imperfections.blur_px", "imperfections.exposure_stops", "textures.texels_per_pixel"
# Values that may be chosen: the measures between tried values are interpolated.
_FINE_BLURS, _FINE_EXPOSURES = (
    np.round(np.arange(tried[0], tried[-1] + step / 2, step), 9) + 0.0
    for tried, step in ((BLURS, 0.05), (EXPOSURES, 0.1))
)
# Weights are multiples of one over this number.
_PARTS = 20
# Cost of uneven weights: this times the sum of their squares, in the unit of `_far`.
_EVENNESS = 0.1
# Share of pixels at unwanted disparities that costs as much as one measure that is off by one standard deviation.
_SURPLUS = 0.07
# Cost of darkening by one stop: darker images are chosen only where the measures gain more than this.
_DARK = 0.5
_EQUAL, _UNTRIED = "Equal weights: no disparity map says otherwise.", "Equal weights: no pairs were tried."
# As shares of a measure's mean: the standard deviation assumed for a place with a single picture, and the lower limit
# of any standard deviation.
_UNKNOWN, _LEAST = 0.25, 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """The measures of trial pairs of R recipes; M is the number of `MEASURES`.

    Attributes:
        means: (R, T, B, E, M) float64, means over pairs by recipe and by index into `TEXELS`, `BLURS`, `EXPOSURES` and
            `MEASURES`; nan where no pair has the measure.
        geometry: for each recipe, (P, M) float64 measures of its P pairs; only measures of disparity maps are used. nan
            where a pair does not have the measure.
        pairs: number of all trial pairs.
        shares: (R, K) float64, expected share of each recipe's pixels in each of the K bins of the wanted histogram of
            disparities; 0 for recipes that are solved for the disparities that the other recipes lack.
        wanted: (K,) float64, shares of the wanted histogram.
    """

    means: NDArray[np.float64]
    geometry: tuple[NDArray[np.float64], ...]
    pairs: int
    shares: NDArray[np.float64]
    wanted: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Style:
    """The recipes of a config and the look of its surfaces, with sentences on their origin.

    Attributes:
        recipes: the recipes of the mix.
        weights: weight of each recipe, above 0; the sum is 1.
        texels_per_pixel: low and high end of ``textures.texels_per_pixel``.
        blur_px: ``imperfections.blur_px``, in pixels of the config's images.
        exposure_stops: ``imperfections.exposure_stops``.
        mix_origin: sentence on the origin of the weights, for a comment.
        look_origin: sentence on the origin of the other values, for a comment.
        expected: expected mean of each measure over a dataset with this style, by the measure's key; empty where no
            pairs were tried.
    """

    recipes: tuple[SceneRecipe, ...]
    weights: tuple[float, ...]
    texels_per_pixel: tuple[float, float] = TEXELS[0]
    blur_px: float = 0.0
    exposure_stops: float = 0.0
    mix_origin: str = _UNTRIED
    look_origin: str = "As in the packaged configs: no pairs were tried."
    expected: Mapping[str, float] = field(default_factory=dict)

    def near(self, place: Side) -> tuple[int, int]:
        """Count the measures whose expected mean is near the place's mean.

        Returns the number of measures that are at most the place's standard deviation off, and the number of measures
        that could be compared.
        """
        both = [
            (abs(expected - mean), deviation)
            for measure in MEASURES
            if (expected := self.expected.get(measure.key)) is not None
            and (mean := place.mean(measure)) is not None
            and (deviation := place.unit(measure)) is not None
        ]
        return sum(off <= deviation for off, deviation in both), len(both)


def untried_style(recipes: Sequence[SceneRecipe]) -> Style:
    """Return the style of a config without trial pairs: equal weights, and surfaces as in the packaged configs."""
    return Style(tuple(recipes), (1 / len(recipes),) * len(recipes))


def fitted_style(recipes: Sequence[SceneRecipe], trial: Trial, place: Side, blur_scale: float) -> Style:
    """Choose the style whose pairs are expected to be nearest to a place, in standard deviations of its pictures.

    The weights of recipes are chosen by the distributions of the measures of disparity maps that recipes change, and by
    the wanted disparities, since no recipe can remove pixels that a mix has too many of. Texture scale, blur and
    exposure are chosen by the means of the measures that they change; see `semisynth_gl.judge.advice`.

    Args:
        recipes: the R recipes to mix, in the order of ``trial``; the last one is clutter.
        trial: the measures of their trial pairs.
        place: the measures of the place's pictures, at the working width.
        blur_scale: pixels of the config's images per pixel at the working width, to convert the tried `BLURS`.
    """
    place_means, unit = _wanted(place)
    weights, mix_origin = np.full(len(recipes), 1 / len(recipes)), ""
    # Measures of disparity maps, which do not depend on the look of surfaces.
    geometry = mean(trial.means[:, :, 0, 0], axis=1)
    rows = _rows([measure for measure in moved_by(*_OF_MIX) if measure.of_maps], place_means, geometry)
    if rows:
        mixes = _mixes(len(recipes))
        off = np.stack([_apart(mixes, trial.geometry, place, row) / unit[row] for row in rows], axis=-1)
        surplus = np.maximum(mixes @ trial.shares - trial.wanted, 0).sum(axis=1, keepdims=True)
        best = np.argmin(_far(off) + _far(surplus / _SURPLUS) + _EVENNESS * (mixes**2).sum(axis=1))
        weights, mix_origin = mixes[best], f"Weights by {_named(rows)} and the wanted disparities"
    looks = mean(trial.means, 0, weights[:, None, None, None, None])
    fine = (BLURS, _FINE_BLURS), (EXPOSURES, _FINE_EXPOSURES)
    for axis, (tried, fine_values) in enumerate(fine, 1):
        looks = _between(looks, axis, tried, fine_values)
    rows = _rows(moved_by(*_OF_LOOK), place_means, looks.reshape(-1, looks.shape[-1]))
    far = _far((looks[..., rows] - place_means[rows]) / unit[rows]) - _DARK * _FINE_EXPOSURES
    texels, blur, exposure = map(int, np.unravel_index(np.argmin(far), far.shape))
    expected = looks[texels, blur, exposure]
    of_pairs = f"of {counted(trial.pairs, 'pair')} that were rendered and measured"
    kept = np.flatnonzero(weights).tolist()
    return Style(
        tuple(recipes[number] for number in kept),
        tuple(float(weights[number]) for number in kept),
        TEXELS[texels],
        float(f"{_FINE_BLURS[blur] * blur_scale:.2g}"),
        float(_FINE_EXPOSURES[exposure]),
        f"{mix_origin} {of_pairs}." if mix_origin else _EQUAL,
        f"By {_named(rows)} {of_pairs}.",
        {measure.key: float(value) for measure, value in zip(MEASURES, expected, strict=True) if np.isfinite(value)},
    )


def _wanted(place: Side) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the place's mean of each measure, nan where it has none, and the unit of differences from it, (M,) each.

    The unit is the standard deviation over pictures, or a share of the mean where that is unknown or too small.
    """
    # Converted to float64, None becomes nan.
    means = np.array([place.mean(measure) for measure in MEASURES], np.float64)
    deviations = np.array([place.deviation(measure) for measure in MEASURES], np.float64)
    units = np.where(np.isnan(deviations), _UNKNOWN * np.abs(means), deviations)
    return means, np.maximum(units, _LEAST * np.abs(means))


def _apart(
    mixes: NDArray[np.float64], geometry: Sequence[NDArray[np.float64]], place: Side, row: int
) -> NDArray[np.float64]:
    """Return the Wasserstein-1 distances, (N,), between a measure's distributions in N mixes and in the place.

    ``mixes`` are weights (N, R) of recipes, ``geometry`` is that of `Trial`, and ``row`` is the measure's number in
    `MEASURES`. A mix's distribution function is the weighted mean of its recipes' distribution functions.
    """
    samples = [
        values[np.isfinite(values)]
        for values in (*(pairs[:, row] for pairs in geometry), place.values[MEASURES[row].key])
    ]
    places = np.unique(np.concatenate(samples))
    *ours, theirs = (np.searchsorted(np.sort(each), places[:-1], "right") / len(each) for each in samples)
    apart: NDArray[np.float64] = np.abs(mixes @ np.array(ours) - theirs) @ np.diff(places)
    return apart


def _rows(measures: Sequence[Measure], place_means: NDArray[np.float64], found: NDArray[np.float64]) -> list[int]:
    """Return the numbers in `MEASURES` of those ``measures`` that can be compared.

    The place has a mean (M,) other than 0, and no row of the means (N, M) that were ``found`` in trials is nan.
    """
    chosen = {measure.key for measure in measures}
    there = np.isfinite(place_means) & np.isfinite(found).all(axis=0) & (place_means != 0)
    return [number for number, measure in enumerate(MEASURES) if measure.key in chosen and there[number]]


def _far(off: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a total (...) of differences (..., M), which are in standard deviations.

    Small differences count in proportion to their square, large ones in proportion to themselves: in a sum of squares,
    one measure that is far off would outweigh all others.
    """
    far: NDArray[np.float64] = (np.sqrt(1 + off**2) - 1).sum(axis=-1)
    return far


def _mixes(recipes: int) -> NDArray[np.float64]:
    """Return all N sets of weights of R ``recipes``, (N, R), in twentieths with a sum of 1.

    The last weight is above 0: the last recipe, clutter, adds the wanted disparities that the other recipes lack.
    """
    places = _PARTS + recipes - 2
    cuts = np.array([(-1, *cut, places) for cut in combinations(range(places), recipes - 1)])
    mixes = np.diff(cuts, axis=1) - 1.0
    mixes[:, -1] += 1
    weights: NDArray[np.float64] = mixes / _PARTS
    return weights


def mean(
    values: NDArray[np.float64], axis: int | tuple[int, ...], weights: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Return weighted means along axes over the values that are not nan; nan where all values are nan."""
    there = np.isfinite(values)
    shares = there * (1.0 if weights is None else weights)
    sums, total = (shares * np.where(there, values, 0)).sum(axis=axis), shares.sum(axis=axis)
    means: NDArray[np.float64] = np.divide(sums, total, out=np.full(total.shape, np.nan), where=total > 0)
    return means


def _between(
    values: NDArray[np.float64], axis: int, tried: Sequence[float], chosen: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Interpolate ``values`` along an axis: from its points ``tried``, in rising order, to points ``chosen``."""
    parts = np.array([np.interp(chosen, tried, each) for each in np.eye(len(tried))])
    found: NDArray[np.float64] = np.moveaxis(np.tensordot(values, parts, (axis, 0)), -1, axis)
    return found


def _named(rows: Sequence[int]) -> str:
    return ", ".join(MEASURES[row].name for row in rows)
