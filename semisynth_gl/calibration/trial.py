"""Chooses weights of recipes, texture scale and blur by trial: it renders and measures a few pairs of each recipe.

The distribution of a measure over a mix is the weighted mean of its distributions over the recipes, so a few pairs of
each recipe predict any mix. Blur is applied to rendered images, so one pair can be measured with each amount of blur.

Views are resized to a common width, the working width (`working_width`), before they are measured.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import ArrayLike, NDArray

from semisynth_gl.calibration.draft import TEXELS, ConfigDraft, rounded
from semisynth_gl.config.load import parse_values
from semisynth_gl.judge.comparison import Values, standard_deviation
from semisynth_gl.judge.measure_input import make_measure_input, working_width
from semisynth_gl.judge.measures import MEASURES, measure_view
from semisynth_gl.listener import Listener
from semisynth_gl.pairs.imperfections import ImageImperfections, apply_imperfections
from semisynth_gl.pairs.pipeline import Pair, PairRenderer
from semisynth_gl.seeds.seeds import Purpose, generator

# The values of imperfections.blur_px that are tried, in pixels at the working width.
BLURS = (0.0, 0.15, 0.3, 0.5, 0.8)

_SEED = 0
# Weights are multiples of 1 over this number.
_PARTS = 20
# Uneven weights cost this times the sum of their squares.
_EVENNESS = 0.1
# This share of pixels at unwanted disparities costs as much as a measure that is off by one standard deviation.
_SURPLUS = 0.07

Floats = NDArray[np.float64]


def fit(draft: ConfigDraft, reference: Values, pairs: int, listener: Listener) -> ConfigDraft:
    """Render trial pairs, and return the draft with the weights, texture scale and blur nearest to ``reference``.

    About ``pairs`` pairs of each recipe are rendered with each of `TEXELS`, and each pair is measured with all `BLURS`.
    ``reference`` has the measures of the user's photographs and maps at the `working_width`. The listener is told the
    number of trial pairs, and each finished pair. Raises InputError if inputs cannot be used, and BackendError if
    OpenGL cannot.
    """
    scenes, disparity, wanted = draft.sections["scenes"], {**draft.sections["disparity"]}, draft.disparity.target
    width_px = draft.rig.camera.width_px
    blur_scale = width_px / working_width(width_px)
    cells = {f"{scene['recipe']}-{k}": (r, k) for r, scene in enumerate(scenes) for k in range(len(TEXELS))}
    # A recipe that states no depth layers of particles gets particles that reach the target: in a trial, the recipe
    # reaches it alone. In a mix, it adds what the other recipes lack; solving that for every mix would take long.
    target = {"disparity": {"target": disparity.pop("target")}}
    own = [{} if "layers" in scene.get("particles", {}) else target for scene in scenes]
    tried = [
        scenes[r] | own[r] | {"recipe": name, "textures": {"texels_per_pixel": [*TEXELS[k]]}}
        for name, (r, k) in cells.items()
    ]
    # Render only what is measured.
    sections = draft.sections | {"disparity": disparity, "scenes": tried, "outputs": [], "truth": "left"}
    config = parse_values(sections, "the trial's config")
    shares = np.zeros((len(scenes), len(wanted.shares)))
    trial: list[list[list[Floats]]] = [[[] for _ in TEXELS] for _ in scenes]
    with PairRenderer(config, _SEED) as renderer:
        listener.on_total(pairs * len(cells))
        for made, sampler in zip(renderer.sampler.recipes, renderer.sampler.samplers, strict=True):
            # Expected shares do not depend on texels.
            if made.config.particles.layers is not None:
                shares[cells[str(made.name)][0]] = sampler.disparity_solver.expected().rebinned(wanted.edges_px).shares
        for number in range(pairs * len(cells)):
            # Without checks: the pairs that replace failed ones have the same statistics.
            pair = renderer.render(number, checked=False)
            recipe, scale = cells[pair.provenance["recipe"]]
            trial[recipe][scale].append(_measures_by_blur(pair, width_px, blur_scale))
            listener.on_pair()
    weights, texels, blur = nearest_mix(trial, shares, wanted.shares, reference)
    weighed = zip(scenes, weights.tolist(), strict=True)
    look = {
        "scenes": [scene | {"weight": weight} for scene, weight in weighed if weight],
        "textures": draft.sections["textures"] | {"texels_per_pixel": TEXELS[texels]},
        "imperfections": {"blur_px": float(f"{BLURS[blur] * blur_scale:.2g}")},
    }
    return replace(draft, sections=rounded(draft.sections | look))


def _measures_by_blur(pair: Pair, width_px: int, blur_scale: float) -> Floats:
    """Return a trial pair's M measures with each of `BLURS`, (B, M); nan for a missing measure."""
    view, of_images = pair.frame.left, [measure for measure in MEASURES if measure.of_images]
    measured = make_measure_input(working_width(width_px), view.image, view.disparity)
    of_map = measure_view(measured, [measure for measure in MEASURES if not measure.of_images])
    found = []
    for blur in BLURS:
        imperfections = ImageImperfections(blur * blur_scale, 0.0, 0.0, 1.0)
        image = apply_imperfections(view.image, imperfections, generator(_SEED, Purpose.IMPERFECTIONS, pair.index))
        blurred = replace(measured, luminance=make_measure_input(working_width(width_px), image).luminance)
        measures = of_map | measure_view(blurred, of_images)
        found.append([measures.get(measure.key, np.nan) for measure in MEASURES])
    return np.array(found, np.float64)


