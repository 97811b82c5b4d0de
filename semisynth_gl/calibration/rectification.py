"""Deviations of photographed pairs from rectified ones, by key of the section ``rig``; see `calibration.vertical`."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from semisynth_gl.calibration.arrays import Size
from semisynth_gl.calibration.matching import MOST_PAIRS, match_pair
from semisynth_gl.calibration.rig import Rig, median_size
from semisynth_gl.calibration.vertical import MATCHING_PX, FittedDeviation, deviation_ranges, fit_deviation
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.inputs.errors import InputError, counted
from semisynth_gl.seeds.spread import spread
from semisynth_gl.textures.images import stored_size

# Largest relative difference in width over height between the images of one rig at different resolutions.
_SAME_SHAPE = 0.02
# How far below infinity's disparity, px, errors of calibration and matching may push far points.
_BEYOND_PX = 3.0
# A pair is used if this many of its matches, and this share of them, fit one deviation.
_FEWEST, _LEAST_SHARE = 40, 0.5
# Deviations larger than a knock or heat causes: shift of rows as a share of the width, turn in degrees, focal ratio.
_LARGE_SHIFT, _LARGE_TURN_DEG, _LARGE_RATIO = 0.01, 1.5, 0.02


@dataclass(frozen=True, slots=True)
class Rectification:
    """The deviations of several pairs' right cameras.

    Attributes:
        ranges: least and largest value by key of the section ``rig``; empty where matching cannot tell the pairs from
            rectified ones.
        deviations: deviation of each pair that could be used: at least 40 of its matches, and half of all, fit it.
        points: number of matches in these pairs.
        pairs: number of pairs that were matched, whether they could be used or not.
    """

    ranges: dict[str, tuple[float, float]]
    deviations: tuple[FittedDeviation, ...]
    points: int
    pairs: int

    @property
    def origin(self) -> str:
        """Sentences on the origin of the ranges, for a comment; there must be deviations."""
        used = len(self.deviations)
        residuals = sorted(each.residual_px for each in self.deviations)
        return (
            f"From {self.points} points that both views of {used} of {counted(self.pairs, 'pair')} show: rows then "
            f"differ by {residuals[len(residuals) // 2]:.2f} px (standard deviation, the median pair). Of several "
            "pairs the least and the largest of each value; what moves no row by more than "
            f"{MATCHING_PX:g} px is left out."
        )

    def is_large(self, width_px: int) -> bool:
        """Return whether a deviation is too large for a rectified rig, for images of a width."""
        limits = {"right_y_px": _LARGE_SHIFT * width_px, "focal_ratio": _LARGE_RATIO}
        return any(
            abs(end - (key == "focal_ratio")) > limits.get(key, _LARGE_TURN_DEG)
            for key, ends in self.ranges.items()
            for end in ends
        )

    def summary(self) -> str:
        """Return the result in a line."""
        used = f"{len(self.deviations)} of {counted(self.pairs, 'pair')} matched"
        if not self.deviations:
            return f"unknown: none of {counted(self.pairs, 'pair')} has enough fitting matches ({_FEWEST}, half of all)"
        if not self.ranges:
            return f"{used}: rectified within the accuracy of matching, {MATCHING_PX:g} px"
        shown = {
            key: f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}" for key, (low, high) in self.ranges.items()
        }
        return f"{used}: {', '.join(f'{key} {ends}' for key, ends in shown.items())}"


def fitting_pairs(pairs: Sequence[tuple[Path, Path]], rigs: Sequence[Rig]) -> list[tuple[Path, Path]]:
    """Return the pairs whose left photograph has the size of a rig's images, or their shape at another resolution."""
    fitting = []
    for left, right in pairs:
        with suppress(InputError):
            height, width = stored_size(left)
            _camera_of(Size(width, height), rigs, left)
            fitting.append((left, right))
    return fitting


def measure_rectification(pairs: Sequence[tuple[Path, Path]], rigs: Sequence[Rig]) -> Rectification:
    """Match the views of one or more pairs, at most `MOST_PAIRS`, and fit the deviations of their right cameras.

    A pair whose size is not that of a rig is taken for one of the rig nearest to the median width, at another
    resolution. Raises InputError where an image cannot be read, a pair has another shape than the rig's images or its
    views seem to have changed places, or OpenCV is not installed.
    """
    chosen = [pairs[number] for number in spread(len(pairs), MOST_PAIRS)]
    matched = []
    for left, right in chosen:
        matches, size = match_pair(left, right)
        camera, count = _camera_of(Size(*size), rigs, left), len(matches.left)
        share = fit_deviation(matches, camera, pitch=False).share if count >= _FEWEST else 0.0
        if share < _LEAST_SHARE or share * count < _FEWEST:
            continue
        beyond_px = float(np.median(matches.left[:, 0] - matches.right[:, 0])) + camera.doffs_px
        if beyond_px < -_BEYOND_PX:
            raise InputError(
                f"{left} {right}: half of the points have disparities {-beyond_px:.1f} px or more below infinity's: "
                "expected the left view, then the right one, both rectified",
                argument="pairs",
            )
        matched.append((matches, camera))
    ranges, deviations = deviation_ranges(matched, median_size(rigs).width_px)
    return Rectification(ranges, deviations, sum(len(each.left) for each, _ in matched), len(chosen))


def _camera_of(size: Size, rigs: Sequence[Rig], path: Path) -> StereoCamera:
    """Return the rectified camera of images of ``size``; raises InputError, naming ``path``, if no rig fits."""
    for rig in rigs:
        if rig.size == size:
            return rig.camera
    median = median_size(rigs)
    if abs(size.width_px * median.height_px / (size.height_px * median.width_px) - 1) > _SAME_SHAPE:
        raise InputError(
            f"{path}: has {size} pixels, but the images of the calibration have {median}: expected pairs of this rig, "
            "with the same ratio of width to height"
        )
    nearest = min(rigs, key=lambda rig: abs(rig.size.width_px - median.width_px))
    return nearest.scaled(size.width_px / nearest.size.width_px).camera
