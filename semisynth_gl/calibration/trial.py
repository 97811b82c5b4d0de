"""Trial pairs: a few pairs of each recipe, rendered like the pairs of the dataset to come, and measured."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.calibration.draft import Draft
from semisynth_gl.calibration.style import BLURS, EXPOSURES, TEXELS, Trial, fitted_style, mean, untried_style
from semisynth_gl.calibration.write import config_values
from semisynth_gl.config.load import parse_values
from semisynth_gl.judge.comparison import Side
from semisynth_gl.judge.measured_view import MeasuredView, make_view, working_width
from semisynth_gl.judge.measures import MEASURES
from semisynth_gl.listener import FinishedPair, Listener
from semisynth_gl.pairs.imperfections import Imperfections, apply_imperfections
from semisynth_gl.pairs.pipeline import Pair, PairRenderer
from semisynth_gl.seeds.seeds import Purpose, generator

_SEED = 0
_LOOKS = -1, len(BLURS), len(EXPOSURES), len(MEASURES)


def fit(draft: Draft, place: Side, pairs: int, listener: Listener) -> Draft:
    """Render trial pairs, and return the draft with the style whose pairs are nearest to a place.

    Args:
        draft: the draft of the config to come.
        place: measures of the place's pictures at the `working_width`.
        pairs: number of pairs of each recipe with each of `TEXELS`; each pair is measured with all `BLURS` and
            `EXPOSURES`.
        listener: hears the number of all trial pairs, and each finished pair.

    Raises:
        InputError: where inputs cannot be used.
        BackendError: where OpenGL cannot be used.
    """
    trial, blur_scale = _try(draft, pairs, listener), _blur_scale(draft.size.width_px)
    return replace(draft, tried=fitted_style(draft.recipes, trial, place, blur_scale))


def _blur_scale(width_px: int) -> float:
    """Return image pixels per pixel at the working width: it converts a blur at that width to one of the image."""
    return width_px / working_width(width_px)


def _try(draft: Draft, pairs: int, listener: Listener) -> Trial:
    recipes = draft.recipes
    cells = {f"{recipe.name}-{k}": (r, k) for r, recipe in enumerate(recipes) for k in range(len(TEXELS))}
    tried = [
        replace(recipes[r], name=name, keys={**recipes[r].keys, "textures": {"texels_per_pixel": list(TEXELS[k])}})
        for name, (r, k) in cells.items()
    ]
    looks: list[list[list[NDArray[np.float64]]]] = [[[] for _ in TEXELS] for _ in recipes]
    target = draft.disparity.target
    shares = np.zeros((len(recipes), len(target.shares)))
    total = pairs * len(cells)
    listener.on_total(total)
    trial_values = _as_tried(config_values(replace(draft, tried=untried_style(tried))).values)
    with PairRenderer(parse_values(trial_values, "the trial's config", draft.overrides), _SEED) as renderer:
        for recipe, sampler in zip(renderer.sampler.recipes, renderer.sampler.samplers, strict=True):
            # Expected shares do not depend on texels.
            r, k = cells[str(recipe.name)]
            if k == 0 and recipe.config.particles.layers is not None:
                shares[r] = sampler.disparity_solver.expected().rebinned(target.edges_px).shares
        for number in range(total):
            # Skip the checks: redrawn scenes would have the same statistics.
            pair = renderer.render(number, checked=False)
            r, k = cells[pair.provenance["recipe"]]
            looks[r][k].append(_looks(pair, draft.size.width_px))
            listener.on_pair(FinishedPair("train", number))
    means = np.array([[mean(np.reshape(each, _LOOKS), axis=0) for each in of_recipe] for of_recipe in looks])
    geometry = tuple(np.array([values[0, 0] for each in of_recipe for values in each]) for of_recipe in looks)
    return Trial(means, geometry, total, shares, target.shares)


def _looks(pair: Pair, width_px: int) -> NDArray[np.float64]:
    """Return a trial pair's measures by blur and exposure, (B, E, M), nan where it has none; see `Trial`."""
    view = pair.frame.left
    values = np.full((len(BLURS), len(EXPOSURES), len(MEASURES)), np.nan)
    of_maps = np.array([measure.of_maps for measure in MEASURES])
    measured = make_view(str(pair.index), working_width(width_px), image=view.image, disparity=view.disparity)
    # Measures of the disparity map do not depend on blur or exposure.
    values[..., of_maps] = _measured(measured, of_maps)
    for b, blur in enumerate(BLURS):
        drawn = Imperfections(blur * _blur_scale(width_px), 0.0, 0.0, 1.0)
        image = apply_imperfections(view.image, drawn, generator(_SEED, Purpose.IMPERFECTIONS, pair.index))
        blurred = measured.with_image(image)
        for e, stops in enumerate(EXPOSURES):
            values[b, e, ~of_maps] = _measured(blurred.exposed(stops), ~of_maps)
    return values


def _measured(view: MeasuredView, chosen: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the measures of a view where ``chosen``, (M,) bool, is true; nan where the view does not have one."""
    # Converted to float64, None becomes nan.
    return np.array([MEASURES[m].measure(view) for m in np.flatnonzero(chosen).tolist()], np.float64)


def _as_tried(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return a config's values with only the outputs that are measured, and targets only in recipes without ``layers``.

    With targets of their own, these recipes are solved separately: solving them for what a mix lacks takes long.
    """
    disparity, recipes = dict(values["disparity"]), []
    target = disparity.pop("target")
    for recipe in values["scenes"]:
        of_own = "layers" not in recipe.get("particles", {})
        recipes.append(recipe | ({"disparity": {"target": target}} if of_own else {}))
    return {**values, "disparity": disparity, "scenes": recipes, "outputs": [], "truth": "left"}
