"""Finds how many particles each depth layer of a scene needs for the dataset's wanted distribution of disparity.

The wanted histogram is merged into at most 48 bins, and each bin has a depth layer. `semisynth_gl.scene.depth_layers`
finds a layer's coverage lambda: how many of its particles cover a pixel, on average. This module computes numbers of
particles in five steps:

1. Pilots. 32 scenes without particles represent the static scenes of the dataset.
2. Aim. All scenes are solved for the same distribution, the aim, each scene separately. The first aim is the target. A
   scene with a near wall cannot show the far part of the target, so the mean of the solved pilots differs from the
   target. Each further aim adds  target - mean of the solved pilots  to the aim before it. Of 6 aims, the one whose
   solved pilots have the mean nearest the target is used.
3. Numbers. One particle adds c = A / R to the coverage, where A px^2 is the mean area of its silhouette and R px^2 the
   area of the region through which it falls (`expected_cover`). So a layer has n = lambda / c particles on average.
4. Sizes. c grows with the square of the sizes, so larger particles need smaller numbers. If ``particles.density`` is
   sparse or dense, a bisection finds the factor of the sizes with which the wanted number of particles is in view.
   Particles are also enlarged where the sum of all n exceeds ``particles.most``.
5. Counts. In sequence s, layer k has the quantile u = (u_0 + s * sqrt(p_k)) mod 1 of the Poisson distribution with the
   mean n. p_k is the layer's prime, and u_0 comes from the seed. Multiples of an irrational number are spread evenly
   over [0, 1), so the mean of few scenes is much closer to n than with independent samples.

If the config states ``particles.layers``, these take the place of the solved layers. The particles of
``particles.clutter`` are always added; the solver treats them as part of the background.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from semisynth_gl.cache import CacheEntry, cached
from semisynth_gl.config import Config, Range
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.geometry.relief import MeanModelRelief
from semisynth_gl.histogram import Histogram
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.scene import Floats, Ints
from semisynth_gl.scene.catalogue import ModelCatalogue
from semisynth_gl.scene.depth_layers import DepthLayers, expected_shares, merge_bins, solve_coverage
from semisynth_gl.scene.particles import ParticleLayer, ParticleSizes, expected_cover, expected_in_view, stated_sizes
from semisynth_gl.scene.rig import SequenceRig
from semisynth_gl.scene.static_scene import sample_static_scene
from semisynth_gl.seeds.seeds import Purpose, generator

# Number of pilot scenes.
_PILOTS = 32
# The sections that `sample_static_scene` reads, and the purposes for which it asks for a generator.
_SECTIONS = {"camera", "rig", "disparity", "background", "room", "street", "structures"}
_PURPOSES = (Purpose.CAMERA, Purpose.BACKGROUND, Purpose.STRUCTURES, Purpose.SWAY, Purpose.RIG, Purpose.SKY)
# Number of pilot scenes in which particles are counted to find the factor of sizes for a density.
_COUNTED_PILOTS = 8
# Number of aims that are tried.
_AIMS = 6
# Number of particles in view for each density, relative to the number at the stated sizes.
_DENSITY = {"sparse": 1 / 3, "dense": 3.0}
# Smallest factor of the stated sizes.
_SMALLEST = 0.05
# Maximum of the mean number of particles in one scene, as a multiple of particles.most.
_BEYOND_MOST = 2.0
# Maximum number of times that particles are enlarged, until particles.most of them suffice.
_ENLARGEMENTS = 12
# Number of bisections in the search for a factor of sizes.
_HALVINGS = 10
# The roots of primes are linearly independent over the rationals. There are 50 primes, for at most 48 layers.
_PRIMES = np.array([n for n in range(2, 230) if all(n % k for k in range(2, n))], np.float64)
# Minimum factor by which a correction multiplies the aim's share in a bin, so that no share falls to 0 or below.
_LEAST_OF_AIM = 0.1
# Minimum coverage of the layer with the background's median disparity, so that each background has particles near it.
_POPULATED = 0.5


class PilotScene(NamedTuple):
    """A pilot scene: a static scene, without particles."""

    camera: StereoCamera
    bare_px: Floats  # (R,) disparities of the left view without particles, on the coarse grid of `grid_px`


class _Views(NamedTuple):
    """The effect of particles in K layers on V views; `depth_layers` defines the symbols."""

    bare: Floats  # (V, K - 1) F_bare: share of the view below each inner edge of the bins, without solved particles
    exceedances: Floats  # (V, K, K - 1) S: see `DepthLayers.exceedance`
    least: Floats  # (V, K) smallest coverages
    cover: Floats  # (V, K) c: coverage that one particle adds


class _Aim(NamedTuple):
    """The distribution that each scene is solved for, so that the mean of all scenes is near the target."""

    shares: Floats  # (K,) in the target's bins
    achieved: Floats  # (K,) mean shares in the pilots that are solved for this aim
    sizes: ParticleSizes  # sizes of the particles


class DisparitySolver:
    """Solves for the numbers of particles in the scenes of one recipe of a dataset.

    ``relief`` is the mean relief of the models. ``catalogue`` has the models of pilot scenes. ``wanted`` is the
    wanted distribution, by default the config's. ``target`` is the wanted distribution in the depth layers' bins.
    """

    def __init__(
        self,
        config: Config,
        seed: int,
        relief: MeanModelRelief,
        catalogue: ModelCatalogue,
        wanted: Histogram | None = None,
    ) -> None:
        self._config, self._seed, self._relief, self._catalogue = config, seed, relief, catalogue
        configured, particles = config.wanted_histogram(), config.particles
        self.target = merge_bins(wanted or configured)
        self._solved = particles.layers is None
        middle = Range(configured.quantile(0.1), configured.quantile(0.9))
        self._stated_layers = [
            (layer.disparity_px or middle, layer.count, stated_sizes(particles, layer))
            for layer in (*(particles.layers or ()), *particles.clutter)
        ]
        low_px = np.maximum(self.target.edges_px[:-1], config.disparity.min_px)
        high_px = np.minimum(self.target.edges_px[1:], config.disparity.max_px)
        self._layers = DepthLayers(low_px, np.maximum(low_px, high_px))
        self._first_quantile = generator(seed, Purpose.COUNTS).random(len(self._layers))

    def sample(
        self, sequence: int, camera: StereoCamera, bare_px: Floats, rng: np.random.Generator
    ) -> list[ParticleLayer]:
        """Sample the numbers of particles of one scene.

        ``bare_px`` (R,) has the disparities of the scene's left view without particles. ``rng`` samples only the
        particle counts of stated layers and clutter.

        Raises:
            InputError: where disparity + doffs is not positive for a stated layer or clutter, or the target cannot be
                met with ``particles.most`` particles.
        """
        least_px = min((disparity_px.low for disparity_px, *_ in self._stated_layers), default=np.inf)
        if least_px + camera.doffs_px <= 0:
            raise InputError(
                f"particles: the disparity {least_px:g} px of a layer has no depth, since disparity + doffs must be "
                f"positive, and doffs is {camera.doffs_px:g} px: give each layer a disparity_px above "
                f"{-camera.doffs_px:g}"
            )
        solved = list[ParticleLayer]()
        if self._solved:
            quantile = (self._first_quantile + sequence * np.sqrt(_PRIMES[: len(self._layers)])) % 1.0
            sizes = self._aim.sizes
            views = self._views([(camera, bare_px)], sizes)
            mean = (self._coverage(self._aim.shares, views) / views.cover)[0]
            # Avoid huge counts, which `sample_slots` would reduce to particles.most anyway.
            mean *= min(1.0, _BEYOND_MOST * self._config.particles.most / max(float(mean.sum()), 1.0))
            layers = zip(self._layers.low_px, self._layers.high_px, poisson_counts(mean, quantile), strict=True)
            solved = [ParticleLayer(Range(low, high), int(count), sizes) for low, high, count in layers]
        return solved + [ParticleLayer(px, round(count.sample(rng)), sizes) for px, count, sizes in self._stated_layers]

    def expected(self) -> Histogram:
        """Return the distribution, in the bins of ``target``, that the Boolean model predicts for the pilot scenes.

        Raises InputError where the target cannot be met, see `sample`.
        """
        if self._solved:
            return Histogram.from_counts(self.target.edges_px, self._aim.achieved)
        below = np.mean([self._bare_shares(camera, bare_px) for camera, bare_px in self._pilots], axis=0)
        return Histogram.from_counts(self.target.edges_px, np.diff(np.concatenate([[0.0], below, [1.0]])))

    @cached_property
    def _aim(self) -> _Aim:
        """The aim of all scenes, with the sizes of ``particles.density``."""
        density, sizes = self._config.particles.density, stated_sizes(self._config.particles)
        if density != "default":
            sizes = sizes.scaled(self._size_factor(sizes, _DENSITY[density] * self._in_view(sizes)))
        return self._best_aim(sizes)

    def _size_factor(self, sizes: ParticleSizes, number: float) -> float:
        """Return the factor of the sizes with which about ``number`` particles are in the left view, on average."""
        # With the largest factor, the largest particles of the nearest layer are as wide as the image.
        camera = self._pilots[0].camera
        largest_px = float(sizes.radius_px(camera, np.array(self._layers.high_px.max()), np.array(1.0)))
        low, high = _SMALLEST, max(1.0, camera.width_px / 2 / largest_px)
        for _ in range(_HALVINGS):
            # The number of particles in view is about proportional to 1 / size^2.
            middle = (low * high) ** 0.5
            low, high = (middle, high) if self._in_view(sizes.scaled(middle)) > number else (low, middle)
        return float((low * high) ** 0.5)

    def _best_aim(self, sizes: ParticleSizes) -> _Aim:
        """Return the best of 6 aims: step 2 of the module's text. Raises InputError as `_enlarged` does."""
        wanted = self.target.shares
        sizes, views = self._enlarged(sizes)
        aims, shares = [], wanted
        for _ in range(_AIMS):
            coverage = self._coverage(shares, views)
            achieved = expected_shares(coverage, views.bare, views.exceedances).mean(axis=0)
            aims.append(_Aim(shares, achieved, sizes))
            shares = np.maximum(shares + wanted - achieved, _LEAST_OF_AIM * shares)
            shares = shares / shares.sum()
        return min(aims, key=lambda aim: float(np.abs(aim.achieved - wanted).sum()))

    def _enlarged(self, sizes: ParticleSizes) -> tuple[ParticleSizes, _Views]:
        """Enlarge particles until the pilots need at most ``particles.most`` of them on average.

        Returns the sizes, and the effect of such particles on the pilots. Raises InputError where 12 enlargements do
        not suffice.
        """
        most = self._config.particles.most
        for _ in range(_ENLARGEMENTS):
            views = self._views(self._pilots, sizes)
            number = float((self._coverage(self.target.shares, views) / views.cover).sum(axis=1).mean())
            if number <= most:
                return sizes, views
            sizes = sizes.scaled(1.05 * (number / most) ** 0.5)
        raise InputError(
            f"disparity.target needs about {number:.0f} particles a scene, however large they are, but "
            f"particles.most allows {most}: raise particles.most"
        )

    def _coverage(self, shares: Floats, views: _Views) -> Floats:
        """Return the mean coverages, (V, K), rounded because processors differ in the last digits."""
        coverage = solve_coverage(shares, views.bare, views.exceedances, views.least, self._layers.has_room)
        return np.round(coverage, 9)

    def _in_view(self, sizes: ParticleSizes) -> float:
        """Return the mean number of particles in the left views of the first 8 pilot scenes."""
        pilots, layers, in_view = self._pilots[:_COUNTED_PILOTS], self._layers, []
        views = self._views(pilots, sizes)
        numbers = self._coverage(self.target.shares, views) / views.cover
        for number, (camera, _) in zip(numbers, pilots, strict=True):
            # Particles that would cross the near plane are not rendered. `rendered` is about the share of the others.
            rendered = self._exceedance(layers, np.array([-np.inf]), camera, sizes)[:, 0]
            in_view.append(float(number * rendered @ expected_in_view(camera, sizes, layers.middle_px)))
        return float(np.mean(in_view))

    @cached_property
    def _pilots(self) -> list[PilotScene]:
        return sample_pilots(self._config, self._seed, self._catalogue)

    def _views(self, pilots: Sequence[tuple[StereoCamera, Floats]], sizes: ParticleSizes) -> _Views:
        """Compute the effect of particles on views; ``pilots`` has each view's camera and disparities."""
        edges, layers = self.target.edges_px, self._layers
        bare, exceedances, least, cover = [], [], [], []
        for camera, bare_px in pilots:
            bare.append(self._bare_shares(camera, bare_px))
            exceedances.append(self._exceedance(layers, edges[1:-1], camera, sizes))
            background = np.clip(np.searchsorted(edges, np.median(bare_px)) - 1, 0, len(layers) - 1)
            least.append(np.where((np.arange(len(layers)) == background) & layers.has_room, _POPULATED, 0.0))
            cover.append(expected_cover(camera, sizes, layers.middle_px, self._relief.fill))
        return _Views(np.array(bare), np.array(exceedances), np.array(least), np.array(cover))

    def _bare_shares(self, camera: StereoCamera, bare_px: Floats) -> Floats:
        """Return the share of a view below each inner edge of the target's bins, without solved particles, (K - 1,)."""
        inner = self.target.edges_px[1:-1]
        # Mean number, over a pixel, of stated particles and clutter that show at least the edge's disparity.
        covered = np.zeros(len(inner))
        for disparity_px, count, sizes in self._stated_layers:
            layer = DepthLayers(np.array([disparity_px.low]), np.array([disparity_px.high]))
            cover = expected_cover(camera, sizes, layer.middle_px, self._relief.fill)[0]
            covered += cover * count.middle * self._exceedance(layer, inner, camera, sizes)[0]
        return np.asarray(np.searchsorted(np.sort(bare_px), inner) / len(bare_px) * np.exp(-covered))

    def _exceedance(self, layers: DepthLayers, edges_px: Floats, camera: StereoCamera, sizes: ParticleSizes) -> Floats:
        rig = SequenceRig.within(self._config.disparity, (camera,))
        return layers.exceedance(edges_px, rig, self._config.particles.drift, sizes, self._relief.heights)


