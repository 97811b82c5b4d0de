"""The two images against the left disparity: does the right one, warped, give the left one?

Textures carry no light, so both views sample the same texture at the same surface point. What remains after warping is
the error of interpolating the right image between its pixels.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.verify.consistency import FEWEST, Match
from semisynth_gl.verify.finding import Verdict

Values = NDArray[np.float64]
Sampler = Callable[[float], tuple[Values, Values]]
"""From a step to what an image has there, and its derivative by the step; both (N,), in levels."""

# Bounds; docs/verify.md derives them.
ROUNDING_LEVELS = 2.0
BEND = 0.25
EXPLAINED_SHARE = 0.9
SHIFT_PX = 0.02
SCALE = 0.001
DEVIATIONS = 5.0
_TILE_PX = 16
# Enough to pin a shift to a thousandth of a pixel; more would only take time.
_MOST = 200_000
_STEPS = 4
# Below this mean squared slope (levels per pixel) there is no texture to align.
_TEXTURE = 0.25
# Where imperfections of a rig were put on the images, they must still resemble each other.
_CORRELATION = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class _Pixels:
    """Pixels of the left view to be found in the right image.

    Attributes:
        row: (N,) int64.
        column: (N,) int64.
        disparity: (N,) float64, px.
        left: (N,) float64, grey levels of the left image.
        right: (H, W) float32, grey levels of the right image.
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    disparity: Values
    left: Values
    right: NDArray[np.float32]

    def samples(self, disparity: Values) -> tuple[Values, Values]:
        """Four pixels (4, N) of the right image about x - disparity, and the fraction (N,) between the inner two."""
        position = (self.column - disparity).clip(1, self.right.shape[1] - 2.001)
        first = np.floor(position).astype(np.int64)
        values = np.stack([self.right[self.row, first + step] for step in (-1, 0, 1, 2)]).astype(np.float64)
        return values, position - first

    def along(self, direction: Values) -> Sampler:
        """What the right image has at steps along a direction (N,) of the disparity, and how fast it changes."""

        def sample(step: float) -> tuple[Values, Values]:
            value, slope = cubic(*self.samples(self.disparity + step * direction))
            return value, -slope * direction

        return sample


