"""Deviations of pairs from rectified ones: the right camera's deviation is fitted to the rows of matched points.

A right camera at the rectified camera's place that is turned, or has another focal length or a lower principal point,
shifts each point of its image by an amount that does not depend on depth. So the deviation that brings the rows of all
right points to the rows of the left ones can be fitted without depths and without linearising the model.

Signs follow the config's section ``rig``: the camera's frame is x right, y down, z forward, and the rotation
right_from_rectified = Rx(pitch) Rz(roll), both right-handed. A positive roll turns the contents of the right image
clockwise, a positive pitch moves them up, and a positive ``right_y_px`` moves them down.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import StereoCamera

KEYS = ("right_y_px", "right_roll_deg", "focal_ratio", "right_pitch_deg")
"""Keys of the section ``rig``, in the order in which a deviation's numbers are listed."""
MATCHING_PX = 0.2
"""Accuracy of matching: a deviation that moves no row by more than this may come from errors of matches.
docs/calibrate.md names the rectified photographs on which it was measured."""

Values = NDArray[np.float64]

# Number of iterations of a fit, and of the first ones, with absolute residuals.
_ITERATIONS, _ROUGH_ITERATIONS = 30, 8
# Matches whose difference in rows is farther than this from the median, as a fraction of the height, are wrong.
_MOST_OF_HEIGHT = 0.15
# Least standard deviation of a match, so that the weights of perfect matches stay finite.
_LEAST_SIGMA_PX = 0.02
# Residuals of this many standard deviations and more get no weight (Tukey's biweight).
_TUKEY = 4.685
# A pitch is sure if it is larger than this many of its standard deviations.
_SURE_DEVIATIONS = 4.0
# Steps of the numbers for numerical derivatives: px, radians, a ratio, radians.
_STEPS = np.diag([1e-3, 1e-6, 1e-6, 1e-6])


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """N matched points of a pair: ``left`` and ``right`` are (N, 2) float64, x and y px; row i of both is a match."""

    left: Values
    right: Values


@dataclass(frozen=True, slots=True)
class FittedDeviation:
    """The deviation of a pair's right camera, see `semisynth_gl.frame.camera.Deviation`, and its accuracy.

    Attributes:
        y_px: distance by which the right principal point lies below the rectified one.
        roll_rad: rotation about the viewing direction.
        focal_ratio: ratio of the right focal length to the rectified one.
        pitch_rad: rotation about the x axis; 0 where pitch was not fitted.
        residual_px: standard deviation of the differences in rows that remain, over the matches that fit.
        share: share of the matches that fit.
        pitch_error_rad: standard deviation of ``pitch_rad``; inf where pitch was not fitted.
    """

    y_px: float
    roll_rad: float
    focal_ratio: float
    pitch_rad: float
    residual_px: float
    share: float
    pitch_error_rad: float = np.inf

    def numbers(self, scale: float = 1.0) -> tuple[float, float, float, float]:
        """Return the numbers in the units and the order of `KEYS`, for images ``scale`` times as wide."""
        return self.y_px * scale, float(np.rad2deg(self.roll_rad)), self.focal_ratio, float(np.rad2deg(self.pitch_rad))


def deviation_ranges(
    pairs: Sequence[tuple[Matches, StereoCamera]], width_px: int
) -> tuple[dict[str, tuple[float, float]], tuple[FittedDeviation, ...]]:
    """Return the ranges of the section ``rig`` over pairs, for images ``width_px`` wide, and each pair's deviation.

    Each pair consists of matches and the rectified camera of its images. The ranges are the least and the
    largest value by key of `KEYS`. A key is left out if it moves rows by no more than `MATCHING_PX` (root mean square
    over pairs, of the rows that it moves most), since that could come from errors of matches. Pitch moves upper and
    lower rows more than those in the middle; only a wide view can tell it from ``right_y_px``.
    """
    if not pairs:
        return {}, ()
    fits = [fit_deviation(matches, camera, pitch=True) for matches, camera in pairs]
    sure = [abs(fit.pitch_rad) > _SURE_DEVIATIONS * fit.pitch_error_rad for fit in fits]
    if _moved_px(fits, pairs)[3] <= MATCHING_PX or np.mean(sure) <= 0.5:
        fits = [fit_deviation(matches, camera, pitch=False) for matches, camera in pairs]
    values = [fit.numbers(width_px / camera.width_px) for fit, (_, camera) in zip(fits, pairs, strict=True)]
    both = zip(KEYS, zip(*values, strict=True), _moved_px(fits, pairs), strict=True)
    return {key: (min(each), max(each)) for key, each, moved_px in both if moved_px > MATCHING_PX}, tuple(fits)