def poisson_counts(mean: Floats, quantile: Floats) -> Ints:
    """Return the values (K,) at quantiles (K,), in [0, 1), of Poisson distributions with means (K,)."""
    # scipy would take long to import.
    largest = mean.max(initial=0.0)
    number = np.arange(int(largest + 12 * largest**0.5 + 24))
    log_mean = np.log(np.maximum(mean, np.finfo(np.float64).tiny))[:, None]
    logarithm = number * log_mean - mean[:, None] - np.concatenate([[0.0], np.cumsum(np.log(number[1:]))])
    below = np.cumsum(np.exp(logarithm), axis=1)
    return np.asarray((below <= quantile[:, None]).sum(axis=1))


def sample_pilots(config: Config, seed: int, catalogue: ModelCatalogue) -> list[PilotScene]:
    """Sample the 32 pilot scenes of a recipe, or load them from the cache; raises as `sample_static_scene` does.

    Each process that renders a dataset needs them before its first pair, and furnishing a room takes longer than
    rendering it.
    """
    key = {
        "sections": config.model_dump(mode="json", include=_SECTIONS),
        "seed": seed,
        "names": [*catalogue.by_name.items()],
        "models": [(mesh.positions, mesh.uv, mesh.triangles) for mesh in catalogue.models],
    }

    def build() -> CacheEntry:
        cameras, bare_px = [], []
        for number in range(_PILOTS):
            generators = {purpose: generator(seed, Purpose.PILOTS, number, k) for k, purpose in enumerate(_PURPOSES)}
            static = sample_static_scene(config, catalogue, generators.__getitem__)
            cameras.append(static.rig.camera.values())
            bare_px.append(static.bare_px)
        return CacheEntry({"cameras": cameras}, {"bare_px": np.array(bare_px)})

    values, arrays = cached("pilots", key, build)
    cameras = map(StereoCamera.from_values, values["cameras"])
    return [PilotScene(*each) for each in zip(cameras, arrays["bare_px"], strict=True)]
