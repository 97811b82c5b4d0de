"""How far pairs are off rectified: the right camera's deviation that explains the rows of matched points.

A right camera that stands where the rectified one would, but is turned, or has another focal length or a lower
principal point, moves each point of its image to a place that does not depend on depth. So what brings the rows of all
right points to the rows of the left ones is the deviation, with no depth known and nothing linearised.

Signs follow the config's section ``rig``: the camera's frame is x right, y down, z forward, and the rotation
right_from_rectified = Rx(pitch) Rz(roll), both right-handed: a positive roll turns what the right image shows
clockwise, a positive pitch moves it upwards, and a positive ``right_y_px`` moves it down.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import StereoCamera

KEYS = ("right_y_px", "right_roll_deg", "focal_ratio", "right_pitch_deg")
"""Keys of the section ``rig``, in the order of the deviation's numbers."""
MATCHING_PX = 0.2
"""What matching can tell: a deviation that moves no row by more may be one of matches. docs/calibrate.md says of which
rectified photographs this was measured."""
FEWEST = 40
"""Matches that fit without which a pair says nothing."""

Values = NDArray[np.float64]

_ITERATIONS, _ROUGH_ITERATIONS = 30, 8
# Matches whose rows differ by more are wrong, of the height.
_MOST_OF_HEIGHT = 0.15
# Least noise of a match, so that perfect ones do not weigh infinitely.
_LEAST_SIGMA_PX = 0.02
_TUKEY = 4.685
_SURE_DEVIATIONS = 4.0
_LEAST_SHARE = 0.5
_NONE = np.array([0.0, 0.0, 1.0, 0.0])
# Small steps of the numbers, by which derivatives are taken: px, radians, a ratio, radians.
_STEPS = np.array([1e-3, 1e-6, 1e-6, 1e-6])


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Points that both views of a pair show, (N, 2) float64 each, x and y px."""

    left: Values
    right: Values


@dataclass(frozen=True, slots=True)
class FittedDeviation:
    """The deviation of a pair's right camera, see `semisynth_gl.frame.camera.Deviation`, and how well it is known.

    ``pitch_rad`` is 0 where the rows cannot tell it from ``y_px``, and its standard deviation ``pitch_error_rad`` then
    inf. ``residual_px`` is the standard deviation of the rows that fit, and ``share`` the share of the matches that
    fit.
    """

    y_px: float
    roll_rad: float
    focal_ratio: float
    pitch_rad: float
    residual_px: float
    share: float
    pitch_error_rad: float = np.inf

    def numbers(self, scale: float = 1.0) -> tuple[float, float, float, float]:
        """Return the numbers in the units and the order of `KEYS`, for images so many times as wide."""
        return self.y_px * scale, float(np.rad2deg(self.roll_rad)), self.focal_ratio, float(np.rad2deg(self.pitch_rad))


def agree(matches: Matches, camera: StereoCamera) -> bool:
    """Return whether enough of a pair's matches fit one deviation."""
    if len(matches.left) < FEWEST:
        return False
    share = fit_deviation(matches, camera, pitch=False).share
    return share >= _LEAST_SHARE and share * len(matches.left) >= FEWEST


def deviation_ranges(
    pairs: Sequence[tuple[Matches, StereoCamera]], width_px: int
) -> tuple[dict[str, tuple[float, float]], tuple[FittedDeviation, ...]]:
    """Return the ranges of the section ``rig`` over pairs, for images ``width_px`` wide, and each pair's deviation.

    Each pair is matches that `agree`, with the rectified camera of its images. A key whose deviation moves rows by no
    more than `MATCHING_PX` (the root mean square over pairs, of the rows that it moves most) is left out: it is not
    told from matches that are a little off. Pitch is told by what it moves the upper and lower rows more than those in
    the middle, which takes a wide view.
    """
    if not pairs:
        return {}, ()
    cameras = [camera for _, camera in pairs]
    full = [fit_deviation(matches, camera, pitch=True) for matches, camera in pairs]
    sure = [abs(each.pitch_rad) > _SURE_DEVIATIONS * each.pitch_error_rad for each in full]
    moved = np.array([_most_px(*both) for both in zip(full, cameras, strict=True)])
    if _rms(moved[:, 3]) <= MATCHING_PX or np.mean(sure) <= 0.5:
        full = [fit_deviation(matches, camera, pitch=False) for matches, camera in pairs]
        moved = np.array([_most_px(*both) for both in zip(full, cameras, strict=True)])
    ranges = {}
    for number, key in enumerate(KEYS):
        if _rms(moved[:, number]) > MATCHING_PX:
            both = zip(full, cameras, strict=True)
            values = [each.numbers(width_px / camera.width_px)[number] for each, camera in both]
            ranges[key] = min(values), max(values)
    return ranges, tuple(full)


