"""The numbers of particles in a scene, by depth layer, for the dataset's wanted distribution of disparity.

There is a depth layer for each bin of the wanted histogram. `semisynth_gl.scene.depth_layers` finds its coverage
lambda: how many particles cover a pixel, on average. This module takes a dataset from wanted shares to numbers:

1. Pilots. 32 scenes without particles stand for the dataset: they give the share of a view that is bare of particles
   below each disparity.
2. Aim. Each scene is solved for itself. A wall keeps some scenes from the target, and the others must compensate: the
   aim of all scenes is shifted by  wanted - achieved,  until the mean of the pilots is the target.
3. Numbers. One particle adds c = A / R to the coverage, where A px^2 is the mean area of its silhouette and R px^2 the
   area of the region in which it may be (`expected_cover`). So a layer has n = lambda / c particles on average.
4. Sizes. c grows with the square of the sizes, so n falls with it. A bisection over a factor of all sizes finds the
   number in view that ``particles.density`` asks for. Sizes also grow where n adds up to more than ``particles.most``.
5. Counts. The number of layer k in sequence s is the quantile u = (u_0 + s * sqrt(p_k)) mod 1 of the Poisson
   distribution of mean n, where p_k is the layer's prime and u_0 comes from the seed. Multiples of an irrational number
   are spread evenly over [0, 1), so few scenes reach the mean that independent samples reach with many.

Layers that the config states (``particles.layers``) are not solved, and ``particles.clutter`` is added to what is
solved. Both count in what is bare of solved particles.
"""

import hashlib
from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from semisynth_gl.cache import Entry, cached
from semisynth_gl.config import Config, Range
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.geometry.silhouette import Silhouette
from semisynth_gl.histogram import Histogram
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.scene import Floats, Ints
from semisynth_gl.scene.arrangement import Catalogue
from semisynth_gl.scene.depth_layers import DepthLayers, expected_shares, merge_bins, solve_coverage
from semisynth_gl.scene.particles import Batch, Sizes, expected_cover, expected_in_view, stated_sizes
from semisynth_gl.scene.rig import check_reachable, near_depth_m, relief_px
from semisynth_gl.scene.structures import sample_static_scene
from semisynth_gl.seeds.seeds import Purpose, generator

# Number of pilot scenes.
_PILOTS = 32
# The sections that `sample_static_scene` reads, and the purposes of its random numbers; each pilot has its own.
_SECTIONS = {"camera", "rig", "disparity", "background", "room", "street", "structures"}
_KEYS = (Purpose.CAMERA, Purpose.BACKGROUND, Purpose.STRUCTURES, Purpose.SWAY, Purpose.RIG, Purpose.SKY)
# Number of pilot scenes in which particles are counted to find the sizes for a density.
_COUNTED_PILOTS = 8
# Number of times that the aim is shifted towards the target.
_CORRECTIONS = 6
# Number of objects in view for each density, relative to the stated sizes.
_DENSITY = {"sparse": 1 / 3, "dense": 3.0}
# Smallest factor of the stated sizes.
_SMALLEST = 0.05
# Largest mean number of particles in a scene, in units of particles.most.
_BEYOND_MOST = 2.0
# Number of times that particles are enlarged, at the most, until particles.most are enough.
_ENLARGEMENTS = 12
# Number of bisections in the search for a factor of sizes.
_HALVINGS = 10
# The roots of primes are irrational and unrelated. There are 50 primes, for at most 48 layers.
_PRIMES = np.array([n for n in range(2, 230) if all(n % k for k in range(2, n))], np.float64)
# Smallest share of the aim for a bin that each correction leaves: from 0 the aim could not rise again.
_LEAST_OF_AIM = 0.1
# Smallest mean coverage of the background's layer, so that no background is bare.
_POPULATED = 0.5


class Pilot(NamedTuple):
    """A pilot scene: a static scene, without particles."""

    camera: StereoCamera
    bare_px: Floats  # (R,) disparities on a coarse grid over the left view, without particles


class _Views(NamedTuple):
    """The effect of particles in K layers on V views."""

    bare: Floats  # (V, K - 1) F_bare: share of the view below each inner edge of the bins, without solved particles
    exceedances: Floats  # (V, K, K - 1) S: see `DepthLayers.exceedance`
    least: Floats  # (V, K) smallest coverages
    cover: Floats  # (V, K) c: coverage that one particle adds


class _Aim(NamedTuple):
    """The distribution that each scene is solved for, so that the mean of all scenes is the target."""

    shares: Floats  # (K,) in the target's bins
    achieved: Floats  # (K,) mean shares in scenes that are solved for this aim
    sizes: Sizes  # sizes of the particles


