"""The style of a calibrated dataset: the mix of its recipes and the look of its surfaces, chosen by what a place shows.

A mean or a distribution over the pairs of a mix is the weighted mean over its recipes, so a few pairs of each recipe
suffice to predict any mix. Blur is applied to rendered images, so one pair can be measured with every amount of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.calibration.recipes import SceneRecipe
from semisynth_gl.inputs.errors import counted
from semisynth_gl.judge.comparison import Values, unit_of
from semisynth_gl.judge.measures import MEASURES

# Tried values of textures.texels_per_pixel, and of imperfections.blur_px in pixels at the working width.
TEXELS = ((0.8, 1.5), (0.4, 0.75))
BLURS = (0.0, 0.15, 0.3, 0.5, 0.8)

# Weights are multiples of one over this number.
_PARTS = 20
# Cost of uneven weights: this times the sum of their squares, in the unit of `_far`.
_EVENNESS = 0.1
# Share of pixels at unwanted disparities that costs as much as one measure that is off by one standard deviation.
_SURPLUS = 0.07
_TRIED = " that were rendered and measured."


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """The measures of trial pairs of R recipes; M is the number of `MEASURES`.

    Attributes:
        values: for each recipe, and for each of `TEXELS`, (P, B, M) float64, the measures of its P pairs with each of
            `BLURS`; nan where a pair does not have the measure.
        shares: (R, K) float64, expected share of each recipe's pixels in each of the K bins of the wanted histogram of
            disparities; 0 for recipes that are solved for the disparities that the other recipes lack.
        wanted: (K,) float64, shares of the wanted histogram.
    """

    values: Sequence[Sequence[NDArray[np.float64]]]
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
        mix_origin: sentence on the origin of the weights, for a comment.
        look_origin: sentence on the origin of the other values, for a comment.
    """

    recipes: tuple[SceneRecipe, ...]
    weights: tuple[float, ...]
    texels_per_pixel: tuple[float, float] = TEXELS[0]
    blur_px: float = 0.0
    mix_origin: str = "Equal weights: no pairs were tried."
    look_origin: str = "As in the packaged configs: no pairs were tried."


def untried_style(recipes: Sequence[SceneRecipe]) -> Style:
    """Return the style of a config without trial pairs: equal weights, and surfaces as in the packaged configs."""
    return Style(tuple(recipes), (1 / len(recipes),) * len(recipes))


def fitted_style(recipes: Sequence[SceneRecipe], trial: Trial, place: Values, blur_scale: float) -> Style:
    """Choose the style whose pairs are expected to be nearest to a place, in standard deviations of its pictures.

    The weights of recipes are chosen by the distributions of the measures of disparity maps, and by the wanted
    disparities, since no recipe can remove pixels that a mix has too many of. Texture scale and blur are chosen by the
    means of the measures of images.

    Args:
        recipes: the R recipes to mix, in the order of ``trial``; the last one is clutter.
        trial: the measures of their trial pairs.
        place: the measures of the place's pictures, at the working width.
        blur_scale: pixels of the config's images per pixel at the working width, to convert the tried `BLURS`.
    """
    trial_pairs = counted(sum(len(values) for each in trial.values for values in each), "pair")
    pictured = [
        number for number, measure in enumerate(MEASURES) if place[measure.key].size and place[measure.key].any()
    ]
    weights, mix_origin = np.full(len(recipes), 1 / len(recipes)), "Equal weights: no disparity map says otherwise."
    # Measures of disparity maps do not depend on blur.
    maps = [np.concatenate([values[:, 0] for values in of_recipe]) for of_recipe in trial.values]
    of_maps = [
        number
        for number in pictured
        if MEASURES[number].of_maps and all(np.isfinite(values[:, number]).any() for values in maps)
    ]
    if of_maps:
        mixes = _mixes(len(recipes))
        apart = [_apart(mixes, [values[:, k] for values in maps], place[MEASURES[k].key]) for k in of_maps]
        surplus = np.maximum(mixes @ trial.shares - trial.wanted, 0).sum(axis=1) / _SURPLUS
        far = _far(np.stack([*apart, surplus], axis=-1)) + _EVENNESS * (mixes**2).sum(axis=1)
        weights = mixes[np.argmin(far)]
        mix_origin = f"Weights by {_named(of_maps)} and the wanted disparities of {trial_pairs}{_TRIED}"
    means = np.array([[_mean(values) for values in of_recipe] for of_recipe in trial.values])
    looks = _mean(means, weights)
    of_looks = [number for number in pictured if np.isfinite(looks[..., number]).all() and not MEASURES[number].of_maps]
    places = [place[MEASURES[number].key] for number in of_looks]
    off = (looks[..., of_looks] - [values.mean() for values in places]) / [unit_of(values) for values in places]
    texels, blur = map(int, np.unravel_index(np.argmin(_far(off)), looks.shape[:2]))
    kept = np.flatnonzero(weights).tolist()
    return Style(
        tuple(recipes[number] for number in kept),
        tuple(float(weights[number]) for number in kept),
        TEXELS[texels],
        float(f"{BLURS[blur] * blur_scale:.2g}"),
        mix_origin,
        f"By {_named(of_looks)} of {trial_pairs}{_TRIED}",
    )


def _mean(values: NDArray[np.float64], weights: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
    """Return weighted means along the first axis over the values that are not nan; nan where all are nan."""
    there = np.isfinite(values)
    shares = there if weights is None else there * weights.reshape(-1, *[1] * (values.ndim - 1))
    sums, total = (shares * np.where(there, values, 0)).sum(axis=0), shares.sum(axis=0)
    means: NDArray[np.float64] = np.divide(sums, total, out=np.full(total.shape, np.nan), where=total > 0)
    return means


def _apart(
    mixes: NDArray[np.float64], tried: Sequence[NDArray[np.float64]], pictures: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the Wasserstein-1 distances, (N,), between a measure's distributions in N mixes and in the place.

    ``mixes`` are weights (N, R) of recipes, ``tried`` the measure of each recipe's trial pairs, ``pictures`` of the
    place, in whose `unit_of` distances are. A mix's distribution function is the weighted mean of its recipes'.
    """
    samples = [values[np.isfinite(values)] for values in (*tried, pictures)]
    places = np.unique(np.concatenate(samples))
    *ours, theirs = (np.searchsorted(np.sort(each), places[:-1], "right") / len(each) for each in samples)
    apart: NDArray[np.float64] = np.abs(mixes @ np.array(ours) - theirs) @ np.diff(places) / unit_of(pictures)
    return apart


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


def _named(numbers: Sequence[int]) -> str:
    return ", ".join(MEASURES[number].name for number in numbers)