def nearest_mix(
    trial: Sequence[Sequence[Sequence[Floats]]], shares: Floats, wanted: Floats, reference: Values
) -> tuple[Floats, int, int]:
    """Choose the mix whose pairs are expected to be nearest to ``reference``, in its standard deviations.

    Returns the weights of R recipes, (R,) with a sum of 1, and the indices of the texture scale and the blur. The
    weights are chosen by the distributions of the measures of disparity maps. A mix also costs more if the recipes with
    stated layers put more pixels into a bin than wanted: particles of other recipes can only add pixels. Texture scale
    and blur are chosen by the means of the measures of images.

    Args:
        trial: for each recipe (the last is clutter), each of `TEXELS` and each pair: (B, M), the M measures with each
            of `BLURS`; nan for a missing measure.
        shares: (R, K), expected share of each recipe's pixels in each of the K bins of the wanted histogram; 0 for
            recipes without stated layers, whose particles add what the other recipes lack.
        wanted: (K,), shares of the wanted histogram.
        reference: the measures of the user's photographs and maps, at the working width.
    """
    pairs = [[np.reshape(values, (-1, len(BLURS), len(MEASURES))) for values in of_recipe] for of_recipe in trial]
    # Measures of disparity maps do not depend on blur.
    maps = [np.concatenate([values[:, 0] for values in of_recipe]) for of_recipe in pairs]
    usable = [number for number, measure in enumerate(MEASURES) if reference[measure.key].any()]
    of_maps = [k for k in usable if not MEASURES[k].of_images and all(np.isfinite(each[:, k]).any() for each in maps)]
    weights = np.full(len(trial), 1 / len(trial))
    if of_maps:
        mixes = _mixes(len(trial))
        apart = [_distances(mixes, [values[:, k] for values in maps], reference[MEASURES[k].key]) for k in of_maps]
        surplus = np.maximum(mixes @ shares - wanted, 0).sum(axis=1) / _SURPLUS
        far = _total_cost(np.stack([*apart, surplus])) + _EVENNESS * (mixes**2).sum(axis=1)
        weights = mixes[np.argmin(far)]
    looks = _mean([[_mean(values) for values in of_recipe] for of_recipe in pairs], weights)
    of_looks = [k for k in usable if np.isfinite(looks[..., k]).all() and MEASURES[k].of_images]
    places = [reference[MEASURES[k].key] for k in of_looks]
    deviations = [standard_deviation(values) for values in places]
    off = (looks[..., of_looks] - [values.mean() for values in places]) / deviations
    texels, blur = map(int, np.unravel_index(np.argmin(_total_cost(np.moveaxis(off, -1, 0))), looks.shape[:2]))
    return weights, texels, blur


def _mean(values: ArrayLike, weights: Floats | None = None) -> Floats:
    """Return weighted means along the first axis without nan values; nan if all values are nan."""
    known = np.ma.masked_invalid(np.asarray(values, np.float64))
    means: Floats = np.ma.filled(np.ma.average(known, axis=0, weights=weights), np.nan)
    return means


def _distances(mixes: Floats, tried: Sequence[Floats], pictures: Floats) -> Floats:
    """Return the Wasserstein-1 distances, (N,), between a measure's distributions in N mixes and in the reference.

    ``mixes`` are weights (N, R) of recipes. ``tried`` has the measure for the trial pairs of each recipe, and
    ``pictures`` for the reference's pictures; its `standard_deviation` is the unit of the distances.
    """
    samples = [values[np.isfinite(values)] for values in (*tried, pictures)]
    # A mix's distribution function is the weighted mean of its recipes' functions.
    steps = np.unique(np.concatenate(samples))
    *ours, theirs = (np.searchsorted(np.sort(each), steps[:-1], "right") / len(each) for each in samples)
    apart: Floats = np.abs(mixes @ np.array(ours) - theirs) @ np.diff(steps) / standard_deviation(pictures)
    return apart


def _total_cost(off: Floats) -> Floats:
    """Add costs along the first axis. Large costs grow linearly: with squares, one outlier would outweigh the rest."""
    far: Floats = (np.sqrt(1 + off**2) - 1).sum(axis=0)
    return far


def _mixes(recipes: int) -> Floats:
    """Return all N sets of weights of R ``recipes``, (N, R), in twentieths with a sum of 1.

    At least one twentieth goes to the last recipe, clutter, which adds the wanted disparities that the others lack.
    """
    choices = combinations_with_replacement(range(recipes), _PARTS - 1)
    return np.array([np.bincount((*chosen, recipes - 1), minlength=recipes) for chosen in choices])[::-1] / _PARTS