class DisparitySolver:
    """Numbers of particles for the scenes of one recipe of a dataset.

    ``silhouette`` is the mean silhouette of the models, and ``catalogue`` has the models of pilot scenes. The
    ``wanted`` distribution is by default the config's; ``target`` has it in bins that depth layers can follow.
    """

    def __init__(
        self, config: Config, seed: int, silhouette: Silhouette, catalogue: Catalogue, wanted: Histogram | None = None
    ) -> None:
        self._config, self._seed, self._silhouette, self._catalogue = config, seed, silhouette, catalogue
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

    def sample(self, sequence: int, camera: StereoCamera, bare_px: Floats, rng: np.random.Generator) -> list[Batch]:
        """Sample the numbers of particles of one scene.

        ``bare_px`` (R,) has the disparities of its left view without particles. ``rng`` is the source of the numbers of
        layers that the config states, and of nothing else.

        Raises:
            InputError: where a layer that the config states lies beyond infinity, or the target cannot be met with
                ``particles.most`` particles.
        """
        for number, (disparity_px, *_) in enumerate(self._stated):
            key = "layers" if number < len(self._config.particles.layers or ()) else "clutter"
            check_reachable(camera, disparity_px.low, f"particles.{key}.disparity_px")
        solved = list[Batch]()
        if self._solved:
            quantile = (self._first_quantile + sequence * np.sqrt(_PRIMES[: len(self._layers)])) % 1.0
            sizes = self._aim.sizes
            views = self._views([(camera, bare_px)], sizes)
            mean = (self._coverage(self._aim.shares, views) / views.cover)[0]
            # `sample_slots` cuts the number to particles.most in any case.
            mean *= min(1.0, _BEYOND_MOST * self._config.particles.most / max(float(mean.sum()), 1.0))
            layers = zip(self._layers.low_px, self._layers.high_px, poisson_counts(mean, quantile), strict=True)
            solved = [Batch(Range(low, high), int(count), sizes) for low, high, count in layers]
        return solved + [Batch(where, round(count.sample(rng)), sizes) for where, count, sizes in self._stated]

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

    def _scale(self, sizes: Sizes, wanted: float) -> float:
        """Return the factor of sizes at which about a wanted number of objects is in the left view on average."""
        # At the largest factor, the largest particles of the nearest layer are as wide as the image.
        camera = self._pilots[0].camera
        largest_px = float(sizes.radius_px(camera, np.array(self._layers.high_px.max()), np.array(1.0)))
        low, high = _SMALLEST, max(1.0, camera.width_px / 2 / largest_px)
        for _ in range(_HALVINGS):
            # The number falls as sizes grow, about with their square.
            middle = (low * high) ** 0.5
            low, high = (middle, high) if self._in_view(sizes.scaled(middle)) > wanted else (low, middle)
        return float((low * high) ** 0.5)

    def _corrected(self, sizes: Sizes) -> _Aim:
        """Shift the aim until the mean of the pilot scenes is near the target.

        Where the target takes more particles than ``particles.most``, they become larger; InputError where that is not
        enough.
        """
        wanted, most = self.target.shares, self._config.particles.most
        for _ in range(_ENLARGEMENTS):
            views = self._views(self._pilots, sizes)
            number = float((self._coverage(wanted, views) / views.cover).sum(axis=1).mean())
            if number <= most:
                break
            # A particle covers about the square of its size.
            sizes = sizes.scaled(1.05 * (number / most) ** 0.5)
        else:
            raise InputError(
                f"disparity.target takes about {number:.0f} particles a scene, however large they are, and "
                f"particles.most allows {most}: raise particles.most"
            )
        aims, shares = [], wanted
        for _ in range(_CORRECTIONS):
            coverage = self._coverage(shares, views)
            achieved = expected_shares(coverage, views.bare, views.exceedances).mean(axis=0)
            aims.append(_Aim(shares, achieved, sizes))
            shares = np.maximum(shares + wanted - achieved, _LEAST_OF_AIM * shares)
            shares = shares / shares.sum()
        return min(aims, key=lambda aim: float(np.abs(aim.achieved - wanted).sum()))

    def _coverage(self, shares: Floats, views: _Views) -> Floats:
        """Return the mean coverages, (V, K), rounded because processors differ in the last digits."""
        coverage = solve_coverage(shares, views.bare, views.exceedances, views.least, self._layers.has_room)
        return np.round(coverage, 9)

    def _in_view(self, sizes: Sizes) -> float:
        """Return the mean number of particles in the left views of the first pilot scenes."""
        pilots, layers, in_view = self._pilots[:_COUNTED_PILOTS], self._layers, []
        views = self._views(pilots, sizes)
        numbers = self._coverage(self.target.shares, views) / views.cover
        for number, (camera, _) in zip(numbers, pilots, strict=True):
            # The others would cross the near plane.
            visible = self._exceedance(layers, np.array([-np.inf]), camera, sizes)[:, 0]
            in_view.append(float(number * visible @ expected_in_view(camera, sizes, layers.middle_px)))
        return float(np.mean(in_view))

    @cached_property
    def _pilots(self) -> list[Pilot]:
        return sample_pilots(self._config, self._seed, self._catalogue)

    def _views(self, pilots: Sequence[tuple[StereoCamera, Floats]], sizes: Sizes) -> _Views:
        """Work out the effect of particles on views, each given by a camera and its disparities without particles."""
        edges, layers = self.target.edges_px, self._layers
        bare, exceedances, least, cover = [], [], [], []
        for camera, bare_px in pilots:
            bare.append(self._bare_shares(camera, bare_px))
            exceedances.append(self._exceedance(layers, edges[1:-1], camera, sizes))
            background = np.clip(np.searchsorted(edges, np.median(bare_px)) - 1, 0, len(layers) - 1)
            least.append(np.where((np.arange(len(layers)) == background) & layers.has_room, _POPULATED, 0.0))
            cover.append(expected_cover(camera, sizes, layers.middle_px, self._silhouette.fill))
        return _Views(np.array(bare), np.array(exceedances), np.array(least), np.array(cover))

    def _bare_shares(self, camera: StereoCamera, bare_px: Floats) -> Floats:
        """Return the share of a view below each inner edge of the target's bins, without solved particles, (K - 1,)."""
        inner = self.target.edges_px[1:-1]
        # How many times stated particles cover a pixel with at least the edge's disparity.
        covered = np.zeros(len(inner))
        for disparity_px, count, sizes in self._stated:
            layer = DepthLayers(np.array([disparity_px.low]), np.array([disparity_px.high]))
            cover = expected_cover(camera, sizes, layer.middle_px, self._silhouette.fill)[0]
            covered += cover * count.middle * self._exceedance(layer, inner, camera, sizes)[0]
        return np.asarray(np.searchsorted(np.sort(bare_px), inner) / len(bare_px) * np.exp(-covered))

    def _exceedance(self, layers: DepthLayers, edges_px: Floats, camera: StereoCamera, sizes: Sizes) -> Floats:
        disparity, drift = self._config.disparity, self._config.particles.drift
        near_m = near_depth_m(camera, disparity)
        most_px = relief_px(camera, disparity.min_px, near_m)
        return layers.exceedance(edges_px, camera, drift, sizes, self._silhouette.heights, near_m, most_px)


