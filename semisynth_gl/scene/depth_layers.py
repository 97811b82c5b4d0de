"""Solves for the coverage of each depth layer, given a wanted distribution of disparity.

The Boolean model. Particles are thrown independently, so the number of a layer's particles that cover a given pixel has
a Poisson distribution. Its mean, the coverage lambda_k of layer k, is the sum of the particles' areas over the area of
the region into which they are thrown. A particle of layer k that covers a pixel shows at least d px there with the
probability S_k(d). The number of particles that show at least d px at a pixel has a Poisson distribution with the mean
lambda_k S_k(d), and is 0 with the probability exp(-lambda_k S_k(d)). If F_bare(d) is the share of pixels below d
without particles, the share of pixels below d is

    F(d) = F_bare(d) * product over k of exp(-lambda_k S_k(d)).                                                  (1)

The fit. The logarithm of (1) is linear in the lambdas. With the wanted F at the J = K - 1 inner edges d_j of the bins,

    sum over k of lambda_k S_k(d_j) = log(F_bare(d_j) / F(d_j)).                                                 (2)

Particles have depth and drift, so S_k is not a step at the layer's edge, and (2) couples all layers. The K unknowns of
(2) have limits, 0 <= least <= lambda <= 4, so (2) is solved by weighted least squares. An error e of log F is an error
F e of F, hence each equation has the weight F(d_j)^2. (2) is solved twice: first with the weights of the wanted F, then
with the weights of the larger of the wanted F and the F of the first solution.

One particle. The middle of its path has the depth Z, m, and the disparity d = f B / Z - doffs. A point at the depth z Z
has the disparity

    d' = (d + doffs) / z - doffs.                                                                                (3)

A length of l px at the depth Z is l Z / f metres. Let the path recede by ``a`` px in depth while its age t runs from 0
to 1, and let the particle have a radius of r px. A surface point h radii in front of the particle's centre has

    z = 1 + (t - 1/2) a / f - h r / f.                                                                           (4)

S_k(d) is the share of particles with d' >= d, weighted by their area r^2. It is computed from 128 points that are
spread evenly over (d, r, h, speed of the drift, heading of the drift, t).
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from semisynth_gl.config import Range
from semisynth_gl.histogram import Histogram
from semisynth_gl.scene import Bools, Floats
from semisynth_gl.scene.particles import ParticleSizes, path_px
from semisynth_gl.scene.rig import SequenceRig

_MOST_LAYERS = 48
# Maximum mean coverage of a layer; at this coverage, particles cover 98 % of the pixels.
_DENSEST = 4.0
# Smallest wanted F; smaller values are raised to this value.
_LEAST_BELOW = 0.01
_ITERATIONS = 200
# Number of points from which S is computed.
_SAMPLES = 128


@dataclass(frozen=True, slots=True, eq=False)
class DepthLayers:
    """K depth layers: ranges of the disparity of the middle of a particle's path."""

    low_px: Floats  # (K,) lowest disparity
    high_px: Floats  # (K,) highest disparity; equal to `low_px` in a layer that can hold no particles

    def __len__(self) -> int:
        return len(self.low_px)

    @property
    def middle_px(self) -> Floats:
        """(K,) disparity of each layer's middle."""
        return (self.low_px + self.high_px) / 2

    @property
    def has_room(self) -> Bools:
        """(K,) whether the layer can hold particles."""
        return self.low_px < self.high_px

    def exceedance(
        self, edges_px: Floats, rig: SequenceRig, drift: Range, sizes: ParticleSizes, heights: Floats
    ) -> Floats:
        """Return S_k(d) of the module's text, (K, J): the probability that a pixel of a particle shows at least d.

        Particles that would reach the near plane even without drift are not rendered, and add nothing to S_k.

        Args:
            edges_px: (J,) the disparities d.
            rig: the cameras, without sway.
            drift: horizontal speed, in units of the speed downwards.
            sizes: the particles' diameters.
            heights: `MeanModelRelief.heights`, quantiles of h.
        """
        camera, where = rig.camera, _unit_points()
        disparity = self.low_px[:, None] + (self.high_px - self.low_px)[:, None] * where[:, 0]
        radius = sizes.radius_px(camera, disparity, where[:, 1])
        relief = np.minimum(radius, rig.relief_px)
        height = heights[(where[:, 2] * len(heights)).astype(np.int64)]
        speed = drift.low + (drift.high - drift.low) * where[:, 3]
        # For w uniform in [0, 1), cos(pi w) has the distribution of the cosine of a random heading, and sin(2 pi w) has
        # that of its sine, but the two do not belong to one heading. ``age`` is t - 1/2.
        path, age = speed * path_px(camera, radius), where[:, 5] - 0.5
        # Depths are in units of Z from here on. A model's front is relief / f nearer than its centre. The drift in
        # depth is limited so that the model stays beyond the near plane, as in `particle_poses`.
        free = 1 - relief / camera.focal_px - rig.near_m / camera.depth_m(disparity)
        nearest = 2 * np.clip(free, 0.0, rig.relief_px / camera.focal_px)
        depth = 1 + age * np.clip(path * np.cos(np.pi * where[:, 4]) / camera.focal_px, -nearest, nearest)
        # Where particles drift sideways, the side of the view that they come from has a strip without particles. On the
        # right (on the left for negative disparities), the strip gets particles from the region that only the right
        # view shows.
        sideways = age * path * np.sin(2 * np.pi * where[:, 4])
        missing = np.maximum(sideways - np.maximum(-disparity, 0), 0)
        missing += np.maximum(-sideways - np.maximum(disparity, 0), 0)
        # By (3) and (4).
        shown = (disparity + camera.doffs_px) / (depth - height * relief / camera.focal_px) - camera.doffs_px
        # A larger particle covers more pixels. Nearer particles look larger, but so do the gaps between them.
        weight = np.where(free > 0, radius**2 / (radius**2).sum(axis=1, keepdims=True), 0.0)
        at_least = shown[:, :, None] >= edges_px
        return np.asarray(np.einsum("ks,ksj->kj", weight * np.maximum(1 - missing / camera.width_px, 0.0), at_least))


