"""Images compared by vectors: another image, resampled at the points to which they lead, gives the image.

Textures carry no light and move with their surfaces, so both images sample the same texture at the same point of a
surface. They differ by the error of interpolating the other image between its pixels, and by the imperfections of rigs.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from semisynth_gl.judge.findings import Verdict
from semisynth_gl.judge.interpolation import Floats

# Bounds; docs/verify.md has them.
MIN_PIXELS = 200
"""Least number of pixels for a median or a correlation."""
_EXPLAINED, _EXPLAINED_IMPERFECT = 0.8, -0.2
_SHIFT_PX = 0.25
_CAP_LEVELS = 20.0
# Where moving the points by a pixel changes the residual by a smaller share, there is nothing to align.
_VALLEY = 0.1


def check_images(
    check: str,
    name: str,
    measure: str,
    images: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    pixels: tuple[NDArray[np.intp], NDArray[np.intp]],
    points: tuple[Floats, Floats],
    verdict: Verdict,
    *,
    imperfect: bool = False,
) -> None:
    """Check that the second image, resampled at the points to which vectors lead, is the first image.

    It must explain 80 % of the variance. Imperfect images get equal brightness and contrast first, and must correlate
    by 0.4, which then explains -20 %. Both must fit best where the points are: a parabola through the residuals there,
    and with all points moved by a pixel to either side, has its least value near 0.

    Args:
        check: name of the check in findings.
        name: name of the vectors in findings.
        measure: beginning of the measures' names.
        images: the two images, each (H, W, 3) uint8 RGB or (H, W) grey.
        pixels: rows and columns (N,) of visible pixels of the first image.
        points: x and y (N,) px of their points in the second image.
        verdict: gets the findings and measures.
        imperfect: whether the images have the imperfections of a rig, or a lossy encoding.
    """
    own, other = (image.reshape(*image.shape[:2], -1).mean(axis=2) for image in images)
    height, width = other.shape
    x, y = points
    level_rows = bool((y == pixels[0]).all())
    inside = (x >= 1) & (x <= width - 2) & (((y >= 1) & (y <= height - 2)) | level_rows)
    if inside.sum() < MIN_PIXELS:
        return

    def warp(right_px: int, down_px: int) -> Floats:
        return np.asarray(map_coordinates(other, [y[inside] + down_px, x[inside] + right_px], order=1))

    levels, warped = own[pixels][inside], warp(0, 0)
    contrasts = levels.std(), warped.std()
    if max(contrasts) < 1 or (imperfect and min(contrasts) < 1):
        return
    least = _EXPLAINED
    if imperfect:
        levels, least = (levels - levels.mean()) * (warped.std() / levels.std()) + warped.mean(), _EXPLAINED_IMPERFECT
    explained = float(1 - np.mean((levels - warped) ** 2) / max(warped.var(), 1))
    verdict.measures[f"{measure}image_explained"] = explained
    if explained < least:
        verdict.add(check, f"{name}: the other image explains {explained:.0%} of the variance, not {least:.0%}")
        return
    for axis in "x" if level_rows else "xy":
        moved = (warp(step * (axis == "x"), step * (axis == "y")) for step in (-1, 0, 1))
        # Capped, so that pixels beside edges and on minified texture do not decide.
        shift_px = _least_at(*(float(np.minimum(abs(levels - there), _CAP_LEVELS).mean()) for there in moved))
        if shift_px is None:
            continue
        verdict.measures[f"{measure}best_shift_{axis}_px"] = shift_px
        if abs(shift_px) > _SHIFT_PX:
            verdict.add(check, f"{name}: the images fit best {shift_px:+.2f} px in {axis}, at most {_SHIFT_PX} may be")


def _least_at(before: float, here: float, after: float) -> float | None:
    """Return where a parabola through residuals at -1, 0 and 1 is least, within these; None where they are alike."""
    if max(before, here, after) - min(before, here, after) < _VALLEY * max(before, here, after):
        return None
    if here > min(before, after):
        return -1.0 if before < after else 1.0
    return 0.5 * (before - after) / (before - 2 * here + after)
