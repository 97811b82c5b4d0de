"""The scenes of a dataset with several recipes. Each sequence has one recipe."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np

from semisynth_gl.config.model import Config
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.geometry.model_library import ModelLibrary
from semisynth_gl.histogram import Histogram, mix_histograms
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.scene import Ints
from semisynth_gl.scene.depth_layers import merge_bins
from semisynth_gl.scene.sampler import SampledScene, SceneSampler
from semisynth_gl.seeds.seeds import Purpose, generator
from semisynth_gl.textures.atlas import Patch

# Number of sequences that are searched for the first one of each recipe.
_SOUGHT = 100_000
# Multiples of this number, modulo 1, spread over [0, 1) almost as evenly as multiples of the golden ratio. The root of
# 221 = 13 * 17 is unrelated to the roots of primes that share out the numbers of particles.
_STEP = (221**0.5 - 11) / 10


class Shares:
    """Shares out sequences among recipes: among successive sequences, each recipe is as frequent as its share says.

    The R ``shares`` are above 0 and add up to 1. The ``seed`` decides where the order of recipes begins.
    """

    def __init__(self, shares: Sequence[float], seed: int) -> None:
        self._ends = np.cumsum(shares)[:-1]
        self._first = generator(seed, Purpose.RECIPES).random()

    def recipes(self, sequences: Ints) -> Ints:
        """Return the numbers of the recipes of sequences, (N,) each."""
        return np.searchsorted(self._ends, (self._first + sequences * _STEP) % 1.0, side="right")


class MixSampler:
    """Samples the scenes of one dataset.

    A sequence has the scene that a config of only its recipe, with the same seed, has for that sequence. There is one
    exception: where some recipes state their layers or a target of their own, the remaining recipes are solved for the
    part of the dataset's target that these leave open.

    The libraries, one for each recipe, and the atlas's patches come from the same config and seed.

    Raises:
        InputError: where a recipe's target cannot be met.
    """

    def __init__(
        self, config: Config, seed: int, libraries: Sequence[ModelLibrary], patches: tuple[Patch, ...]
    ) -> None:
        self.recipes = config.recipes()
        self._config = config
        self._sequence_pairs = config.sequence_pairs
        self._shares = Shares([recipe.share for recipe in self.recipes], seed)
        made = list(zip(self.recipes, libraries, strict=True))

        def samplers(*, solved: bool, wanted: Histogram | None = None) -> dict[str | None, SceneSampler]:
            """Sample the recipes whose particles are solved for the target of the mix, or the other recipes."""
            return {
                recipe.name: SceneSampler(recipe.config, seed, library, patches, recipe.name, wanted)
                for recipe, library in made
                if solved == (recipe.config.particles.layers is None and recipe.config.disparity == config.disparity)
            }

        stated = samplers(solved=False)
        rest = self._rest(stated) if 0 < len(stated) < len(made) else None
        by_name = stated | samplers(solved=True, wanted=rest)
        self.samplers = tuple(by_name[recipe.name] for recipe in self.recipes)
        # The models that `Scene.model` refers to: the surface models, then the models of all recipes.
        self.models: tuple[Mesh, ...] = self.samplers[0].models

    def sample(self, index: int, attempt: int = 0) -> SampledScene:
        """Sample the scene of pair ``index``; see `SceneSampler.sample`. All attempts use the same recipe."""
        sampler = self._sampler(index // self._sequence_pairs)
        with _named(sampler.recipe):
            return sampler.sample(index, attempt)

    def expected(self) -> Histogram:
        """Return the mean distribution of the disparities of the dataset's pairs.

        It covers all baselines, see `Config.across_baselines`; `DisparitySolver.expected` covers the longest one.
        """
        both = zip(self.recipes, self.samplers, strict=True)
        parts = [(recipe.share, recipe.config.across_baselines(self._expected(sampler))) for recipe, sampler in both]
        if len(parts) == 1:
            return parts[0][1]
        return mix_histograms(parts, merge_bins(self._config.shown_histogram()).edges_px)

    def overview(self, pairs: int) -> list[int]:
        """Return the numbers of some ``pairs``, at least 1, that show as many recipes as possible, in ascending order.

        The first pair of each recipe is taken, and then the first of the dataset's other pairs. Recipes whose share is
        so tiny that the first 100,000 sequences have none of them are left out.
        """
        firsts = np.unique(self._shares.recipes(np.arange(_SOUGHT)), return_index=True)[1] * self._sequence_pairs
        return sorted(list(dict.fromkeys([*sorted(firsts.tolist()), *range(pairs)]))[:pairs])

    def _expected(self, sampler: SceneSampler) -> Histogram:
        with _named(sampler.recipe):
            return sampler.disparity_solver.expected()

    def _rest(self, others: Mapping[str | None, SceneSampler]) -> Histogram:
        """Return the part of the mix's target that other recipes leave open."""
        target = self._config.wanted_histogram()
        rest = target.shares.copy()
        for recipe in self.recipes:
            if recipe.name in others:
                rest -= recipe.share * self._expected(others[recipe.name]).rebinned(target.edges_px).shares
        # Where the other recipes show too much of some disparities, no recipe can take that back.
        return Histogram.from_counts(target.edges_px, np.maximum(rest, 0))

    def _sampler(self, sequence: int) -> SceneSampler:
        return self.samplers[int(self._shares.recipes(np.array(sequence)))]


@contextmanager
def _named(recipe: str | None) -> Iterator[None]:
    """Name the recipe in each InputError that its scenes raise."""
    try:
        yield
    except InputError as error:
        if recipe is None:
            raise
        raise InputError(f"recipe {recipe}: {error}") from None
