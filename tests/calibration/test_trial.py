"""The mix that trials choose, from made-up measures and with a fake renderer."""

from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
from calibration_files import CAMERA, draft

from semisynth_gl.calibration import trial
from semisynth_gl.calibration.disparity_range import chosen_range
from semisynth_gl.calibration.draft import TEXELS
from semisynth_gl.calibration.rig import RectifiedRig
from semisynth_gl.calibration.trial import BLURS, nearest_mix
from semisynth_gl.histogram import Histogram
from semisynth_gl.judge.comparison import gather
from semisynth_gl.judge.measure_input import working_width
from semisynth_gl.judge.measures import MEASURES
from semisynth_gl.listener import Listener


def place_of(**values):
    """Return a place with these values of some measures."""
    found = {measure.key: np.zeros(0) for measure in MEASURES}
    return found | {key: np.asarray(numbers, float) for key, numbers in values.items()}


def around(mean, deviation):
    """Return six numbers with this mean and standard deviation, three on each side of the mean."""
    return mean + deviation * np.sqrt(5 / 6) * np.array([-1.0, 1.0] * 3)


def choose_mix(place, recipes=3, shares=((0.0,),), wanted=(1.0,), **values):
    """Choose the mix from one pair's measures, whose arrays broadcast to (recipes, texels, blurs).

    The first recipes show the given ``shares`` of each bin; the last recipe is clutter.
    """
    means = np.full((recipes, len(TEXELS), 1, len(BLURS), len(MEASURES)), np.nan)
    for number, measure in enumerate(MEASURES):
        if measure.key in values:
            means[..., 0, :, number] = values[measure.key]
    found = np.zeros((recipes, len(wanted)))
    found[: len(shares)] = shares
    return nearest_mix(means, found, np.array(wanted), place)


def of_recipes(*values):
    return np.reshape(values, (-1, 1, 1))


@pytest.mark.parametrize("weights", [(0.5, 0.3, 0.2), (0, 0.9, 0.1), (0.95, 0, 0.05), (0, 0, 1)])
def test_a_place_that_is_a_mix_gets_its_weights(weights):
    shown = {"jumps": (1.0, 2.0, 9.0), "slant": (0.01, 0.2, 0.05), "runs": (300.0, 200.0, 30.0)}
    # Twenty pictures like the recipes', in proportion to the weights.
    pictures = np.repeat(np.arange(3), np.rint(20 * np.array(weights)).astype(int))
    there = place_of(**{key: np.array(values)[pictures] for key, values in shown.items()})
    found, _, _ = choose_mix(there, **{key: of_recipes(*values) for key, values in shown.items()})
    assert found == pytest.approx(weights)


def test_a_mix_of_extremes_with_the_mean_of_a_place_is_not_chosen():
    # A mix of calm and steep recipes has the place's mean, but only the third recipe is like each picture.
    weights, _, _ = choose_mix(place_of(jumps=around(2.0, 0.5)), 4, jumps=of_recipes(1.0, 4.0, 2.0, 9.0))
    assert weights[2] > 0.8


def test_recipes_that_are_alike_get_even_weights():
    weights, _, _ = choose_mix(place_of(jumps=around(2.0, 0.5)), jumps=of_recipes(2.0, 2.0, 2.0))
    assert sorted(weights) == pytest.approx([0.3, 0.35, 0.35])


def test_clutter_is_in_every_mix_and_photographs_say_nothing_of_weights():
    values = {"jumps": of_recipes(1.0, 2.0, 9.0), "gradient": 10.0}
    assert choose_mix(place_of(jumps=around(0.1, 0.1)), **values)[0] == pytest.approx([0.95, 0, 0.05])
    assert choose_mix(place_of(gradient=[9]), **values)[0] == pytest.approx([1 / 3] * 3)


def test_a_mix_shows_no_more_than_is_wanted_of_a_disparity():
    # The calm recipe has the place's jumps, but in two cases shows three times the wanted share of the far bin.
    known = ((0.9, 0.1), (0.1, 0.9))
    weights = []
    for shares, wanted in ((known, (0.9, 0.1)), (known, (0.3, 0.7)), ((known[0],), (0.3, 0.7))):
        place = place_of(jumps=around(1.0, 3.0))
        found, _, _ = choose_mix(place, shares=shares, wanted=wanted, jumps=of_recipes(1.0, 4.0, 9.0))
        assert np.maximum(np.dot(found[: len(shares)], shares) - wanted, 0).sum() < 0.06
        weights.append(found[0])
    assert weights[0] > 0.6
    # In these cases, the mix gives its weight to other recipes.
    assert max(weights[1:]) < 0.45


def test_the_blur_is_that_at_which_detail_is_the_places():
    detail = np.array([[0.9 - 0.5 * tried for tried in BLURS]])
    for number, blur in enumerate(BLURS):
        assert choose_mix(place_of(octaves=around(0.9 - 0.5 * blur, 0.01)), octaves=detail)[2] == number


def test_blurred_texture_is_enlarged():
    found = choose_mix(place_of(gradient=around(10, 1)), gradient=np.reshape([20.0, 9.0], (1, 2, 1)))
    assert found[1] == 1


def test_each_pair_counts_for_its_recipe_and_texture_scale(monkeypatch):
    found, expected = [], Histogram.from_counts((0.0, 1000.0), [1.0])
    sampler = SimpleNamespace(disparity_solver=SimpleNamespace(expected=lambda: expected))

    def renderer(config, _):
        """Return a fake renderer whose pairs encode the recipe's name and the pair's number in it."""
        recipes = config.recipes()
        for each in (recipe.config for recipe in recipes):  # the solver needs a target for recipes without layers
            assert (each.disparity.target.form == "histogram") == (each.particles.layers is None)

        def render(number, checked):
            assert not checked
            turn, recipe = divmod(number, len(recipes))
            name = recipes[recipe].name
            return SimpleNamespace(provenance={"recipe": name}, value=10 * sum(name.encode()) + turn)

        samplers = SimpleNamespace(recipes=recipes, samplers=[sampler] * len(recipes))
        return nullcontext(SimpleNamespace(sampler=samplers, render=render))

    monkeypatch.setattr(trial, "PairRenderer", renderer)
    monkeypatch.setattr(
        trial, "_measures_by_blur", lambda pair, *_: np.full((len(BLURS), len(MEASURES)), float(pair.value))
    )
    mix = np.array([0.25, 0.75, *[0.0] * 3])

    def nearest(values, *_):
        found.extend(values)
        return mix[: len(values)], 1, 3

    monkeypatch.setattr(trial, "nearest_mix", nearest)
    before = draft(RectifiedRig(CAMERA, "calib.txt"), chosen_range(2, 90))
    after = trial.fit(before, gather(()), 3, Listener())
    scenes = before.sections["scenes"]
    for scene, values in zip(scenes, found, strict=True):
        for scale, of_scale in enumerate(values):
            first = 10 * sum(f"{scene['recipe']}-{scale}".encode())
            assert [each[0, 0] for each in of_scale] == [first, first + 1, first + 2]
    # The draft drops recipes of weight 0, and scales the blur from the working width to the rig's.
    assert after.sections["scenes"] == [scenes[0] | {"weight": 0.25}, scenes[1] | {"weight": 0.75}]
    assert after.sections["textures"] == before.sections["textures"] | {"texels_per_pixel": [*TEXELS[1]]}
    assert after.sections["imperfections"]["blur_px"] == pytest.approx(BLURS[3] * 741 / working_width(741), rel=0.05)
