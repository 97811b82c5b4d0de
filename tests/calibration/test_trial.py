"""Which cell of a trial each pair is measured for, told by a renderer that renders nothing."""

from types import SimpleNamespace

import numpy as np
import pytest

from semisynth_gl.calibration import trial
from semisynth_gl.calibration.disparity_range import chosen_range
from semisynth_gl.calibration.draft import Draft
from semisynth_gl.calibration.rig import Rig
from semisynth_gl.calibration.style import BLURS, EXPOSURES, TEXELS
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.histogram import Histogram
from semisynth_gl.judge.comparison import Side
from semisynth_gl.judge.measures import MEASURES
from semisynth_gl.listener import Listener


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
    looks = len(BLURS), len(EXPOSURES), len(MEASURES)
    monkeypatch.setattr(trial, "_looks", lambda pair, _: np.full(looks, float(pair.value)))
    monkeypatch.setattr(trial, "fitted_style", lambda _, result, *__: found.append(result))
    rig = Rig(StereoCamera.centred(640, 480, 700.0, 0.1, 0.0), "calib.txt")
    draft = Draft("x", [rig], chosen_range(2, 90), ["a"], 1, 1, 256)
    heard = []
    listener = Listener()
    monkeypatch.setattr(listener, "on_total", heard.append)
    trial.fit(draft, Side({}), 4, listener)
    [result] = found
    cells = len(draft.recipes) * len(TEXELS)
    assert heard == [result.pairs] == [4 * cells]
    for number, recipe in enumerate(draft.recipes):
        # Four pairs of each cell, whose values rise by 1: 1.5 above the first one in the mean.
        firsts = [shown(f"{recipe.name}-{scale}") for scale in range(len(TEXELS))]
        for scale, first in enumerate(firsts):
            assert result.means[number, scale] == pytest.approx(np.full(looks, first + 1.5))
        values = [first + more for first in firsts for more in range(4)]
        assert sorted(result.geometry[number][:, 0]) == values
