"""The style of a calibrated dataset: the mix of its recipes and the look of its surfaces, chosen by what a place shows.

A mean over the pairs of a mix, or a distribution, is the mean of its recipes' by their weights, so a few pairs of each
recipe tell what any mix comes to. Blur and exposure are put on rendered images, so that one pair tells of all amounts
of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.calibration.recipes import SceneRecipe
from semisynth_gl.comparison.changes import moved_by
from semisynth_gl.comparison.measures import MEASURES, Measure
from semisynth_gl.comparison.sides import Side
from semisynth_gl.inputs.errors import counted

# The values that are tried of textures.texels_per_pixel and flat_share, and of imperfections.blur_px, at the working
# width, and exposure_stops.
TEXELS = ((0.8, 1.5), (0.4, 0.75))
FLATS = (0.0, 0.5)
BLURS = (0.0, 0.3, 0.5, 0.7, 1.0)
EXPOSURES = (-0.6, 0.0)

_OF_MIX = ("background.room", "background.street", "structures.panels", "particles.density", "disparity.target")
_OF_LOOK = "imperfections.blur_px", "imperfections.exposure_stops", "textures.texels_per_pixel", "textures.flat_share"
# Between the values that were tried.
_FINE_FLATS, _FINE_BLURS, _FINE_EXPOSURES = (
    np.round(np.arange(tried[0], tried[-1] + step / 2, step), 9) + 0.0
    for tried, step in ((FLATS, 0.05), (BLURS, 0.05), (EXPOSURES, 0.1))
)
# Weights are multiples of a twentieth.
_PARTS = 20
# How much a mix of equal weights is worth beside a mix of one recipe, in deviations of one measure.
_EVENNESS = 0.1
# A share of pixels with disparities that are not wanted, which counts as a deviation of one measure.
_SURPLUS = 0.07
# What a stop of exposure costs: darker images must gain more than this.
_DARK = 0.5
_EQUAL, _UNTRIED = "Equal weights: no disparity map says otherwise.", "Equal weights: no pairs were tried."
# Of a mean: the deviation of a place that has one picture, and the least that counts.
_UNKNOWN, _LEAST = 0.25, 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """Means of the measures over ``pairs`` trial pairs.

    ``means`` is (R, T, F, B, E, M) float64 by recipe, `TEXELS`, `FLATS`, `BLURS`, `EXPOSURES` and `MEASURES`, and
    ``geometry`` (P, M) float64 of each recipe, the measures of its P pairs, of which those of disparity maps count;
    both nan where a pair does not have the measure. ``shares`` is (R, K) float64, the expected share of each recipe's
    pixels in each bin of the wanted disparities, 0 for recipes that are solved for what the others lack; ``wanted`` is
    (K,) float64.
    """

    means: NDArray[np.float64]
    geometry: tuple[NDArray[np.float64], ...]
    pairs: int
    shares: NDArray[np.float64]
    wanted: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Style:
    """What a config says of its recipes and surfaces, and where it is from.

    ``weights`` are above 0, with a sum of 1. ``blur_px`` counts pixels of the config's images. ``expected`` is what the
    pairs of such a dataset are expected to come to, by the key of each measure; nothing where none was tried.
    """

    recipes: tuple[SceneRecipe, ...]
    weights: tuple[float, ...]
    texels_per_pixel: tuple[float, float] = TEXELS[0]
    blur_px: float = 0.0
    flat_share: float = 0.0
    exposure_stops: float = 0.0
    mix_origin: str = _UNTRIED
    look_origin: str = "As in the packaged configs: no pairs were tried."
    expected: Mapping[str, float] = field(default_factory=dict)

    def near(self, place: Side) -> tuple[int, int]:
        """Return how many measures are expected within a place's standard deviation, and how many both have."""
        both = [
            (abs(expected - mean), deviation)
            for measure in MEASURES
            if (expected := self.expected.get(measure.key)) is not None
            and (mean := place.mean(measure)) is not None
            and (deviation := place.unit(measure)) is not None
        ]
        return sum(off <= deviation for off, deviation in both), len(both)


def untried_style(recipes: Sequence[SceneRecipe]) -> Style:
    """Return the style for a place that no pair was tried for."""
    return Style(tuple(recipes), (1 / len(recipes),) * len(recipes))


