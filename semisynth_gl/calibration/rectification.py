"""How far the photographs of pairs are off rectified, as the section ``rig`` says it; see `calibration.vertical`."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from semisynth_gl.calibration.matching import MOST_PAIRS, match_pair
from semisynth_gl.calibration.rig import Rig, Size, median_size
from semisynth_gl.calibration.vertical import FEWEST, MATCHING_PX, FittedDeviation, agree, deviation_ranges
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.inputs.errors import InputError, counted
from semisynth_gl.seeds.spread import spread
from semisynth_gl.textures.images import stored_size

# A pair belongs to a rig of another resolution if width over height differs by no more.
_SAME_SHAPE = 0.02


@dataclass(frozen=True, slots=True)
class Rectification:
    """The deviations of several pairs' right cameras.

    ``ranges`` has the least and the largest value by key of the section ``rig``; it is empty where matching cannot tell
    the pairs from rectified ones. ``deviations`` and ``points``, the number of matches, are from the pairs that have
    enough matches.
    """

    ranges: dict[str, tuple[float, float]]
    deviations: tuple[FittedDeviation, ...]
    points: int
    pairs: int

    @property
    def origin(self) -> str:
        """A sentence on where the ranges are from."""
        used = len(self.deviations)
        residuals = sorted(each.residual_px for each in self.deviations)
        return (
            f"From {self.points} points that both views of {used} of {counted(self.pairs, 'pair')} show: rows then "
            f"differ by {residuals[len(residuals) // 2]:.2f} px (standard deviation, the median pair). Of several "
            "pairs the least and the largest of each value; what moves no row by more than "
            f"{MATCHING_PX:g} px is left out."
        )

    def summary(self) -> str:
        """Return what was found, in a line."""
        used = f"{len(self.deviations)} of {counted(self.pairs, 'pair')} matched"
        if not self.deviations:
            return f"unknown: none of {counted(self.pairs, 'pair')} has {FEWEST} points whose rows agree"
        if not self.ranges:
            return f"{used}: as good as matches can tell, {MATCHING_PX:g} px"
        shown = {
            key: f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}" for key, (low, high) in self.ranges.items()
        }
        return f"{used}: {', '.join(f'{key} {ends}' for key, ends in shown.items())}"


def fitting_pairs(pairs: Sequence[tuple[Path, Path]], rigs: Sequence[Rig]) -> list[tuple[Path, Path]]:
    """Return the pairs whose left photograph has the shape of a rig's images; see `measure_rectification`."""
    fitting = []
    for left, right in pairs:
        with suppress(InputError):
            height, width = stored_size(left)
            _camera_of(Size(width, height), rigs, left)
            fitting.append((left, right))
    return fitting


def measure_rectification(pairs: Sequence[tuple[Path, Path]], rigs: Sequence[Rig]) -> Rectification:
    """Match the views of one or more pairs, up to `MOST_PAIRS` of them, and fit the deviations of their right cameras.

    Pairs of another resolution count for the rig of the median size. Raises InputError where an image cannot be read, a
    pair's size is no rig's, or OpenCV is not installed.
    """
    chosen = [pairs[number] for number in spread(len(pairs), MOST_PAIRS)]
    matched, points = [], 0
    for left, right in chosen:
        matches, size = match_pair(left, right)
        camera = _camera_of(Size(*size), rigs, left)
        if agree(matches, camera):
            matched.append((matches, camera))
            points += len(matches.left)
    ranges, deviations = deviation_ranges(matched, median_size(rigs).width_px)
    return Rectification(ranges, deviations, points, len(chosen))


def _camera_of(size: Size, rigs: Sequence[Rig], path: Path) -> StereoCamera:
    """Return the rectified camera of images of a size."""
    for rig in rigs:
        if rig.size == size:
            return rig.camera
    median = median_size(rigs)
    if abs(size.width_px * median.height_px / (size.height_px * median.width_px) - 1) > _SAME_SHAPE:
        raise InputError(
            f"{path}: has {size} pixels, but the images of the calibration have {median}: expected pairs of this rig, "
            "at any resolution"
        )
    nearest = min(rigs, key=lambda rig: abs(rig.size.width_px - median.width_px))
    return nearest.scaled(size.width_px / nearest.size.width_px).camera