def merge_bins(target: Histogram) -> Histogram:
    """Merge neighbouring bins into at most 48: a particle would extend over several narrow bins."""
    step = -(-len(target.shares) // _MOST_LAYERS)
    edges = np.append(target.edges_px[:-1:step], target.edges_px[-1])
    return target.rebinned(edges) if step > 1 else target


def solve_coverage(shares: Floats, bare: Floats, exceedances: Floats, least: Floats, has_room: Bools) -> Floats:
    """Solve (2) of the module's text for the layers' coverages lambda by weighted least squares, within their limits.

    The accelerated projected gradient (Beck and Teboulle 2009) minimises  (S^T lambda - b)^T W (S^T lambda - b),  where
    b_j is the right side of (2) and W is the diagonal matrix of the weights. The step for lambda_k is 1 / (sum of row
    k of abs(S W S^T)). The diagonal matrix of these sums minus S W S^T is diagonally dominant, hence positive
    semidefinite, so no step is too long. scipy's `lsq_linear`, for one view at a time, would take 20 times as long.

    Args:
        shares: (K,) wanted share of a view in each bin; their running sum is F.
        bare: (..., K - 1) F_bare at the inner edges.
        exceedances: (..., K, K - 1) S at the inner edges, see `DepthLayers.exceedance`.
        least: (..., K) smallest coverages.
        has_room: (K,) whether the layer can hold particles.

    Returns:
        (..., K) coverages, from ``least`` to 4; 0 in layers that can hold no particles.
    """
    wanted = np.maximum(np.cumsum(shares)[:-1], _LEAST_BELOW)
    usable = bare > 0
    needed = np.where(usable, np.log(np.where(usable, bare, 1.0) / wanted), 0.0)
    most = np.where(has_room, _DENSEST, 0.0)
    result, below = least, np.broadcast_to(wanted, bare.shape)
    for _ in range(2):
        weighted = exceedances * np.where(usable, np.maximum(below, wanted) ** 2, 0.0)[..., None, :]
        product = weighted @ np.swapaxes(exceedances, -1, -2)
        aim = weighted @ needed[..., None]
        step = 1 / np.maximum(np.abs(product).sum(axis=-1), np.finfo(np.float64).tiny)
        momentum, before, ahead = 1.0, result, result
        for _ in range(_ITERATIONS):
            gradient = (product @ ahead[..., None] - aim)[..., 0]
            result = np.minimum(np.maximum(ahead - step * gradient, least), most)
            following = (1 + (1 + 4 * momentum**2) ** 0.5) / 2
            ahead = result + (momentum - 1) / following * (result - before)
            momentum, before = following, result
        below = _shares_below(result, bare, exceedances)
    return result


def expected_shares(coverage: Floats, bare: Floats, exceedances: Floats) -> Floats:
    """Return the share of the view in each bin, (..., K): differences of F of (1).

    ``coverage`` is (..., K); see `solve_coverage` for the other arguments.
    """
    ends = np.zeros((*coverage.shape[:-1], 1))
    return np.diff(np.concatenate([ends, _shares_below(coverage, bare, exceedances), ends + 1], axis=-1))


def _shares_below(coverage: Floats, bare: Floats, exceedances: Floats) -> Floats:
    """Return F of (1) at the inner edges, (..., K - 1)."""
    return np.asarray(bare * np.exp(-coverage[..., None, :] @ exceedances)[..., 0, :])


@cache
def _unit_points() -> Floats:
    """Return points that are evenly spread over the unit cube of six dimensions, (128, 6): Roberts' sequence.

    Its steps are the negative powers -1 to -d of the root of x^(d + 1) = x + 1, for d = 6.
    """
    root = 1.5
    for _ in range(50):
        root = (1 + root) ** (1 / 7)
    steps = root ** -np.arange(1, 7, dtype=np.float64)
    return np.asarray((np.arange(1, _SAMPLES + 1)[:, None] * steps + 0.5) % 1.0)
