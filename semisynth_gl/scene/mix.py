"""Samples the scenes of a dataset with one or more recipes. Each sequence has one recipe."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np

from semisynth_gl.config import Config
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.geometry.model_library import ModelLibrary
from semisynth_gl.histogram import Histogram
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.scene import Ints
from semisynth_gl.scene.depth_layers import merge_bins
from semisynth_gl.scene.sampler import SampledScene, SceneSampler
from semisynth_gl.seeds.seeds import Purpose, generator
from semisynth_gl.textures.atlas import Patch

# Number of sequences among which `overview` finds the first of each recipe.
_SEARCHED = 100_000
# Multiples of this number, modulo 1, are spread over [0, 1) almost as evenly as multiples of the golden ratio. The root
# of 221 = 13 * 17 is independent of the roots of primes that spread the numbers of particles; see `disparity_solver`.
_STEP = (221**0.5 - 11) / 10


def recipe_numbers(sequences: Ints, shares: Sequence[float], seed: int) -> Ints:
    """Return the number of each sequence's recipe, (N,), for the numbers of sequences (N,).

    In any run of successive sequences, the frequencies of the recipes are close to their ``shares``, which are above 0
    and add up to 1. The ``seed`` decides where the order of recipes begins.
    """
    first = generator(seed, Purpose.RECIPES).random()
    return np.searchsorted(np.cumsum(shares)[:-1], (first + sequences * _STEP) % 1.0, side="right")


class RecipeMixSampler:
    """Samples the scenes of one dataset, each sequence of one recipe.

    Sequence s of a mix equals sequence s of a dataset that has only its recipe, with the same seed. The exception is a
    mix in which some recipes state their depth layers, or have another target than the dataset. The scenes of these
    recipes supply a part of the dataset's target, and the other recipes are solved for the rest.

    The libraries, one for each recipe, and the atlas's patches come from the same config and seed. ``samplers`` has the
    sampler of each recipe. `Scene.model` indexes ``models``: the surface models, then the models of all recipes.

    Raises:
        InputError: where a recipe's target cannot be met.
    """

    def __init__(
        self, config: Config, seed: int, libraries: Sequence[ModelLibrary], patches: tuple[Patch, ...]
    ) -> None:
        self.recipes, self._config, self._seed = config.recipes(), config, seed

        def samplers(wanted: Histogram | None = None, *, solved: bool) -> dict[int, SceneSampler]:
            """Make the samplers, by number, of the recipes that are (or are not) solved for the dataset's target."""
            return {
                number: SceneSampler(recipe.config, seed, libraries[number], patches, recipe.name, wanted)
                for number, recipe in enumerate(self.recipes)
                if solved == (recipe.config.particles.layers is None and recipe.config.disparity == config.disparity)
            }

        made = samplers(solved=False)
        made |= samplers(self._rest_of_target(made) if 0 < len(made) < len(self.recipes) else None, solved=True)
        self.samplers = tuple(made[number] for number in range(len(made)))
        self.models: tuple[Mesh, ...] = self.samplers[0].models

    def sample(self, index: int, attempt: int = 0) -> SampledScene:
        """Sample the scene of pair ``index``; see `SceneSampler.sample`. All attempts use the same recipe."""
        sampler = self.samplers[int(self._recipes(np.array(index // self._config.sequence_pairs)))]
        with _naming_errors(sampler.recipe):
            return sampler.sample(index, attempt)

    def expected(self) -> Histogram:
        """Return the expected distribution of disparity over all pairs of the dataset and all baselines."""
        both = zip(self.recipes, self.samplers, strict=True)
        parts = [(recipe.share, recipe.config.across_baselines(_expected(sampler))) for recipe, sampler in both]
        if len(parts) == 1:
            return parts[0][1]
        edges_px = merge_bins(self._config.shown_histogram()).edges_px
        return Histogram.from_counts(edges_px, sum(share * part.rebinned(edges_px).shares for share, part in parts))

    def overview(self, pairs: int) -> list[int]:
        """Return the ascending numbers of ``pairs`` pairs, at least 1, that show as many recipes as possible.

        These are the first pair of each recipe, and then the dataset's first pairs. A recipe that none of the first
        100,000 sequences has is ignored.
        """
        firsts = np.unique(self._recipes(np.arange(_SEARCHED)), return_index=True)[1]
        firsts = np.sort(firsts) * self._config.sequence_pairs
        return sorted(list(dict.fromkeys([*firsts.tolist(), *range(pairs)]))[:pairs])

    def _recipes(self, sequences: Ints) -> Ints:
        return recipe_numbers(sequences, [recipe.share for recipe in self.recipes], self._seed)

    def _rest_of_target(self, samplers: Mapping[int, SceneSampler]) -> Histogram:
        """Return the part of the dataset's target that the scenes of some samplers, by number, do not supply."""
        target = self._config.wanted_histogram()
        rest = target.shares.copy()
        for number, sampler in samplers.items():
            rest -= self.recipes[number].share * _expected(sampler).rebinned(target.edges_px).shares
        # Where these scenes show more of a disparity than the whole target, no other recipe can compensate.
        return Histogram.from_counts(target.edges_px, np.maximum(rest, 0))


def _expected(sampler: SceneSampler) -> Histogram:
    with _naming_errors(sampler.recipe):
        return sampler.disparity_solver.expected()


@contextmanager
def _naming_errors(recipe: str | None) -> Iterator[None]:
    """Put the recipe's name in front of the messages of InputErrors."""
    try:
        yield
    except InputError as error:
        if recipe is None:
            raise
        raise InputError(f"recipe {recipe}: {error}") from None
