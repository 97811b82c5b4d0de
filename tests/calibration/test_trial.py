"""The style that trials choose: by made-up measures, and told by a renderer that renders nothing."""

from types import SimpleNamespace

import numpy as np
import pytest

from semisynth_gl.calibration import trial
from semisynth_gl.calibration.disparity_range import chosen_range
from semisynth_gl.calibration.draft import Draft
from semisynth_gl.calibration.recipes import SceneRecipe
from semisynth_gl.calibration.rig import Rig
from semisynth_gl.calibration.style import BLURS, TEXELS, Trial, fitted_style, untried_style
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.histogram import Histogram
from semisynth_gl.judge.comparison import distance, gather
from semisynth_gl.judge.measures import MEASURES
from semisynth_gl.listener import Listener

RECIPES = tuple(SceneRecipe(name, "", {}) for name in ("calm", "steep", "clutter"))


def place_of(**values):
    """A place with these numbers of each measure."""
    found = {measure.key: np.zeros(0) for measure in MEASURES}
    return found | {key: np.asarray(numbers, float) for key, numbers in values.items()}


def around(mean, deviation):
    """Six numbers, half of them to each side of their mean."""
    return mean + deviation * np.sqrt(5 / 6) * np.array([-1.0, 1.0] * 3)


def trial_of(recipes, shares=((0.0,),), wanted=(1.0,), **values):
    """A trial of one pair with the measures given, each of a shape that goes to (recipes, texels, blurs).

    Its recipes show the ``shares`` of each bin, as far as they are given, and the others none.
    """
    means = np.full((recipes, len(TEXELS), 1, len(BLURS), len(MEASURES)), np.nan)
    for number, measure in enumerate(MEASURES):
        if measure.key in values:
            means[..., 0, :, number] = values[measure.key]
    found = np.zeros((recipes, len(wanted)))
    found[: len(shares)] = shares
    return Trial(means, found, np.array(wanted))


def of_recipes(*values):
    return np.reshape(values, (-1, 1, 1))


def named(style, recipes=RECIPES):
    """The weight of each recipe."""
    by_name = dict(zip((recipe.name for recipe in style.recipes), style.weights, strict=True))
    return [by_name.get(recipe.name, 0.0) for recipe in recipes]


@pytest.mark.parametrize("weights", [(0.5, 0.3, 0.2), (0, 0.9, 0.1), (0.95, 0, 0.05), (0, 0, 1)])
def test_a_place_that_is_a_mix_gets_its_weights(weights):
    shown = {"jumps": (1.0, 2.0, 9.0), "slant": (0.01, 0.2, 0.05), "runs": (300.0, 200.0, 30.0)}
    tried = trial_of(3, **{key: of_recipes(*values) for key, values in shown.items()})
    # Twenty pictures, as many of each recipe's sort as it has twentieths.
    pictures = np.repeat(np.arange(3), np.rint(20 * np.array(weights)).astype(int))
    there = place_of(**{key: np.array(values)[pictures] for key, values in shown.items()})
    style = fitted_style(RECIPES, tried, there, 1.0)
    assert named(style) == pytest.approx(weights)
    assert "depth jumps" in style.mix_origin
    assert "6 pairs" in style.mix_origin


def test_a_chosen_style_is_nearer_than_the_untried_one():
    tried = trial_of(3, jumps=of_recipes(1.0, 2.0, 9.0), octaves=np.array([[0.9, 0.7, 0.6, 0.5, 0.4]]))
    there = place_of(jumps=around(1.5, 0.5), octaves=around(0.6, 0.05))
    style = fitted_style(RECIPES, tried, there, 1.0)
    untried = np.repeat([1.0, 2.0, 9.0], 100)
    mix = np.repeat([1.0, 2.0, 9.0], np.rint(100 * np.array(named(style))).astype(int))
    assert distance(mix, there["jumps"]) < distance(untried, there["jumps"]) / 4
    assert style.blur_px == 0.3


def test_a_mix_of_extremes_with_the_mean_of_a_place_is_not_chosen():
    # Two thirds of steep pictures and a third of clutter have the mean, one recipe has each picture.
    recipes = (RECIPES[0], RECIPES[1], SceneRecipe("like the place", "", {}), RECIPES[2])
    tried = trial_of(4, jumps=of_recipes(1.0, 4.0, 2.0, 9.0))
    assert named(fitted_style(recipes, tried, place_of(jumps=around(2.0, 0.5)), 1.0), recipes)[2] > 0.8


