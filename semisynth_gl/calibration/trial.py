"""Trial pairs: a few pairs of each recipe, rendered as the dataset's would be, and measured."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.calibration.config_text import ConfigFacts, config_text
from semisynth_gl.calibration.style import BLURS, EXPOSURES, FLATS, TEXELS, Style, Trial, fitted_style, untried_style
from semisynth_gl.comparison.measured_view import MeasuredView, make_view, working_width
from semisynth_gl.comparison.measures import MEASURES
from semisynth_gl.comparison.sides import Side
from semisynth_gl.config import Config
from semisynth_gl.config.load import parse_config
from semisynth_gl.listener import FinishedPair, Listener
from semisynth_gl.pairs.imperfections import Imperfections, apply_imperfections
from semisynth_gl.pairs.pipeline import Pair, PairRenderer
from semisynth_gl.seeds.seeds import Purpose, generator

_SEED = 0


def tried_style(facts: ConfigFacts, place: Side, pairs: int, listener: Listener) -> Style:
    """Choose the best style by ``pairs`` pairs of each recipe with each of `TEXELS` and `FLATS`.

    Each pair is measured with each of `BLURS` and `EXPOSURES`. ``place`` has the measures of the place at the
    `working_width`. Raises InputError where inputs cannot be used, and BackendError where OpenGL cannot be.
    """
    return fitted_style(facts.recipes, _try(facts, pairs, listener), place, _blur_scale(facts.size.width_px))


def _blur_scale(width_px: int) -> float:
    """Return the pixels of an image for one of the working width, at which a blur of the image is less of one."""
    return width_px / working_width(width_px)


def _try(facts: ConfigFacts, pairs: int, listener: Listener) -> Trial:
    recipes = facts.recipes
    cells = {f"{recipe.name}-{k}": (r, k) for r, recipe in enumerate(recipes) for k in range(len(TEXELS))}
    tried = [
        replace(recipes[r], name=name, keys={**recipes[r].keys, "textures": {"texels_per_pixel": list(TEXELS[k])}})
        for name, (r, k) in cells.items()
    ]
    style = untried_style(tried)
    sums = np.zeros((len(recipes), len(TEXELS), len(FLATS), len(BLURS), len(EXPOSURES), len(MEASURES)))
    counts = np.zeros(sums.shape, np.int64)
    geometry: list[list[NDArray[np.float64]]] = [[] for _ in recipes]
    target = facts.disparity.target
    shares = np.zeros((len(recipes), len(target.shares)))
    each = pairs * len(cells)
    listener.on_total(each * len(FLATS))
    for f, flat in enumerate(FLATS):
        text = config_text("trial", facts, replace(style, flat_share=flat))
        with PairRenderer(_as_tried(parse_config(text, "the trial's config")), _SEED) as renderer:
            for recipe, sampler in zip(renderer.sampler.recipes, renderer.sampler.samplers, strict=True):
                # Neither texels nor flat surfaces move them.
                r, k = cells[str(recipe.name)]
                if k == f == 0 and recipe.config.particles.layers is not None:
                    shares[r] = sampler.population.expected().rebinned(target.edges_px).shares
            for number in range(f * each, (f + 1) * each):
                # Unchecked: a trial is no dataset, and what is drawn again for its checks is the same sort of scene.
                pair = renderer.render(number, checked=False)
                r, k = cells[pair.provenance["recipe"]]
                values = _looks(pair, facts.size.width_px)
                there = np.isfinite(values)
                geometry[r].append(values[0, 0])
                sums[r, k, f] += np.where(there, values, 0)
                counts[r, k, f] += there
                listener.on_pair(FinishedPair("train", number))
    means = np.divide(sums, counts, out=np.full(sums.shape, np.nan), where=counts > 0)
    return Trial(means, tuple(map(np.array, geometry)), each * len(FLATS), shares, target.shares)


def _looks(pair: Pair, width_px: int) -> NDArray[np.float64]:
    """Return the measures of a trial pair, (B, E, M), nan where it does not have them; see `Trial`."""
    view = pair.frame.left
    values = np.full((len(BLURS), len(EXPOSURES), len(MEASURES)), np.nan)
    of_maps = np.array([measure.of_maps for measure in MEASURES])
    measured = make_view(str(pair.index), working_width(width_px), image=view.image, disparity=view.disparity)
    # What is measured in the map alone is worked out once.
    values[..., of_maps] = _measured(measured, of_maps)
    for b, blur in enumerate(BLURS):
        drawn = Imperfections(blur * _blur_scale(width_px), 0.0, 0.0, 1.0)
        image = apply_imperfections(view.image, drawn, generator(_SEED, Purpose.IMPERFECTIONS, pair.index))
        blurred = measured.with_image(image)
        for e, stops in enumerate(EXPOSURES):
            values[b, e, ~of_maps] = _measured(blurred.exposed(stops), ~of_maps)
    return values


def _measured(view: MeasuredView, chosen: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return some of the measures of a view, nan where it does not have them."""
    # As float64, None is nan.
    return np.array([MEASURES[m].measure(view) for m in np.flatnonzero(chosen).tolist()], np.float64)


def _as_tried(config: Config) -> Config:
    """Draw no more than is measured, and give each recipe that is solved the config's target for its own.

    The rest of a mix takes long to work out.
    """
    values = config.model_dump(mode="json") | {"outputs": [], "truth": "left"}
    target = values["disparity"].pop("target")
    for recipe in values["scenes"]:
        if "layers" not in recipe.get("particles", {}):
            recipe["disparity"] = {"target": target}
    return Config.model_validate(values)