def grey(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Mean of the channels of (H, W, 3) uint8, as (H, W) float32 levels."""
    mean: NDArray[np.float32] = image.astype(np.float32).sum(axis=2) / np.float32(3)
    return mean


def check_images(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    match: Match,
    flat: NDArray[np.bool_],
    verdict: Verdict,
    *,
    imperfect: bool = False,
) -> None:
    """Check that the right image, warped by the left disparity, is the left image.

    First the share of pixels whose residual resampling explains; then, by least squares, the shift and the scale of the
    disparity at which the images fit best: both must be zero.

    Args:
        left: (H, W, 3) uint8.
        right: (H, W, 3) uint8.
        match: of the left view.
        flat: (H, W) bool, the pixels to judge: visible, on one surface.
        verdict: takes findings and measures.
        imperfect: whether exposure, noise, blur or a tone curve differ between the views: then levels cannot be
            compared, and only the correlation of the two is judged.
    """
    width = left.shape[1]
    found = np.flatnonzero(flat & (match.position >= 1) & (match.position < width - 2.001))
    if len(found) < FEWEST:
        return
    found = found[:: -(-len(found) // _MOST)]
    row, column = np.divmod(found, width)
    disparity = match.disparity[row, column].astype(np.float64)
    pixels = _Pixels(row, column, disparity, grey(left)[row, column].astype(np.float64), grey(right))
    samples, fraction = pixels.samples(disparity)
    warped = cubic(samples, fraction)[0]
    if imperfect:
        _check_correlation(pixels.left, warped, verdict)
        return
    residual = pixels.left - warped
    share = float(np.mean(_explained(pixels.left, samples)))
    verdict.measures["residual_median_levels"] = float(np.median(np.abs(residual)))
    verdict.measures["residual_explained_share"] = share
    if share < EXPLAINED_SHARE:
        verdict.add(
            "images",
            f"resampling explains the residual in {share:.1%} of {len(found)} visible pixels, at least "
            f"{EXPLAINED_SHARE:.0%} were expected; its median is {np.median(np.abs(residual)):.1f} levels",
        )
        return
    # A scale that moves a pair's pixels by no more than the shift that is allowed cannot be told from one.
    typical = float(np.sqrt(np.mean(disparity**2)))
    for name, unit, direction, least in (
        ("shift", "px", np.ones_like(disparity), SHIFT_PX),
        ("scale", "times", disparity, max(SCALE, SHIFT_PX / typical)),
    ):
        best = best_step(pixels.left, pixels.along(direction), direction**2, tiles(row, column, width))
        if best is None:
            return
        step, deviation = best
        verdict.measures[f"best_{name}_{unit}"] = step
        limit = least + DEVIATIONS * deviation
        if abs(step) > limit:
            where = f"d {step:+.3f} px" if name == "shift" else f"d times {1 + step:.4f}"
            verdict.add("images", f"they fit best at {where}; at most {limit:.4f} {unit} off was expected")


def _check_correlation(left: Values, warped: Values, verdict: Verdict) -> None:
    if min(float(left.std()), float(warped.std())) < 1:
        return
    correlation = float(np.corrcoef(left, warped)[0, 1])
    verdict.measures["image_correlation"] = correlation
    if correlation < _CORRELATION:
        verdict.add(
            "images", f"left and warped right correlate with {correlation:.2f}, at least {_CORRELATION} was expected"
        )


def _explained(left: Values, samples: Values) -> NDArray[np.bool_]:
    """Whether levels (N,) lie between the right image's pixels on either side, up to its curvature there.

    A function with second derivative at most c lies within c / 8 of its chord; the two second differences of the four
    pixels stand for c, doubled, since texture may bend between pixels more than it shows at them.
    """
    bend = np.maximum(
        np.abs(samples[0] - 2 * samples[1] + samples[2]), np.abs(samples[1] - 2 * samples[2] + samples[3])
    )
    margin = ROUNDING_LEVELS + BEND * bend
    low, high = np.minimum(samples[1], samples[2]) - margin, np.maximum(samples[1], samples[2]) + margin
    inside: NDArray[np.bool_] = (left >= low) & (left <= high)
    return inside


def cubic(samples: Values, fraction: Values) -> tuple[Values, Values]:
    """Value and slope (N,) of Catmull-Rom's cubic through four pixels (4, N): its error has no preferred direction."""
    before, first, second, after = samples
    linear = second - before
    square = 2 * before - 5 * first + 4 * second - after
    cube = 3 * (first - second) + after - before
    value = first + 0.5 * fraction * (linear + fraction * (square + fraction * cube))
    slope = 0.5 * (linear + fraction * (2 * square + 3 * fraction * cube))
    return value, slope


def tiles(row: NDArray[np.int64], column: NDArray[np.int64], width: int) -> NDArray[np.int64]:
    """Number the tile of the image that each pixel lies in, (N,) int64."""
    numbers: NDArray[np.int64] = (row // _TILE_PX) * (width // _TILE_PX + 1) + column // _TILE_PX
    return numbers


def best_step(wanted: Values, sample: Sampler, unit: Values, tile: NDArray[np.int64]) -> tuple[float, float] | None:
    """Find the step at which an image's samples fit the levels wanted best, by Gauss-Newton.

    Residuals of one surface resemble each other, so the deviation is taken from tiles of the image, not from pixels.

    Args:
        wanted: (N,) levels.
        sample: the image's, by step.
        unit: (N,) the square of the way that each pixel goes by a step of 1, px.
        tile: (N,) number of each pixel's tile.

    Returns:
        The step and its standard deviation, or None where there is no texture.
    """
    step = deviation = 0.0
    for _ in range(_STEPS):
        value, slope = sample(step)
        residual = wanted - value
        # Cauchy-like weights: pixels beside edges and under reduced texture do not decide.
        spread = 2 * (1.48 * float(np.median(np.abs(residual))) + 1)
        weight = (1 + (residual / spread) ** 2) ** -2
        pull = np.bincount(tile, slope * weight * residual)
        hold = np.bincount(tile, weight * slope**2)
        if hold.sum() < _TEXTURE * unit.sum():
            return None
        step += float(pull.sum() / hold.sum())
        deviation = float(np.sqrt(((pull - pull.sum() / hold.sum() * hold) ** 2).sum()) / hold.sum())
    return step, deviation
