"""Trial pairs: a few pairs of each recipe, rendered as the dataset's would be, and measured."""

from dataclasses import replace

import numpy as np

from semisynth_gl.calibration.calibrate import ConfigFacts, config_text
from semisynth_gl.calibration.recipes import SceneRecipe
from semisynth_gl.calibration.style import BLURS, TEXELS, Style, Trial, fitted_style, untried_style
from semisynth_gl.comparison.measures import MEASURES
from semisynth_gl.comparison.picture import WORKING_WIDTH, make_picture
from semisynth_gl.comparison.sides import Side
from semisynth_gl.config import Config
from semisynth_gl.config.load import parse_config
from semisynth_gl.listener import FinishedPair, Listener
from semisynth_gl.pairs.imperfections import Imperfections, apply_imperfections
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.seeds import Purpose, generator

_SEED = 0


def tried_style(facts: ConfigFacts, place: Side, pairs: int, listener: Listener) -> Style:
    """Render pairs of each recipe with each of `TEXELS`, measure them with each of `BLURS`, and choose the best style.

    Args:
        facts: what the config is written from.
        place: the measures of the place.
        pairs: number of pairs of each recipe with each of `TEXELS`, at least 1.
        listener: hears the number of pairs, and each pair.

    Raises:
        InputError: where images, models or ranges cannot be used.
        BackendError: where OpenGL cannot be used.
    """
    # A blur of the image is less of one at the working width, if that is smaller.
    blur_scale = max(facts.size.width_px / WORKING_WIDTH, 1.0)
    return fitted_style(facts.recipes, _try(facts, pairs, blur_scale, listener), place, blur_scale)


def _try(facts: ConfigFacts, pairs: int, blur_scale: float, listener: Listener) -> Trial:
    recipes = facts.recipes
    cells = {f"{recipe.name}-{k}": (r, k) for r, recipe in enumerate(recipes) for k in range(len(TEXELS))}
    tried = [_with_texels(name, recipes[r], TEXELS[k]) for name, (r, k) in cells.items()]
    config = _each_by_itself(parse_config(config_text("trial", facts, untried_style(tried)), "the trial's config"))
    sums = np.zeros((len(recipes), len(TEXELS), len(BLURS), len(MEASURES)))
    counts = np.zeros(sums.shape, np.int64)
    total = pairs * len(cells)
    listener.on_total(total)
    with PairRenderer(config, _SEED) as renderer:
        for number in range(total):
            # Unchecked: a trial is no dataset, and what is drawn again for its checks is the same sort of scene.
            pair = renderer.render(number, checked=False)
            view, cell = pair.frame.left, cells[pair.provenance["recipe"]]
            sharp = make_picture(str(number), WORKING_WIDTH, disparity=view.disparity)
            for k, blur in enumerate(BLURS):
                drawn = Imperfections(blur * blur_scale, 0.0, 0.0, 1.0)
                image = apply_imperfections(view.image, drawn, generator(_SEED, Purpose.IMPERFECTIONS, number))
                picture = replace(sharp, luminance=make_picture("", WORKING_WIDTH, image=image).luminance)
                for m, measure in enumerate(MEASURES):
                    # What is measured in the map alone is worked out once.
                    value = measure.measure(picture) if k == 0 or not measure.of_maps else None
                    if value is not None:
                        sums[(*cell, k, m)] += value
                        counts[(*cell, k, m)] += 1
            listener.on_pair(FinishedPair("train", number))
    means = np.divide(sums, counts, out=np.full(sums.shape, np.nan), where=counts > 0)
    of_maps = [measure.of_maps for measure in MEASURES]
    means[..., of_maps] = means[:, :, :1, of_maps]
    return Trial(means, total)


def _each_by_itself(config: Config) -> Config:
    """Give each recipe that is solved the config's target for its own: the rest of a mix takes long to work out."""
    values = config.model_dump(mode="json")
    target = values["disparity"].pop("target")
    for recipe in values["scenes"]:
        if "layers" not in recipe.get("particles", {}):
            recipe["disparity"] = {"target": target}
    return Config.model_validate(values)


def _with_texels(name: str, recipe: SceneRecipe, texels: tuple[float, float]) -> SceneRecipe:
    return replace(recipe, name=name, keys={**recipe.keys, "textures": {"texels_per_pixel": list(texels)}})
