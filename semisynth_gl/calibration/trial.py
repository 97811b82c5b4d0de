"""Trial pairs: a few pairs of each recipe, rendered like the pairs of the dataset to come, and measured."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.calibration.draft import Draft
from semisynth_gl.calibration.style import BLURS, TEXELS, Trial, fitted_style, untried_style
from semisynth_gl.calibration.write import config_values
from semisynth_gl.config.load import parse_values
from semisynth_gl.judge.comparison import Values
from semisynth_gl.judge.measured_view import make_view, working_width
from semisynth_gl.judge.measures import MEASURES, measure_view
from semisynth_gl.listener import FinishedPair, Listener
from semisynth_gl.pairs.imperfections import Imperfections, apply_imperfections
from semisynth_gl.pairs.pipeline import Pair, PairRenderer
from semisynth_gl.seeds.seeds import Purpose, generator

_SEED = 0


def fit(draft: Draft, place: Values, pairs: int, listener: Listener) -> Draft:
    """Render trial pairs, and return the draft with the style whose pairs are nearest to a place.

    Args:
        draft: the draft of the config to come.
        place: measures of the place's pictures at the `working_width`.
        pairs: number of pairs of each recipe with each of `TEXELS`; each pair is measured with all `BLURS`.
        listener: hears the number of all trial pairs, and each finished pair.

    Raises:
        InputError: where inputs cannot be used.
        BackendError: where OpenGL cannot be used.
    """
    recipes, target = draft.recipes, draft.disparity.target
    cells = {f"{recipe.name}-{k}": (r, k) for r, recipe in enumerate(recipes) for k in range(len(TEXELS))}
    tried = [
        replace(recipes[r], name=name, keys={**recipes[r].keys, "textures": {"texels_per_pixel": list(TEXELS[k])}})
        for name, (r, k) in cells.items()
    ]
    values: list[list[list[NDArray[np.float64]]]] = [[[] for _ in TEXELS] for _ in recipes]
    shares = np.zeros((len(recipes), len(target.shares)))
    width_px = draft.size.width_px
    blur_scale = width_px / working_width(width_px)
    listener.on_total(pairs * len(cells))
    trial_values = _as_tried(config_values(replace(draft, tried=untried_style(tried))))
    with PairRenderer(parse_values(trial_values, "the trial's config", draft.overrides), _SEED) as renderer:
        for recipe, sampler in zip(renderer.sampler.recipes, renderer.sampler.samplers, strict=True):
            # Expected shares do not depend on texels.
            r, k = cells[str(recipe.name)]
            if k == 0 and recipe.config.particles.layers is not None:
                shares[r] = sampler.disparity_solver.expected().rebinned(target.edges_px).shares
        for number in range(pairs * len(cells)):
            # Skip the checks: redrawn scenes would have the same statistics.
            pair = renderer.render(number, checked=False)
            r, k = cells[pair.provenance["recipe"]]
            values[r][k].append(_blurred(pair, width_px, blur_scale))
            listener.on_pair(FinishedPair("train", number))
    shape = -1, len(BLURS), len(MEASURES)
    trial = Trial([[np.reshape(each, shape) for each in of_recipe] for of_recipe in values], shares, target.shares)
    return replace(draft, tried=fitted_style(recipes, trial, place, blur_scale))


def _blurred(pair: Pair, width_px: int, blur_scale: float) -> NDArray[np.float64]:
    """Return a trial pair's measures with each of `BLURS`, (B, M), nan where it has none."""
    view = pair.frame.left
    measured = make_view(working_width(width_px), view.image, view.disparity)
    of_map = measure_view(measured, [measure for measure in MEASURES if measure.of_maps])
    found = []
    for blur in BLURS:
        imperfections = Imperfections(blur * blur_scale, 0.0, 0.0, 1.0)
        image = apply_imperfections(view.image, imperfections, generator(_SEED, Purpose.IMPERFECTIONS, pair.index))
        blurred = replace(measured, luminance=make_view(working_width(width_px), image).luminance)
        measures = of_map | measure_view(blurred, [measure for measure in MEASURES if not measure.of_maps])
        found.append([measures.get(measure.key, np.nan) for measure in MEASURES])
    return np.array(found, np.float64)


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
