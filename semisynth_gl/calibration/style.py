"""The style of a calibrated dataset: the mix of its recipes and the look of its surfaces, chosen by what a place shows.

A mean over the pairs of a mix is the mean of its recipes by their weights, so a few pairs of each recipe tell what any
mix comes to. Blur is put on rendered images, so that one pair tells of all amounts of it.
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

TEXELS = ((0.8, 1.5), (0.4, 0.75))
"""The values of ``textures.texels_per_pixel`` that are tried."""
BLURS = (0.0, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0)
"""The values of ``imperfections.blur_px`` that are tried, at the working width or a smaller one."""

_OF_MIX = ("background.room", "background.street", "structures.panels", "particles.density", "disparity.target")
_OF_LOOK = ("imperfections.blur_px", "textures.texels_per_pixel", "textures.flat_share")
# Weights are multiples of a twentieth.
_PARTS = 20
# How much a mix of equal weights is worth beside a mix of one recipe, in deviations of one measure.
_EVENNESS = 0.1
_MOST_FLAT = 0.5
_EQUAL = "Equal weights: no disparity map says otherwise."
# Of a mean: the deviation of a place that has one picture, and the least that counts.
_UNKNOWN, _LEAST = 0.25, 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """Means of the measures over trial pairs.

    Attributes:
        means: (R, T, B, M) float64 by recipe, `TEXELS`, `BLURS` and `MEASURES`; nan where no pair has the measure.
        pairs: number of the pairs.
    """

    means: NDArray[np.float64]
    pairs: int


@dataclass(frozen=True, slots=True)
class Style:
    """What a config says of its recipes and surfaces.

    Attributes:
        recipes: the recipes of the mix.
        weights: their shares of the scenes; above 0, sum 1.
        texels_per_pixel: ends of the range.
        blur_px: in pixels of the config's images.
        flat_share: share of flat surfaces.
        mix_origin: a sentence on where the weights came from.
        look_origin: a sentence on where the values of surfaces and blur came from.
        expected: what the pairs of such a dataset are expected to come to, by the key of each measure; nothing where
            none was tried.
    """

    recipes: tuple[SceneRecipe, ...]
    weights: tuple[float, ...]
    texels_per_pixel: tuple[float, float] = TEXELS[0]
    blur_px: float = 0.0
    flat_share: float = 0.0
    mix_origin: str = _EQUAL
    look_origin: str = "As in the packaged configs: no pairs were tried."
    expected: Mapping[str, float] = field(default_factory=dict)

    def near(self, place: Side) -> tuple[int, int]:
        """Return how many measures are expected within a place's standard deviation, and how many both have."""
        both = [
            (abs(expected - mean), deviation)
            for measure in MEASURES
            if (expected := self.expected.get(measure.key)) is not None
            and (mean := place.mean(measure)) is not None
            and (deviation := place.deviation(measure))
        ]
        return sum(off <= deviation for off, deviation in both), len(both)


def untried_style(recipes: Sequence[SceneRecipe]) -> Style:
    """Return the style for a place that no pair was tried for."""
    return Style(tuple(recipes), (1 / len(recipes),) * len(recipes))