def fit_deviation(matches: Matches, camera: StereoCamera, *, pitch: bool) -> FittedDeviation:
    """Fit the deviation that brings right points to the rows of the left ones, robustly, since some matches are wrong.

    ``camera`` is the rectified camera of the pair's images. With ``pitch``, four numbers are fitted, otherwise three
    and the pitch is 0; there must be at least as many matches.
    """
    rows = matches.left[:, 1]
    difference = matches.right[:, 1] - rows
    near = np.abs(difference - np.median(difference)) < _MOST_OF_HEIGHT * camera.height_px
    left, right = matches.left[near], matches.right[near]
    count = 4 if pitch else 3
    numbers = np.array([np.median(right[:, 1] - left[:, 1]), 0.0, 1.0, 0.0])
    inverse, sigma, weight = np.zeros((count, count)), 1.0, np.ones(len(left))
    for iteration in range(_ITERATIONS):
        residual = rectified_rows(right, camera, numbers) - left[:, 1]
        sigma = max(1.4826 * float(np.median(np.abs(residual))), _LEAST_SIGMA_PX)
        if iteration < _ROUGH_ITERATIONS:
            # First minimise absolute residuals, whose sum has a single minimum, wherever the fit begins.
            weight = 1 / np.maximum(np.abs(residual), sigma)
        else:
            weight = np.maximum(1 - (residual / (_TUKEY * sigma)) ** 2, 0) ** 2
        ends = [[rectified_rows(right, camera, numbers + sign * step) for sign in (1, -1)] for step in _STEPS[:count]]
        slopes = np.stack([(up - down) / (2 * step.sum()) for (up, down), step in zip(ends, _STEPS, strict=False)], 1)
        # Scale the columns to length 1, so that the sums are well conditioned.
        unit = np.maximum(np.sqrt((weight[:, None] * slopes**2).sum(axis=0)), 1e-12)
        scaled = slopes / unit
        inverse = np.linalg.pinv((weight[:, None] * scaled).T @ scaled, rcond=1e-9) / np.outer(unit, unit)
        numbers[:count] -= inverse @ (slopes.T @ (weight * residual))
    fits = weight > 0
    spread_px = float(residual[fits].std()) if fits.any() else float("inf")
    error = spread_px * float(np.sqrt(inverse[3, 3])) if pitch else float("inf")
    y_px, roll_rad, ratio, pitch_rad = map(float, numbers)
    return FittedDeviation(y_px, roll_rad, ratio, pitch_rad, spread_px, float(fits.sum() / max(len(rows), 1)), error)


def rectified_rows(right: Values, camera: StereoCamera, numbers: Values) -> Values:
    """Return the rows (N,) that right points (N, 2) would have in the image of the rectified ``camera``.

    ``numbers``, (4,), are y_px, roll_rad, focal_ratio and pitch_rad of the deviating camera that took the points.
    """
    y_px, roll_rad, ratio, pitch_rad = numbers
    x = (right[:, 0] - camera.cx_right_px) / (camera.focal_px * ratio)
    y = (right[:, 1] - camera.cy_px - y_px) / (camera.focal_y_px * ratio)
    # Undo Rx(pitch), then Rz(roll).
    sine, cosine = np.sin(pitch_rad), np.cos(pitch_rad)
    unpitched, depth = cosine * y + sine, cosine - sine * y
    row: Values = camera.focal_y_px * (np.cos(roll_rad) * unpitched - np.sin(roll_rad) * x) / depth + camera.cy_px
    return row


def _moved_px(fits: Sequence[FittedDeviation], pairs: Sequence[tuple[Matches, StereoCamera]]) -> Values:
    """Return how far each number moves the rows that it moves most, (4,): root mean squares over pairs.

    A pitch counts relative to the middle rows.
    """
    moved = []
    for fit, (_, camera) in zip(fits, pairs, strict=True):
        across, down = (camera.width_px - 1) / 2, (camera.height_px - 1) / 2
        bend_px = fit.pitch_rad * down**2 / camera.focal_y_px
        moved.append((fit.y_px, fit.roll_rad * across, (fit.focal_ratio - 1) * down, bend_px))
    rms: Values = np.sqrt(np.mean(np.square(moved), axis=0))
    return rms