def test_clutter_is_in_every_mix_and_photographs_say_nothing_of_weights():
    tried = trial_of(3, jumps=of_recipes(1.0, 2.0, 9.0), gradient=10.0)
    assert fitted_style(RECIPES, tried, place_of(jumps=around(0.1, 0.1)), 1.0).weights == (0.95, 0.05)
    style = fitted_style(RECIPES, tried, place_of(gradient=[9]), 1.0)
    assert style.weights == untried_style(RECIPES).weights == pytest.approx([1 / 3] * 3)
    assert style.mix_origin == "Equal weights: no disparity map says otherwise."


def test_a_mix_shows_no_more_than_is_wanted_of_a_disparity():
    # The calm recipe has the place's jumps, and three times what is wanted of the far half.
    known = ((0.9, 0.1), (0.1, 0.9))
    weights = []
    for shares, wanted in ((known, (0.9, 0.1)), (known, (0.3, 0.7)), ((known[0],), (0.3, 0.7))):
        tried = trial_of(3, shares, wanted, jumps=of_recipes(1.0, 4.0, 9.0))
        weights.append(named(fitted_style(RECIPES, tried, place_of(jumps=around(1.0, 3.0)), 1.0)))
        surplus = np.maximum(np.dot(weights[-1][: len(shares)], shares) - wanted, 0).sum()
        assert surplus < 0.06
    assert weights[0][0] > 0.6
    # What it shows too much of is left to those that are solved, and to others that show other disparities.
    assert max(weights[1][0], weights[2][0]) < 0.45


@pytest.mark.parametrize("scale", [1.0, 3.0])
@pytest.mark.parametrize("blur", BLURS)
def test_the_blur_is_that_at_which_detail_is_the_places(blur, scale):
    detail, borders = (np.array([[first - fall * tried for tried in BLURS]]) for first, fall in ((0.9, 0.5), (1, 0.4)))
    there = place_of(octaves=around(0.9 - 0.5 * blur, 0.01), border_hardness=around(1 - 0.4 * blur, 0.01))
    tried = trial_of(3, octaves=detail, border_hardness=borders)
    assert fitted_style(RECIPES, tried, there, scale).blur_px == pytest.approx(blur * scale)


def test_blurred_texture_is_enlarged():
    tried = trial_of(3, gradient=np.reshape([20.0, 9.0], (1, 2, 1)))
    assert fitted_style(RECIPES, tried, place_of(gradient=around(10, 1)), 1.0).texels_per_pixel == TEXELS[1]


class Renderer:
    """Renders the recipes in turn; what a pair would show is told by its recipe and number alone."""

    def __init__(self, config, _):
        self.recipes = config.recipes()
        expected = Histogram.from_counts((0.0, 1000.0), [1.0])
        sampler = SimpleNamespace(disparity_solver=SimpleNamespace(expected=lambda: expected))
        self.sampler = SimpleNamespace(recipes=self.recipes, samplers=[sampler] * len(self.recipes))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def render(self, number, *, checked):
        assert not checked
        name = self.recipes[number % len(self.recipes)].name
        return SimpleNamespace(provenance={"recipe": name}, value=shown(name) + number // len(self.recipes))


def shown(name):
    """The value of the first pair of a recipe of the trial, which is named by the recipe and its texture scale."""
    recipe, _, scale = name.rpartition("-")
    return 1000 * sum(recipe.encode()) + 100 * int(scale)


def test_each_pair_counts_for_its_recipe_and_texture_scale(monkeypatch):
    found = []
    monkeypatch.setattr(trial, "PairRenderer", Renderer)
    monkeypatch.setattr(trial, "_blurred", lambda pair, *_: np.full((len(BLURS), len(MEASURES)), float(pair.value)))
    monkeypatch.setattr(trial, "fitted_style", lambda _, result, *__: found.append(result))
    rig = Rig(StereoCamera.centred(640, 480, 700.0, 0.1, 0.0), "calib.txt")
    draft = Draft("x", [rig], chosen_range(2, 90), ["a"], 1, 1, 256)
    trial.fit(draft, gather(()), 4, Listener())
    [result] = found
    for recipe, values in zip(draft.recipes, result.values, strict=True):
        for scale, of_scale in enumerate(values):
            assert of_scale.shape == (4, len(BLURS), len(MEASURES))
            assert sorted(of_scale[:, 0, 0]) == [shown(f"{recipe.name}-{scale}") + number for number in range(4)]