def poisson_counts(mean: Floats, quantile: Floats) -> Ints:
    """Return the value at each quantile (K,), in [0, 1), of Poisson distributions with means (K,): (K,) int64."""
    # scipy would take long to import.
    largest = mean.max(initial=0.0)
    number = np.arange(int(largest + 12 * largest**0.5 + 24))
    log_mean = np.log(np.maximum(mean, np.finfo(np.float64).tiny))[:, None]
    logarithm = number * log_mean - mean[:, None] - np.concatenate([[0.0], np.cumsum(np.log(number[1:]))])
    below = np.cumsum(np.exp(logarithm), axis=1)
    return np.asarray((below <= quantile[:, None]).sum(axis=1))


def sample_pilots(config: Config, seed: int, catalogue: Catalogue) -> list[Pilot]:
    """Sample the 32 pilot scenes of a recipe; errors are those of `sample_static_scene`.

    Each process that renders a dataset needs them before its first pair, and furnishing a room takes longer than
    rendering it. So the cache keeps them.
    """

    def key() -> dict[str, Any]:
        models = hashlib.sha256()
        for name, numbers in catalogue.by_name.items():
            models.update(f"{name!r} {numbers.tolist()}\n".encode())
        for mesh in catalogue.models:
            for array in (mesh.positions, mesh.uv, mesh.triangles):
                models.update(f"{array.shape}\n".encode() + array.tobytes())
        return {
            "sections": config.model_dump(mode="json", include=_SECTIONS),
            "seed": seed,
            "models": models.hexdigest(),
        }

    def sample(number: int) -> Pilot:
        generators = {use: generator(seed, Purpose.PILOTS, number, key) for key, use in enumerate(_KEYS)}
        static = sample_static_scene(config, catalogue, generators.__getitem__)
        return Pilot(static.rig.camera, static.bare_px)

    return cached("pilots", key, build=lambda: [*map(sample, range(_PILOTS))], pack=_packed, unpack=_unpacked)


def _packed(pilots: Sequence[Pilot]) -> Entry:
    cameras = [pilot.camera.values() for pilot in pilots]
    return Entry({"cameras": cameras}, {"bare_px": np.array([pilot.bare_px for pilot in pilots])})


def _unpacked(entry: Entry) -> list[Pilot]:
    both = zip(entry.values["cameras"], entry.arrays["bare_px"], strict=True)
    return [Pilot(StereoCamera.from_values(values), bare_px) for values, bare_px in both]