def fitted_style(recipes: Sequence[SceneRecipe], trial: Trial, place: Side, blur_scale: float) -> Style:
    """Choose the style whose pairs are expected to come near to a place, in standard deviations of its pictures.

    Weights follow from the measures of disparity maps that recipes move; texture scale, blur and flat share from those
    of images, and of borders, that they move. See `semisynth_gl.comparison.changes`.

    Args:
        recipes: the recipes that were tried.
        trial: their measures.
        place: the measures of the place.
        blur_scale: pixels of the images for a pixel of blur that was tried.
    """
    wanted, unit = _wanted(place)
    weights, mix_origin = np.full(len(recipes), 1 / len(recipes)), ""
    # Of geometry: neither texture nor blur moves it.
    geometry = _mean(trial.means[:, :, 0], axis=1)
    rows = _rows([measure for measure in moved_by(*_OF_MIX) if measure.of_maps], wanted, geometry)
    if rows:
        mixes = _mixes(len(recipes))
        off = (mixes @ geometry[:, rows] - wanted[rows]) / unit[rows]
        best = np.argmin(_far(off) + _EVENNESS * (mixes**2).sum(axis=1))
        weights, mix_origin = mixes[best], f"Weights by {_named(rows)}"
    looks = _mean(trial.means, 0, weights[:, None, None, None])
    rows = _rows(moved_by(*_OF_LOOK), wanted, looks.reshape(-1, looks.shape[-1]))
    share = _flat_share(looks, wanted)
    looks = _with_flat_surfaces(looks, share)
    off = (looks[..., rows] - wanted[rows]) / unit[rows]
    texels, blur = np.unravel_index(np.argmin(_far(off)), share.shape)
    expected = looks[texels, blur]
    tried = f"of {trial.pairs} pairs that were rendered and measured"
    kept = np.flatnonzero(weights).tolist()
    return Style(
        tuple(recipes[number] for number in kept),
        tuple(float(weights[number]) for number in kept),
        TEXELS[texels],
        float(f"{BLURS[blur] * blur_scale:.2g}"),
        float(share[texels, blur]),
        f"{mix_origin} {tried}." if mix_origin else _EQUAL,
        f"By {_named(rows)} {tried}.",
        {measure.key: float(value) for measure, value in zip(MEASURES, expected, strict=True) if np.isfinite(value)},
    )


def _wanted(place: Side) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return each measure's mean, nan where the place has none, and its deviation, the unit of differences."""
    means = np.array([np.nan if (mean := place.mean(measure)) is None else mean for measure in MEASURES])
    known = [place.deviation(measure) for measure in MEASURES]
    units = np.array([np.nan if deviation is None else deviation for deviation in known])
    return means, np.fmax(np.where(np.isnan(units), _UNKNOWN * np.abs(means), units), _LEAST * np.abs(means))


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
    """Return all weights (N, R) that are multiples of a twentieth, 1 together, with the last one above 0.

    The last recipe is clutter: it makes up for what the others lack of the wanted disparities.
    """
    places = _PARTS + recipes - 2
    cuts = np.array([(-1, *cut, places) for cut in combinations(range(places), recipes - 1)])
    mixes = np.diff(cuts, axis=1) - 1.0
    mixes[:, -1] += 1
    weights: NDArray[np.float64] = mixes / _PARTS
    return weights


def _mean(values: NDArray[np.float64], axis: int, weights: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
    """Return means along an axis over the values that are not nan; nan where all are."""
    there = np.isfinite(values)
    shares = there * (1.0 if weights is None else weights)
    sums, total = (shares * np.where(there, values, 0)).sum(axis=axis), shares.sum(axis=axis)
    means: NDArray[np.float64] = np.divide(sums, total, out=np.full(total.shape, np.nan), where=total > 0)
    return means


_FLAT, _SMOOTH, _GRADIENT = (
    next(number for number, measure in enumerate(MEASURES) if measure.key == key)
    for key in ("flat", "smooth", "gradient")
)


def _flat_share(looks: NDArray[np.float64], wanted: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the share of flat surfaces, (T, B), that makes up for what a mix lacks of flat windows."""
    flat = looks[..., _FLAT]
    lacking = np.nan_to_num((wanted[_FLAT] - flat) / (100 - flat))
    share: NDArray[np.float64] = np.round(np.clip(lacking, 0, _MOST_FLAT) * _PARTS) / _PARTS
    return share


def _with_flat_surfaces(looks: NDArray[np.float64], share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what (T, B, M) comes to where a share (T, B) of the surfaces is flat."""
    looks = looks.copy()
    for row, of_flat in ((_FLAT, 100.0), (_SMOOTH, 100.0), (_GRADIENT, 0.0)):
        looks[..., row] += share * (of_flat - looks[..., row])
    return looks


def _named(rows: Sequence[int]) -> str:
    return ", ".join(MEASURES[row].name for row in rows)