def fit_deviation(matches: Matches, camera: StereoCamera, *, pitch: bool) -> FittedDeviation:
    """Fit the deviation that brings right points to the rows of the left ones, robustly, as some matches are wrong.

    ``camera`` is the rectified camera of the pair's images. There are at least as many matches as numbers to fit.
    """
    rows = matches.left[:, 1]
    difference = matches.right[:, 1] - rows
    near = np.abs(difference - np.median(difference)) < _MOST_OF_HEIGHT * camera.height_px
    left, right = matches.left[near], matches.right[near]
    fitted = range(4 if pitch else 3)
    numbers = _NONE.copy()
    numbers[0] = float(np.median(right[:, 1] - left[:, 1]))
    inverse, sigma, weight = np.zeros((len(fitted), len(fitted))), 1.0, np.ones(len(left))
    for iteration in range(_ITERATIONS):
        residual = rectified_rows(right, camera, numbers) - left[:, 1]
        sigma = max(1.4826 * float(np.median(np.abs(residual))), _LEAST_SIGMA_PX)
        if iteration < _ROUGH_ITERATIONS:
            # First the absolute residuals, which have one least sum wherever the fit begins.
            weight = 1 / np.maximum(np.abs(residual), sigma)
        else:
            weight = np.maximum(1 - (residual / (_TUKEY * sigma)) ** 2, 0) ** 2
        slopes = np.stack([_slope(right, camera, numbers, number) for number in fitted], axis=1)
        # In units of a row, so that the sums are well conditioned.
        unit = np.maximum(np.sqrt((weight[:, None] * slopes**2).sum(axis=0)), 1e-12)
        scaled = slopes / unit
        inverse = np.linalg.pinv((weight[:, None] * scaled).T @ scaled, rcond=1e-9) / np.outer(unit, unit)
        numbers[: len(fitted)] -= inverse @ (slopes.T @ (weight * residual))
    fits = weight > 0
    spread_px = float(residual[fits].std()) if fits.any() else float("inf")
    error = spread_px * float(np.sqrt(inverse[3, 3])) if pitch else float("inf")
    y_px, roll_rad, ratio, pitch_rad = map(float, numbers)
    return FittedDeviation(y_px, roll_rad, ratio, pitch_rad, spread_px, float(fits.sum() / max(len(rows), 1)), error)


def rectified_rows(right: Values, camera: StereoCamera, numbers: Values) -> Values:
    """Return the rows (N,) that right points (N, 2) would have in the image of the rectified ``camera``.

    ``numbers`` are y_px, roll_rad, focal_ratio, pitch_rad of the camera that took them.
    """
    y_px, roll_rad, ratio, pitch_rad = numbers
    x = (right[:, 0] - camera.cx_right_px) / (camera.focal_px * ratio)
    y = (right[:, 1] - camera.cy_px - y_px) / (camera.focal_px * ratio)
    # Back by Rx(pitch), then by Rz(roll).
    sine, cosine = np.sin(pitch_rad), np.cos(pitch_rad)
    unpitched, depth = cosine * y + sine, cosine - sine * y
    row: Values = camera.focal_px * (np.cos(roll_rad) * unpitched - np.sin(roll_rad) * x) / depth + camera.cy_px
    return row


def _slope(right: Values, camera: StereoCamera, numbers: Values, number: int) -> Values:
    """Return the derivative of the rows by one of the numbers."""
    step = np.zeros(4)
    step[number] = _STEPS[number]
    ends = (rectified_rows(right, camera, numbers + sign * step) for sign in (1, -1))
    slope: Values = np.subtract(*ends) / (2 * _STEPS[number])
    return slope


def _most_px(deviation: FittedDeviation, camera: StereoCamera) -> tuple[float, float, float, float]:
    """Return by how much each of the numbers moves the row that it moves most; pitch, beyond what y_px moves too."""
    across, down = (camera.width_px - 1) / 2, (camera.height_px - 1) / 2
    bend_px = deviation.pitch_rad * down**2 / camera.focal_px
    return deviation.y_px, deviation.roll_rad * across, (deviation.focal_ratio - 1) * down, bend_px


def _rms(values: Values) -> float:
    return float(np.sqrt(np.mean(values**2)))
