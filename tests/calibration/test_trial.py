"""The style that trials choose: by made-up measures, and told by a renderer that renders nothing."""

from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
from calibration_files import CAMERA, facts

from semisynth_gl.calibration import trial
from semisynth_gl.calibration.disparity_range import chosen_range
from semisynth_gl.calibration.recipes import TEXELS
from semisynth_gl.calibration.rig import Rig
from semisynth_gl.calibration.trial import BLURS, fitted_style
from semisynth_gl.histogram import Histogram
from semisynth_gl.judge.comparison import gather
from semisynth_gl.judge.measures import MEASURES
from semisynth_gl.listener import Listener

RECIPES = [{"recipe": name} for name in ("calm", "steep", "clutter")]


def place_of(**values):
    """A place with these numbers of each measure."""
    found = {measure.key: np.zeros(0) for measure in MEASURES}
    return found | {key: np.asarray(numbers, float) for key, numbers in values.items()}


def around(mean, deviation):
    """Six numbers, half of them to each side of their mean."""
    return mean + deviation * np.sqrt(5 / 6) * np.array([-1.0, 1.0] * 3)


def style_of(place, recipes=RECIPES, shares=((0.0,),), wanted=(1.0,), scale=1.0, **values):
    """The style by a trial of one pair with the measures given, each of a shape that goes to (recipes, texels, blurs).

    Its recipes show the ``shares`` of each bin, as far as they are given, and the others none.
    """
    means = np.full((len(recipes), len(TEXELS), 1, len(BLURS), len(MEASURES)), np.nan)
    for number, measure in enumerate(MEASURES):
        if measure.key in values:
            means[..., 0, :, number] = values[measure.key]
    found = np.zeros((len(recipes), len(wanted)))
    found[: len(shares)] = shares
    return fitted_style(recipes, means, found, np.array(wanted), place, scale)


def of_recipes(*values):
    return np.reshape(values, (-1, 1, 1))


def named(style, recipes=RECIPES):
    """The weight of each recipe."""
    by_name = {recipe["recipe"]: weight for recipe, weight in zip(style.recipes, style.weights, strict=True)}
    return [by_name.get(recipe["recipe"], 0.0) for recipe in recipes]


@pytest.mark.parametrize("weights", [(0.5, 0.3, 0.2), (0, 0.9, 0.1), (0.95, 0, 0.05), (0, 0, 1)])
def test_a_place_that_is_a_mix_gets_its_weights(weights):
    shown = {"jumps": (1.0, 2.0, 9.0), "slant": (0.01, 0.2, 0.05), "runs": (300.0, 200.0, 30.0)}
    # Twenty pictures, as many of each recipe's sort as it has twentieths.
    pictures = np.repeat(np.arange(3), np.rint(20 * np.array(weights)).astype(int))
    there = place_of(**{key: np.array(values)[pictures] for key, values in shown.items()})
    style = style_of(there, **{key: of_recipes(*values) for key, values in shown.items()})
    assert named(style) == pytest.approx(weights)


def test_a_mix_of_extremes_with_the_mean_of_a_place_is_not_chosen():
    # Two thirds of steep pictures and a third of clutter have the mean, one recipe has each picture.
    recipes = [*RECIPES[:2], {"recipe": "like the place"}, RECIPES[2]]
    style = style_of(place_of(jumps=around(2.0, 0.5)), recipes, jumps=of_recipes(1.0, 4.0, 2.0, 9.0))
    assert named(style, recipes)[2] > 0.8


def test_recipes_that_are_alike_get_even_weights():
    style = style_of(place_of(jumps=around(2.0, 0.5)), jumps=of_recipes(2.0, 2.0, 2.0))
    assert sorted(style.weights) == pytest.approx([0.3, 0.35, 0.35])


def test_clutter_is_in_every_mix_and_photographs_say_nothing_of_weights():
    values = {"jumps": of_recipes(1.0, 2.0, 9.0), "gradient": 10.0}
    assert style_of(place_of(jumps=around(0.1, 0.1)), **values).weights == (0.95, 0.05)
    style = style_of(place_of(gradient=[9]), **values)
    assert style.weights == pytest.approx([1 / 3] * 3)


def test_a_mix_shows_no_more_than_is_wanted_of_a_disparity():
    # The calm recipe has the place's jumps, and three times what is wanted of the far half.
    known = ((0.9, 0.1), (0.1, 0.9))
    weights = []
    for shares, wanted in ((known, (0.9, 0.1)), (known, (0.3, 0.7)), ((known[0],), (0.3, 0.7))):
        place = place_of(jumps=around(1.0, 3.0))
        style = style_of(place, shares=shares, wanted=wanted, jumps=of_recipes(1.0, 4.0, 9.0))
        weights.append(named(style))
        surplus = np.maximum(np.dot(weights[-1][: len(shares)], shares) - wanted, 0).sum()
        assert surplus < 0.06
    assert weights[0][0] > 0.6
    # What it shows too much of is left to those that are solved, and to others that show other disparities.
    assert max(weights[1][0], weights[2][0]) < 0.45


@pytest.mark.parametrize(("blur", "scale"), [*((blur, 1.0) for blur in BLURS), (0.3, 3.0)])
def test_the_blur_is_that_at_which_detail_is_the_places(blur, scale):
    detail = np.array([[0.9 - 0.5 * tried for tried in BLURS]])
    style = style_of(place_of(octaves=around(0.9 - 0.5 * blur, 0.01)), scale=scale, octaves=detail)
    assert style.blur_px == pytest.approx(blur * scale)


def test_blurred_texture_is_enlarged():
    style = style_of(place_of(gradient=around(10, 1)), gradient=np.reshape([20.0, 9.0], (1, 2, 1)))
    assert style.texels_per_pixel == TEXELS[1]


def test_each_pair_counts_for_its_recipe_and_texture_scale(monkeypatch):
    found, expected = [], Histogram.from_counts((0.0, 1000.0), [1.0])
    sampler = SimpleNamespace(disparity_solver=SimpleNamespace(expected=lambda: expected))

    def renderer(config, _):
        """Renders the recipes in turn; a pair shows its recipe's name and the number of its turn."""
        recipes = config.recipes()
        for each in (recipe.config for recipe in recipes):  # those without layers are solved for the target
            assert (each.disparity.target.form == "histogram") == (each.particles.layers is None)

        def render(number, checked):
            assert not checked
            turn, recipe = divmod(number, len(recipes))
            name = recipes[recipe].name
            return SimpleNamespace(provenance={"recipe": name}, value=10 * sum(name.encode()) + turn)

        samplers = SimpleNamespace(recipes=recipes, samplers=[sampler] * len(recipes))
        return nullcontext(SimpleNamespace(sampler=samplers, render=render))

    monkeypatch.setattr(trial, "PairRenderer", renderer)
    monkeypatch.setattr(trial, "_blurred", lambda pair, *_: np.full((len(BLURS), len(MEASURES)), float(pair.value)))
    monkeypatch.setattr(trial, "fitted_style", lambda _, values, *__: found.append(values))
    draft = facts(Rig(CAMERA, "calib.txt"), chosen_range(2, 90))
    trial.fit(draft, gather(()), 3, Listener())
    for recipe, values in zip(draft.style.recipes, found[0], strict=True):
        for scale, of_scale in enumerate(values):
            first = 10 * sum(f"{recipe['recipe']}-{scale}".encode())
            assert of_scale[:, 0, 0].tolist() == [first, first + 1, first + 2]
