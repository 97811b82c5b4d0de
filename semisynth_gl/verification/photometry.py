"""Images compared by disparity and flow: another image, resampled at the points to which they lead, gives the image.

Textures carry no light and move with their surfaces, so both images sample the same texture at the same point of a
surface. They differ by the error of interpolating the other image between its pixels, and by the imperfections of rigs.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.verification.agreement import DEVIATIONS, MIN_PIXELS, Points, most_share, spread_evenly
from semisynth_gl.verification.verdict import Verdict
from semisynth_gl.verification.view_consistency import ViewMatch

Values = NDArray[np.float64]
Image = NDArray[np.uint8]

# Bounds; docs/verify.md derives them.
_ROUNDING_LEVELS = 2.0
_BEND = 0.25
_UNEXPLAINED_SHARE = 0.1
_SHIFT_PX, _SCALE = 0.02, 0.001
# With the imperfections of a rig.
_IMPERFECT_SHIFT_PX, _IMPERFECT_SCALE = 0.1, 0.005
_TILE_PX = 16
# Number of steps into which the distance between two pixels is divided.
_PHASES = 16
# Largest distance, px, by which interpolation may seem to shift the texture of a wall that faces the camera.
_PHASE_PX = 0.1
# Enough pixels to measure a shift to a thousandth of a pixel; more would only take longer.
_MAX_PIXELS = 200_000
# Flow leads between rows too, so each of its pixels reads sixteen pixels, many times over.
_MAX_FLOW_PIXELS = 40_000
_ITERATIONS = 4
# Below this mean squared slope (levels per pixel) there is no texture to align.
_TEXTURE = 0.25
# Least correlation of a pair's images with the imperfections of a rig, and at the best fit, for it to be judged.
_CORRELATION, _FITTING_CORRELATION = 0.5, 0.8
# Columns, and rows, of the pixels that a cubic reads, relative to the pixel left of, and above, the point.
_TAPS: tuple[int, ...] = (-1, 0, 1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class _Warp:
    """Grey levels (N,) of N pixels, and the corresponding points of another grey image (H, W)."""

    levels: Values
    other: NDArray[np.float32]
    targets: Points

    def samples(self, step: float, direction: Values) -> tuple[Values, Values, Values]:
        """Read the pixels around the points, which are first moved by ``step`` times a direction (N, 2) px.

        Returns:
            The levels (R, 4, N) of four pixels in each of R rows, R being 1 or 4; and the points' positions between the
            inner pixels, from 0 to 1, across (N,) and down (N,).
        """
        height, width = self.other.shape
        targets = self.targets
        x = (targets.x + step * direction[:, 0]).clip(1, width - 2.001)
        y = targets.y if targets.on_rows else (targets.y + step * direction[:, 1]).clip(1, height - 2.001)
        column, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        rows = _TAPS[1:2] if targets.on_rows else _TAPS
        values = [[self.other[row + below, column + right] for right in _TAPS] for below in rows]
        return np.array(values, np.float64), x - column, y - row

    def interpolate(self, step: float, direction: Values) -> tuple[Values, Values]:
        """Return the other image's levels at the moved points (see `samples`), and their derivatives by the step.

        Both are (N,).
        """
        samples, across, down = self.samples(step, direction)
        values, slopes = zip(*(_cubic(row, across) for row in samples), strict=True)
        if len(values) == 1:
            return values[0], slopes[0] * direction[:, 0]
        value, slope_down = _cubic(np.stack(values), down)
        slope_across = _cubic(np.stack(slopes), down)[0]
        return value, slope_across * direction[:, 0] + slope_down * direction[:, 1]


def check_images(
    left: Image,
    right: Image,
    match: ViewMatch,
    surface: NDArray[np.bool_],
    verdict: Verdict,
    *,
    imperfect: bool = False,
) -> None:
    """Check that the right image, resampled at x - d, is the left image.

    First, resampling must explain the residuals of most pixels. Then least squares find the shift and the change of
    scale of the disparity at which the images fit best: both must be about zero. On an imperfect rig, exposure, noise,
    blur or a tone curve differ between the views. There, the images must correlate, and fit best near zero after their
    levels are matched.

    Args:
        left: (H, W, 3) uint8 RGB, or (H, W) grey.
        right: as ``left``.
        match: the left view's match with the right view.
        surface: (H, W) bool, visible pixels on one surface; see `one_surface`.
        verdict: gets the findings and measures.
        imperfect: whether the images have the imperfections of a rig, or a lossy encoding.
    """
    width = left.shape[1]
    inside = surface & (match.position >= 1) & (match.position < width - 2.001)
    row, column = np.divmod(spread_evenly(np.flatnonzero(inside), _MAX_PIXELS), width)
    zero, disparity = np.zeros(len(row)), match.disparity[row, column].astype(np.float64)
    fits = {
        "shift_px": ("d", np.stack([zero - 1, zero], axis=1)),
        "scale_times": ("d", np.stack([-disparity, zero], axis=1)),
    }
    targets = match.points(row, column)
    _check_warp("images", "disparity_left", "", (left, right), targets, fits, verdict, imperfect=imperfect)


def check_flow_images(
    check: str,
    name: str,
    measure: str,
    images: tuple[Image, Image],
    targets: Points,
    verdict: Verdict,
    *,
    imperfect: bool = False,
) -> None:
    """Check that the second image, resampled at the points to which flow or correspondence leads, is the first image.

    Args:
        check: name of the check in findings.
        name: name of the flow in findings.
        measure: beginning of the measures' names, without the underscore that follows.
        images: the two images, each (H, W, 3) uint8 RGB or (H, W) grey.
        targets: visible pixels of the first image on one surface, and their points in the second image.
        verdict: gets the findings and measures.
        imperfect: as in `check_images`.
    """
    height, width = images[1].shape[:2]
    x, y = targets.x, targets.y
    inside = (x >= 1) & (x < width - 2.001) & (y >= 1) & (y < height - 2.001)
    targets = targets.select(spread_evenly(np.flatnonzero(inside), _MAX_FLOW_PIXELS))
    zero = np.zeros_like(targets.x)
    fits = {
        "shift_x_px": ("x", np.stack([zero + 1, zero], axis=1)),
        "shift_y_px": ("y", np.stack([zero, zero + 1], axis=1)),
        "scale_times": ("flow", np.stack([targets.x - targets.column, targets.y - targets.row], axis=1)),
    }
    _check_warp(check, name, f"{measure}_", images, targets, fits, verdict, imperfect=imperfect)


def _check_warp(
    check: str,
    name: str,
    measure: str,
    images: tuple[Image, Image],
    targets: Points,
    fits: Mapping[str, tuple[str, Values]],
    verdict: Verdict,
    *,
    imperfect: bool,
) -> None:
    """Judge the residuals, and the steps along directions at which the images fit best; see `check_images`.

    The keys of ``fits`` end the measures' names. The values are a symbol for messages, and the direction (N, 2) px in
    which a step of 1 moves the points.
    """
    if len(targets.x) < MIN_PIXELS:
        return
    levels = _grey(images[0])[targets.row, targets.column].astype(np.float64)
    warp, still = _Warp(levels, _grey(images[1]), targets), np.zeros((len(levels), 2))
    warped = warp.interpolate(0, still)[0]
    shift_px, scale = _SHIFT_PX, _SCALE
    if imperfect:
        if not _correlate(levels, warped, verdict):
            return
        # As bright, and as rich in contrast, as the other image.
        matched = (levels - levels.mean()) * (warped.std() / levels.std()) + warped.mean()
        warp, shift_px, scale = replace(warp, levels=matched), _IMPERFECT_SHIFT_PX, _IMPERFECT_SCALE
    elif not _check_explained(check, name, measure, warp, levels - warped, verdict):
        return
    for key, (symbol, direction) in fits.items():
        best = _best_step(warp, direction)
        if best is None:
            return
        step, deviation = best
        verdict.measures[f"{measure}best_{key}"] = step
        scaled = key == "scale_times"
        # A change of scale may move pixels by as much as the allowed shift does.
        allowed = shift_px / max(_length(direction), shift_px)
        bound = max(scale if scaled else 0.0, allowed) + DEVIATIONS * deviation
        # Where images hardly correlate even at their best, as under dots that are smaller than a pixel, it is chance.
        sure = not imperfect or _correlation(warp.levels, warp.interpolate(step, direction)[0]) >= _FITTING_CORRELATION
        if abs(step) > bound and sure:
            place, unit = (f"{symbol} times {1 + step:.4f}", "") if scaled else (f"{symbol} {step:+.3f} px", " px")
            verdict.add(check, f"{name}: the images fit best at {place}; a deviation of {bound:.4f}{unit} is allowed")


def _check_explained(check: str, name: str, measure: str, warp: _Warp, residual: Values, verdict: Verdict) -> bool:
    """Check that resampling explains the residuals (N,) of most pixels; return whether it does."""
    count = len(residual)
    share = float(np.mean(_explained(warp.levels, warp.samples(0, np.zeros((count, 2)))[0])))
    least = 1 - most_share(_UNEXPLAINED_SHARE, count)
    median = float(np.median(np.abs(residual)))
    verdict.measures[f"{measure}residual_median_levels"] = median
    verdict.measures[f"{measure}residual_explained_share"] = share
    if share < least:
        verdict.add(
            check,
            f"{name}: resampling explains the residual in {share:.1%} of {count} visible pixels, at least "
            f"{least:.1%} were expected; the median residual is {median:.1f} levels",
        )
    return share >= least


def _correlate(levels: Values, warped: Values, verdict: Verdict) -> bool:
    """Check that the levels of two images (N,) correlate; return whether they do, and have contrast at all."""
    if min(float(levels.std()), float(warped.std())) < 1:
        return False
    correlation = _correlation(levels, warped)
    verdict.measures["image_correlation"] = correlation
    if correlation < _CORRELATION:
        verdict.add(
            "images",
            f"the left image and the right one at the same points correlate with {correlation:.2f}, at least "
            f"{_CORRELATION} was expected",
        )
    return correlation >= _CORRELATION


def _correlation(one: Values, other: Values) -> float:
    return float(np.corrcoef(one, other)[0, 1])


def _grey(image: Image) -> NDArray[np.float32]:
    """Return the mean of the channels of (H, W, 3) uint8, or (H, W) uint8 as it is, as (H, W) float32 levels."""
    if image.ndim == 2:
        return image.astype(np.float32)
    mean: NDArray[np.float32] = image.astype(np.float32).sum(axis=2) / np.float32(3)
    return mean


def _explained(levels: Values, samples: Values) -> NDArray[np.bool_]:
    """Return where levels (N,) lie in the range of the inner pixels of samples (R, 4, N), with a margin, (N,) bool.

    A function whose second derivative is at most c lies within c / 8 of its chord. As c, the margin takes twice the
    pixels' second difference, since texture may bend more between pixels than their values show. The second differences
    of rows and columns are added.
    """
    rows = samples[1:3] if len(samples) > 1 else samples
    inner = rows[:, 1:3].reshape(-1, len(levels))
    bend = np.abs(np.diff(rows, 2, axis=1)).max(axis=(0, 1))
    if len(samples) > 1:
        bend += np.abs(np.diff(samples[:, 1:3], 2, axis=0)).max(axis=(0, 1))
    margin = _ROUNDING_LEVELS + _BEND * bend
    inside: NDArray[np.bool_] = (levels >= inner.min(axis=0) - margin) & (levels <= inner.max(axis=0) + margin)
    return inside


def _cubic(samples: Values, fraction: Values) -> tuple[Values, Values]:
    """Return value and slope, (N,) each, of Catmull-Rom's cubic through four pixels (4, N).

    The cubic is used because its error has no preferred direction.
    """
    before, first, second, after = samples
    linear = second - before
    square = 2 * before - 5 * first + 4 * second - after
    cube = 3 * (first - second) + after - before
    value = first + 0.5 * fraction * (linear + fraction * (square + fraction * cube))
    slope = 0.5 * (linear + fraction * (2 * square + 3 * fraction * cube))
    return value, slope


def _best_step(warp: _Warp, direction: Values) -> tuple[float, float] | None:
    """Return the step along a direction (N, 2) at which the images fit best, by Gauss-Newton, and its deviation.

    The result is None where there is no texture. Residuals are not independent: those of one surface resemble each
    other, and so do those of pixels whose points have the same phase, that is, lie at the same place between two pixels
    of the other image, as on a wall that faces the camera. So the standard deviation is estimated from tiles of the
    image and from phases, and the larger of the two counts. The estimate from phases is limited to the error that
    interpolation may cause.
    """
    step = deviation = 0.0
    texture = _TEXTURE * (direction**2).sum()
    targets, length = warp.targets, _length(direction)
    across, down = targets.column // _TILE_PX, targets.row // _TILE_PX
    tile = down * (warp.other.shape[1] // _TILE_PX + 1) + across
    right, below = (np.floor(_PHASES * (at - np.floor(at))).astype(np.int64) for at in (targets.x, targets.y))
    phase = below * _PHASES + right
    for _ in range(_ITERATIONS):
        value, slope = warp.interpolate(step, direction)
        residual = warp.levels - value
        # Cauchy-like weights, so that pixels beside edges and on minified texture do not decide.
        spread = 2 * (1.48 * float(np.median(np.abs(residual))) + 1)
        weight = (1 + (residual / spread) ** 2) ** -2
        pull, hold = slope * weight * residual, weight * slope**2
        if hold.sum() <= texture:
            return None
        step += float(pull.sum() / hold.sum())
        of_phases = min(_deviation(pull, hold, phase), _PHASE_PX / max(length, _PHASE_PX) / DEVIATIONS)
        deviation = max(_deviation(pull, hold, tile), of_phases)
    return step, deviation


def _length(direction: Values) -> float:
    """Return the root mean square of the lengths of vectors (N, 2)."""
    return float(np.sqrt(np.mean((direction**2).sum(axis=1))))


def _deviation(pull: Values, hold: Values, cluster: NDArray[np.int64]) -> float:
    """Return the standard deviation of sum(pull) / sum(hold), estimated by leaving out each cluster in turn.

    ``cluster`` (N,) has the number of each element's cluster. The result is inf where one cluster has all of ``hold``.
    """
    pulls, holds = np.bincount(cluster, pull), np.bincount(cluster, hold)
    total = holds.sum()
    rest = 1 - holds / total
    if rest.min() <= 0:
        return inf
    without = (pulls - pulls.sum() / total * holds) / rest
    return float(np.sqrt((without**2).sum()) / total)