def fitted_style(recipes: Sequence[SceneRecipe], trial: Trial, place: Side, blur_scale: float) -> Style:
    """Choose the style whose pairs are expected to come near to a place, in standard deviations of its pictures.

    Weights follow from the distributions of the measures of disparity maps that recipes move, and from the wanted
    disparities: what a mix shows too much of, no recipe can take back. Texture scale, blur, flat share and exposure
    follow from the means of the measures of images, and of borders, that they move; see
    `semisynth_gl.comparison.changes`. ``blur_scale`` is pixels of the images for a pixel of blur that was tried.
    """
    wanted, unit = _wanted(place)
    weights, mix_origin = np.full(len(recipes), 1 / len(recipes)), ""
    # Of geometry: nothing that surfaces wear moves it.
    geometry = _mean(trial.means[:, :, :, 0, 0], axis=(1, 2))
    rows = _rows([measure for measure in moved_by(*_OF_MIX) if measure.of_maps], wanted, geometry)
    if rows:
        mixes = _mixes(len(recipes))
        off = np.stack([_apart(mixes, trial.geometry, place, row) / unit[row] for row in rows], axis=-1)
        surplus = np.maximum(mixes @ trial.shares - trial.wanted, 0).sum(axis=1, keepdims=True)
        best = np.argmin(_far(off) + _far(surplus / _SURPLUS) + _EVENNESS * (mixes**2).sum(axis=1))
        weights, mix_origin = mixes[best], f"Weights by {_named(rows)} and the wanted disparities"
    looks = _mean(trial.means, 0, weights[:, None, None, None, None, None])
    fine = (FLATS, _FINE_FLATS), (BLURS, _FINE_BLURS), (EXPOSURES, _FINE_EXPOSURES)
    for axis, (tried, wanted_values) in enumerate(fine, 1):
        looks = _between(looks, axis, tried, wanted_values)
    rows = _rows(moved_by(*_OF_LOOK), wanted, looks.reshape(-1, looks.shape[-1]))
    far = _far((looks[..., rows] - wanted[rows]) / unit[rows]) - _DARK * _FINE_EXPOSURES
    texels, flat, blur, exposure = map(int, np.unravel_index(np.argmin(far), far.shape))
    expected = looks[texels, flat, blur, exposure]
    of_pairs = f"of {counted(trial.pairs, 'pair')} that were rendered and measured"
    kept = np.flatnonzero(weights).tolist()
    return Style(
        tuple(recipes[number] for number in kept),
        tuple(float(weights[number]) for number in kept),
        TEXELS[texels],
        float(f"{_FINE_BLURS[blur] * blur_scale:.2g}"),
        float(_FINE_FLATS[flat]),
        float(_FINE_EXPOSURES[exposure]),
        f"{mix_origin} {of_pairs}." if mix_origin else _EQUAL,
        f"By {_named(rows)} {of_pairs}.",
        {measure.key: float(value) for measure, value in zip(MEASURES, expected, strict=True) if np.isfinite(value)},
    )


def _wanted(place: Side) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return each measure's mean, nan where the place has none, and its deviation, the unit of differences."""
    # As float64, None is nan.
    means = np.array([place.mean(measure) for measure in MEASURES], np.float64)
    deviations = np.array([place.deviation(measure) for measure in MEASURES], np.float64)
    units = np.where(np.isnan(deviations), _UNKNOWN * np.abs(means), deviations)
    return means, np.maximum(units, _LEAST * np.abs(means))


def _apart(
    mixes: NDArray[np.float64], geometry: Sequence[NDArray[np.float64]], place: Side, row: int
) -> NDArray[np.float64]:
    """Return how far the distributions of a measure in mixes, (N, R) weights of recipes, are from a place's: (N,).

    The distribution function of a mix is the mean of its recipes' by their weights; see `Comparison.distance`.
    """
    samples = [
        values[np.isfinite(values)]
        for values in (*(pairs[:, row] for pairs in geometry), place.values[MEASURES[row].key])
    ]
    places = np.unique(np.concatenate(samples))
    *ours, theirs = (np.searchsorted(np.sort(each), places[:-1], "right") / len(each) for each in samples)
    apart: NDArray[np.float64] = np.abs(mixes @ np.array(ours) - theirs) @ np.diff(places)
    return apart


def _rows(measures: Sequence[Measure], wanted: NDArray[np.float64], found: NDArray[np.float64]) -> list[int]:
    """Return the numbers of the measures that the place and all of (..., M) have."""
    chosen = {measure.key for measure in measures}
    there = np.isfinite(wanted) & np.isfinite(found).all(axis=0) & (wanted != 0)
    return [number for number, measure in enumerate(MEASURES) if measure.key in chosen and there[number]]


def _far(off: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far (..., M) differences in deviations are together, (...).

    Small ones count by their square and large ones by themselves: in a sum of squares, a measure that is far off would
    pull the others away.
    """
    far: NDArray[np.float64] = (np.sqrt(1 + off**2) - 1).sum(axis=-1)
    return far


def _mixes(recipes: int) -> NDArray[np.float64]:
    """Return all weights (N, R) in twentieths, 1 together, above 0 for the last recipe, which is clutter.

    Clutter makes up for what the others lack of the wanted disparities.
    """
    places = _PARTS + recipes - 2
    cuts = np.array([(-1, *cut, places) for cut in combinations(range(places), recipes - 1)])
    mixes = np.diff(cuts, axis=1) - 1.0
    mixes[:, -1] += 1
    weights: NDArray[np.float64] = mixes / _PARTS
    return weights


def _mean(
    values: NDArray[np.float64], axis: int | tuple[int, ...], weights: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Return means along axes over the values that are not nan; nan where all are."""
    there = np.isfinite(values)
    shares = there * (1.0 if weights is None else weights)
    sums, total = (shares * np.where(there, values, 0)).sum(axis=axis), shares.sum(axis=axis)
    means: NDArray[np.float64] = np.divide(sums, total, out=np.full(total.shape, np.nan), where=total > 0)
    return means


def _between(
    values: NDArray[np.float64], axis: int, tried: Sequence[float], wanted: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return what values along an axis, of ``tried`` in rising order, come to at those that are wanted."""
    parts = np.array([np.interp(wanted, tried, each) for each in np.eye(len(tried))])
    found: NDArray[np.float64] = np.moveaxis(np.tensordot(values, parts, (axis, 0)), -1, axis)
    return found


def _named(rows: Sequence[int]) -> str:
    return ", ".join(MEASURES[row].name for row in rows)
