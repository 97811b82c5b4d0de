"""Finds how many particles each depth layer of a scene needs for the dataset's wanted distribution of disparity.

The wanted histogram is merged into at most 48 bins, with a depth layer each. `semisynth_gl.scene.depth_layers` finds a
layer's coverage lambda: how many particles cover a pixel, on average. This module computes numbers of particles in five
steps:

1. Pilots. 32 scenes without particles represent the dataset. They give the cumulative distribution of disparity of
   scenes without particles.
2. Aim. Each scene is solved separately for one distribution, the aim. It begins as the target. A scene with a near wall
   cannot reach it, so each round corrects the aim by  target - mean of the solved pilots.  Of 6 aims, the one whose
   pilots come nearest to the target is used.
3. Numbers. One particle adds c = A / R to the coverage, where A px^2 is the mean area of its silhouette and R px^2 the
   area of the region in which it may be (`expected_cover`). So a layer has n = lambda / c particles on average.
4. Sizes. c grows with the square of the sizes, so larger particles need smaller numbers. If ``particles.density`` is
   sparse or dense, a bisection finds the size factor at which the wanted number of objects is in view. Sizes also grow
   where the sum of all n exceeds ``particles.most``.
5. Counts. The number of layer k in sequence s is the quantile u = (u_0 + s * sqrt(p_k)) mod 1 of the Poisson
   distribution of mean n, where p_k is the layer's prime and u_0 comes from the seed. Multiples of an irrational number
   are spread evenly over [0, 1), so the mean converges with far fewer scenes than with independent samples.

Layers that the config states (``particles.layers``) are not solved, and the particles of ``particles.clutter`` are
added. The solver treats both as part of the background.
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
from semisynth_gl.scene.particles import ParticleBatch, ParticleSizes, expected_cover, expected_in_view, stated_sizes
from semisynth_gl.scene.rig import SequenceRig, check_reachable
from semisynth_gl.scene.static_scene import sample_static_scene
from semisynth_gl.seeds.seeds import Purpose, generator

# Number of pilot scenes.
_PILOTS = 32
# The sections that `sample_static_scene` reads, and the purposes for which it asks for a generator.
_SECTIONS = {"camera", "rig", "disparity", "background", "room", "street", "structures"}
_PURPOSES = (Purpose.CAMERA, Purpose.BACKGROUND, Purpose.STRUCTURES, Purpose.SWAY, Purpose.RIG, Purpose.SKY)
# Number of pilot scenes in which particles are counted to find the size factor of a density.
_COUNTED_PILOTS = 8
# Number of aims that are tried.
_AIMS = 6
# Number of objects in view for each density, relative to the number at the stated sizes.
_DENSITY = {"sparse": 1 / 3, "dense": 3.0}
# Smallest factor of the stated sizes.
_SMALLEST = 0.05
# Maximum mean number of particles in a scene, as a multiple of particles.most.
_BEYOND_MOST = 2.0
# Maximum number of times that particles are enlarged, until particles.most of them suffice.
_ENLARGEMENTS = 12
# Number of bisections in the search for a factor of sizes.
_HALVINGS = 10
# The roots of primes are irrational and unrelated. There are 50 primes, for at most 48 layers.
_PRIMES = np.array([n for n in range(2, 230) if all(n % k for k in range(2, n))], np.float64)
# Each correction keeps at least this share of a bin's aim, so that no bin's aim falls to 0 or below.
_LEAST_OF_AIM = 0.1
# Minimum mean coverage of the layer in which the background lies, so that no background is without particles.
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
    """The distribution that each scene is solved for, so that the mean of all scenes comes near the target."""

    shares: Floats  # (K,) in the target's bins
    achieved: Floats  # (K,) mean shares in scenes that are solved for this aim
    sizes: ParticleSizes  # sizes of the particles


class DisparitySolver:
    """Solves for the numbers of particles in the scenes of one recipe of a dataset.

    ``relief`` is the mean relief of the models. ``catalogue`` has the models of pilot scenes. ``wanted`` is the
    wanted distribution, by default the config's. ``target`` is this distribution, in the bins of the depth layers.
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
        own, particles = config.wanted_histogram(), config.particles
        self.target = merge_bins(wanted or own)
        self._solved = particles.layers is None
        middle = Range(own.quantile(0.1), own.quantile(0.9))
        self._stated = [
            (layer.disparity_px or middle, layer.count, stated_sizes(particles, layer))
            for layer in (*(particles.layers or ()), *particles.clutter)
        ]
        low_px = np.maximum(self.target.edges_px[:-1], config.disparity.min_px)
        high_px = np.minimum(self.target.edges_px[1:], config.disparity.max_px)
        self._layers = DepthLayers(low_px, np.maximum(low_px, high_px))
        self._first_quantile = generator(seed, Purpose.COUNTS).random(len(self._layers))

    def sample(
        self, sequence: int, camera: StereoCamera, bare_px: Floats, rng: np.random.Generator
    ) -> list[ParticleBatch]:
        """Sample the numbers of particles of one scene.

        ``bare_px`` (R,) has the disparities of its left view without particles. ``rng`` samples only the particle
        counts of the layers that the config states.

        Raises:
            InputError: where disparity + doffs is not positive for a layer that the config states, or the target cannot
                be met with ``particles.most`` particles.
        """
        for number, (disparity_px, *_) in enumerate(self._stated):
            key = "layers" if number < len(self._config.particles.layers or ()) else "clutter"
            check_reachable(camera, disparity_px.low, f"particles.{key}.disparity_px")
        solved = list[ParticleBatch]()
        if self._solved:
            quantile = (self._first_quantile + sequence * np.sqrt(_PRIMES[: len(self._layers)])) % 1.0
            sizes = self._aim.sizes
            views = self._views([(camera, bare_px)], sizes)
            mean = (self._coverage(self._aim.shares, views) / views.cover)[0]
            # Avoid huge counts, which `sample_slots` would reduce to particles.most anyway.
            mean *= min(1.0, _BEYOND_MOST * self._config.particles.most / max(float(mean.sum()), 1.0))
            layers = zip(self._layers.low_px, self._layers.high_px, poisson_counts(mean, quantile), strict=True)
            solved = [ParticleBatch(Range(low, high), int(count), sizes) for low, high, count in layers]
        return solved + [ParticleBatch(where, round(count.sample(rng)), sizes) for where, count, sizes in self._stated]

    def expected(self) -> Histogram:
        """Return the mean distribution of the dataset, in the bins of ``target``, by the Boolean model of pilot scenes.

        Raises InputError where the target cannot be met, see `sample`.
        """
        if self._solved:
            return Histogram.from_counts(self.target.edges_px, self._aim.achieved)
        below = np.mean([self._bare_shares(camera, bare_px) for camera, bare_px in self._pilots], axis=0)
        return Histogram.from_counts(self.target.edges_px, np.diff(np.concatenate([[0.0], below, [1.0]])))

    @cached_property
    def _aim(self) -> _Aim:
        """The aim of all scenes, at the sizes that the density asks for."""
        density, sizes = self._config.particles.density, stated_sizes(self._config.particles)
        if density != "default":
            sizes = sizes.scaled(self._scale(sizes, _DENSITY[density] * self._in_view(sizes)))
        return self._corrected(sizes)

    def _scale(self, sizes: ParticleSizes, wanted: float) -> float:
        """Return the factor of sizes at which about a wanted number of objects is in the left view on average."""
        # With the upper limit, the largest particles of the nearest layer are as wide as the image.
        camera = self._pilots[0].camera
        largest_px = float(sizes.radius_px(camera, np.array(self._layers.high_px.max()), np.array(1.0)))
        low, high = _SMALLEST, max(1.0, camera.width_px / 2 / largest_px)
        for _ in range(_HALVINGS):
            # The number of objects in view falls about with the square of their size.
            middle = (low * high) ** 0.5
            low, high = (middle, high) if self._in_view(sizes.scaled(middle)) > wanted else (low, middle)
        return float((low * high) ** 0.5)

    def _corrected(self, sizes: ParticleSizes) -> _Aim:
        """Try 6 aims, and return the one with which the mean of the pilot scenes is nearest the target.

        Where the target needs more particles than ``particles.most``, they are enlarged first. Raises InputError where
        that does not suffice.
        """
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
        """Enlarge particles until pilots need at most ``particles.most`` on average; return sizes and effect."""
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
        """Return the mean number of particles in the left views of the first pilot scenes."""
        pilots, layers, in_view = self._pilots[:_COUNTED_PILOTS], self._layers, []
        views = self._views(pilots, sizes)
        numbers = self._coverage(self.target.shares, views) / views.cover
        for number, (camera, _) in zip(numbers, pilots, strict=True):
            # About the share of the particles that are rendered: those that would cross the near plane are not.
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
        # Mean number of stated particles over a pixel whose disparity is at least the edge's.
        covered = np.zeros(len(inner))
        for disparity_px, count, sizes in self._stated:
            layer = DepthLayers(np.array([disparity_px.low]), np.array([disparity_px.high]))
            cover = expected_cover(camera, sizes, layer.middle_px, self._relief.fill)[0]
            covered += cover * count.middle * self._exceedance(layer, inner, camera, sizes)[0]
        return np.asarray(np.searchsorted(np.sort(bare_px), inner) / len(bare_px) * np.exp(-covered))

    def _exceedance(self, layers: DepthLayers, edges_px: Floats, camera: StereoCamera, sizes: ParticleSizes) -> Floats:
        rig = SequenceRig.within(self._config.disparity, (camera,))
        return layers.exceedance(edges_px, rig, self._config.particles.drift, sizes, self._relief.heights)


def poisson_counts(mean: Floats, quantile: Floats) -> Ints:
    """Return the value at each quantile (K,), in [0, 1), of Poisson distributions with means (K,): (K,) int64."""
    # Not by scipy, which takes long to import.
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
