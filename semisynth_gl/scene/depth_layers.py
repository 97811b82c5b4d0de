"""The number of particles that each depth layer needs for a wanted distribution of disparity.

With particles thrown independently, a layer whose particles cover a pixel lambda times on average leaves it open with
probability exp(-lambda) (a Boolean model). A pixel shows less than d px where no particle that covers it shows more:

    F(d) = F_background(d) * product over layers k of exp(-lambda_k S_k(d)),

where S_k(d) is the probability that a particle of layer k shows d px or more where it covers a pixel. Particles have
depth, so S_k is not a step function: the lambdas are fitted to the wanted F at the edges of all layers at once.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from semisynth_gl.config import Range
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.histogram import Histogram
from semisynth_gl.scene import Bools, Floats
from semisynth_gl.scene.particles import Sizes, StatedLayer, path_px

_MOST_LAYERS = 48
# Largest mean coverage of a layer, which closes 98 % of its pixels.
_DENSEST = 4.0
# Smallest wanted share of open pixels; smaller shares are raised to it.
_CLOSED = 0.01
# Iterations of the solver.
_ROUNDS = 200
# Points over which the probabilities of a particle are averaged.
_SAMPLES = 128


@dataclass(frozen=True, slots=True, eq=False)
class DepthLayers:
    """K layers of depth."""

    low_px: Floats  # (K,) lowest disparity of a particle's middle
    high_px: Floats  # (K,) highest disparity of a particle's middle; equal to `low_px` in a layer without room

    @classmethod
    def from_bins(cls, target: Histogram, min_px: float, max_px: float) -> "DepthLayers":
        """Return a layer for each bin of a target, within the limits ``min_px`` and ``max_px``."""
        low = np.maximum(target.edges_px[:-1], min_px)
        return cls(low, np.maximum(low, np.minimum(target.edges_px[1:], max_px)))

    @classmethod
    def of(cls, stated: StatedLayer) -> "DepthLayers":
        """Return a layer that the config states, as the only one."""
        return cls(np.array([stated.disparity_px.low]), np.array([stated.disparity_px.high]))

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
        self,
        edges_px: Floats,
        camera: StereoCamera,
        drift: Range,
        sizes: Sizes,
        heights: Floats,
        near_m: float,
        relief_px: float = np.inf,
    ) -> Floats:
        """Return how probably a particle of each layer shows at least some disparities where it covers a pixel.

        Particles that come too near to the near plane are not drawn, and show nothing.

        Args:
            edges_px: (J,) the disparities.
            camera: the camera.
            drift: ``particles.drift`` of the config.
            sizes: the particles' diameters.
            heights: the models' mean relief, see `Silhouette`.
            near_m: depth of the near plane.
            relief_px: largest radius of a model along the viewing axis.

        Returns:
            (K, J) probabilities.
        """
        where = _unit_points()
        disparity = self.low_px[:, None] + (self.high_px - self.low_px)[:, None] * where[:, 0]
        radius = sizes.radius_px(camera, disparity, where[:, 1])
        relief = np.minimum(radius, relief_px)
        height = heights[(where[:, 2] * len(heights)).astype(np.int64)]
        speed = drift.low + (drift.high - drift.low) * where[:, 3]
        # Half a turn of headings covers both directions of each axis. A particle is in the middle of its path at half
        # its age.
        path, age = speed * path_px(camera, radius), where[:, 5] - 0.5
        # All depths here are in units of the depth of the path's middle.
        room = 1 - relief / camera.focal_px - near_m / camera.depth_m(disparity)
        nearest = 2 * np.clip(room, 0.0, relief_px / camera.focal_px)
        depth = 1 + age * np.clip(path * np.cos(np.pi * where[:, 4]) / camera.focal_px, -nearest, nearest)
        # Particles that drift sideways are missing at the side that they come from. On the right (or, with a negative
        # disparity, on the left) the margin for the other view supplies them.
        sideways = age * path * np.sin(2 * np.pi * where[:, 4])
        missing = np.maximum(sideways - np.maximum(-disparity, 0), 0)
        missing += np.maximum(-sideways - np.maximum(disparity, 0), 0)
        shown = (disparity + camera.doffs_px) / (depth - height * relief / camera.focal_px) - camera.doffs_px
        # A larger particle covers more pixels. Particles that come nearer grow, but their distances grow as much.
        weight = np.where(room > 0, radius**2 / (radius**2).sum(axis=1, keepdims=True), 0.0)
        at_least = shown[:, :, None] >= edges_px
        return np.asarray(np.einsum("ks,ksj->kj", weight * np.maximum(1 - missing / camera.width_px, 0.0), at_least))


def merge_bins(target: Histogram) -> Histogram:
    """Merge neighbouring bins until there are at most 48: narrower bins would be finer than particles are deep."""
    step = -(-len(target.shares) // _MOST_LAYERS)
    edges = np.append(target.edges_px[:-1:step], target.edges_px[-1])
    return target.rebinned(edges) if step > 1 else target


def solve_coverage(shares: Floats, bare: Floats, exceedances: Floats, least: Floats, has_room: Bools) -> Floats:
    """Find the layers' mean coverages lambda, within their limits, that bring F nearest to the wanted F.

    This solver takes the place of scipy's `lsq_linear`, because it solves the views of all pilot scenes at once: for 32
    views it takes a twentieth of the time. Importing scipy takes about as long as importing everything else that
    samples scenes. Its solutions differ, too, so existing datasets would change.

    Args:
        shares: (K,) wanted share of a view in each bin.
        bare: (..., K - 1) share of the view that shows less than each inner edge before the layers are filled.
        exceedances: (..., K, K - 1), `DepthLayers.exceedance` at the inner edges.
        least: (..., K) smallest coverages.
        has_room: (K,) whether the layer can hold particles.

    Returns:
        (..., K) coverages, from ``least`` to 4; 0 in layers without room.
    """
    wanted = np.maximum(np.cumsum(shares)[:-1], _CLOSED)
    usable = bare > 0
    needed = np.where(usable, np.log(np.where(usable, bare, 1.0) / wanted), 0.0)
    most = np.where(has_room, _DENSEST, 0.0)
    result, still_open = least, np.broadcast_to(wanted, bare.shape)
    for _ in range(2):
        # Errors of log F matter in proportion to F: they are errors of F where much is open, and none where all is
        # closed.
        weighted = exceedances * np.where(usable, np.maximum(still_open, wanted) ** 2, 0.0)[..., None, :]
        product = weighted @ np.swapaxes(exceedances, -1, -2)
        aim = weighted @ needed[..., None]
        # Fast projected gradient (Beck and Teboulle 2009); the diagonal matrix of row sums bounds the quadratic form.
        step = 1 / np.maximum(np.abs(product).sum(axis=-1), np.finfo(np.float64).tiny)
        # In place: the arrays of one scene are so small that allocating new ones takes longer than filling them.
        momentum, before, ahead, result = 1.0, np.array(result), np.array(result), np.empty_like(result)
        change, gradient = np.empty_like(result), np.empty_like(aim)
        for _ in range(_ROUNDS):
            np.matmul(product, ahead[..., None], out=gradient)
            np.subtract(gradient, aim, out=gradient)
            np.multiply(step, gradient[..., 0], out=change)
            np.subtract(ahead, change, out=result)
            np.maximum(result, least, out=result)
            np.minimum(result, most, out=result)
            following = (1 + (1 + 4 * momentum**2) ** 0.5) / 2
            np.subtract(result, before, out=change)
            np.multiply((momentum - 1) / following, change, out=change)
            np.add(result, change, out=ahead)
            momentum, before, result = following, result, before
        result = before
        still_open = _open_shares(result, bare, exceedances)
    return result


def expected_shares(coverage: Floats, bare: Floats, exceedances: Floats) -> Floats:
    """Return the share of the view in each bin, (..., K), by the Boolean model.

    ``coverage`` is (..., K); see `solve_coverage` for the other arguments.
    """
    ends = np.zeros((*coverage.shape[:-1], 1))
    return np.diff(np.concatenate([ends, _open_shares(coverage, bare, exceedances), ends + 1], axis=-1))


def _open_shares(coverage: Floats, bare: Floats, exceedances: Floats) -> Floats:
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
