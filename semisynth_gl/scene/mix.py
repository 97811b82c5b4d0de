"""The scenes of a dataset, each sequence by the recipe that it takes."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from semisynth_gl.config.model import Config
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.geometry.model_library import ModelLibrary
from semisynth_gl.histogram import Histogram, mix_histograms
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.scene import Ints
from semisynth_gl.scene.depth_layers import merge_bins
from semisynth_gl.scene.population import InView
from semisynth_gl.scene.sampler import SampledScene, SceneSampler
from semisynth_gl.scene.scene import Motion, Scene
from semisynth_gl.seeds.seeds import Purpose, generator
from semisynth_gl.textures.atlas import Patch

# Sequences among which the first one of a recipe is sought.
_SOUGHT = 100_000
# Multiples of this number spread over [0, 1) almost as evenly as multiples of the golden ratio. Its root is unrelated
# to the roots that share out the numbers of particles: 221 is 13 times 17, and they are roots of primes.
_STEP = (221**0.5 - 11) / 10


class Shares:
    """Shares out sequences among recipes, so that successive sequences have each recipe as often as its share says.

    Shares, (R,), are above 0 and have the sum 1. The seed draws where the sequence of recipes begins.
    """

    def __init__(self, shares: Sequence[float], seed: int) -> None:
        self._ends = np.cumsum(shares)[:-1]
        self._first = generator(seed, Purpose.RECIPES).random()

    def recipe(self, sequence: int) -> int:
        """Return the number of a sequence's recipe."""
        return int(self._recipes(np.array(sequence)))

    def firsts(self) -> dict[int, int]:
        """Return the first sequence of each recipe by the recipe's number; recipes of a tiny share are left out."""
        numbers, sequences = np.unique(self._recipes(np.arange(_SOUGHT)), return_index=True)
        return dict(zip(numbers.tolist(), sequences.tolist(), strict=True))

    def _recipes(self, sequences: Ints) -> Ints:
        places: Ints = np.searchsorted(self._ends, (self._first + sequences * _STEP) % 1.0, side="right")
        return places


class MixSampler:
    """Samples the scenes of one dataset.

    A sequence's scene is the one that a config of its recipe alone, with the same seed, has for the same sequence; but
    where recipes state their layers or a target of their own, the others are solved for what the dataset's target then
    lacks.

    The libraries, one for each recipe, and the atlas's patches come from the same config and seed.
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
        # Those that `Scene.model` counts: the models of still things, then the models of all recipes.
        self.models: tuple[Mesh, ...] = self.samplers[0].models

    def sample(self, index: int, attempt: int = 0) -> SampledScene:
        """Sample the scene of pair ``index``; see `SceneSampler.sample`. All attempts take the same recipe."""
        sampler = self._sampler(index // self._sequence_pairs)
        with _named(sampler.recipe):
            return sampler.sample(index, attempt)

    def motion(self, sampled: SampledScene, frames: int) -> Motion:
        """Return the motion of a scene's instances; see `SceneSampler.motion`."""
        return self._sampler(sampled.sequence).motion(sampled, frames)

    def moment(self, sampled: SampledScene, frames: float) -> Scene:
        """Return a scene's instances at another moment; see `SceneSampler.moment`."""
        return self._sampler(sampled.sequence).moment(sampled, frames)

    def provenance(self, sampled: SampledScene) -> dict[str, Any]:
        """Return the origin of a pair's scene; see `SceneSampler.provenance`."""
        return self._sampler(sampled.sequence).provenance(sampled)

    def instance_table(self, sampled: SampledScene) -> list[dict[str, Any]]:
        """Return a row for each instance; see `SceneSampler.instance_table`."""
        return self._sampler(sampled.sequence).instance_table(sampled)

    def expected(self) -> Histogram:
        """Return the mean distribution of the disparities of the dataset's pairs; see `Population.expected`.

        `Population.expected` is for the longest baseline; this covers all of them, see `Config.across_baselines`.
        """
        both = zip(self.recipes, self.samplers, strict=True)
        parts = [(recipe.share, recipe.config.across_baselines(self._expected(sampler))) for recipe, sampler in both]
        if len(parts) == 1:
            return parts[0][1]
        return mix_histograms(parts, merge_bins(self._config.shown_histogram()).edges_px)

    def overview(self, pairs: int) -> list[int]:
        """Return the numbers of so many pairs, 1 or more, that show each recipe, in their order.

        They are the first pair of each recipe, the more frequent recipes before the others, and then the first pairs of
        the dataset that are not among these.
        """
        firsts = self._shares.firsts()
        frequent = sorted(firsts, key=lambda number: (-self.recipes[number].share, firsts[number]))
        chosen = [firsts[number] * self._sequence_pairs for number in frequent]
        return sorted(list(dict.fromkeys([*chosen, *range(pairs)]))[:pairs])

    def in_view(self) -> list[InView]:
        """Return what the pairs of each recipe show on average; see `Population.in_view`."""
        seen = []
        for sampler in self.samplers:
            with _named(sampler.recipe):
                seen.append(sampler.population.in_view())
        return seen

    def _expected(self, sampler: SceneSampler) -> Histogram:
        with _named(sampler.recipe):
            return sampler.population.expected()

    def _rest(self, others: Mapping[str | None, SceneSampler]) -> Histogram:
        """Return what the target of the mix lacks beside other recipes."""
        target = self._config.wanted_histogram()
        rest = target.shares.copy()
        for recipe in self.recipes:
            if recipe.name in others:
                rest -= recipe.share * self._expected(others[recipe.name]).rebinned(target.edges_px).shares
        # Where the others show more than is wanted of some disparities, no recipe can take that back.
        return Histogram.from_counts(target.edges_px, np.maximum(rest, 0))

    def _sampler(self, sequence: int) -> SceneSampler:
        return self.samplers[self._shares.recipe(sequence)]


@contextmanager
def _named(recipe: str | None) -> Iterator[None]:
    """Name the recipe in errors of its scenes."""
    try:
        yield
    except InputError as error:
        if recipe is None:
            raise
        raise InputError(f"recipe {recipe}: {error}") from None
