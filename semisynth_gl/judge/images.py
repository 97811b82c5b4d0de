"""Images compared by disparity and flow: another image, resampled at the points to which they lead, gives the image.

Textures carry no light and move with their surfaces, so both images sample the same texture at the same point of a
surface. They differ by the error of interpolating the other image between its pixels, and by the imperfections of rigs.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.judge.agreement import MIN_PIXELS, Points, most_share
from semisynth_gl.judge.findings import Verdict

Values = NDArray[np.float32]
Image = NDArray[np.uint8]

# Bounds; docs/verify.md has them.
_ROUNDING_LEVELS = 2.0
_BEND = 0.25
_UNEXPLAINED_SHARE = 0.1
_SHIFT_PX = 0.25
_CORRELATION = 0.5
_CAP_LEVELS = 20.0
# Where moving the points by a pixel changes the residual by a smaller share, there is nothing to align.
_VALLEY = 0.1
# A position between two pixels of one row, and their neighbours.
_TAPS: tuple[int, ...] = (-1, 0, 1, 2)


def check_images(
    check: str,
    name: str,
    measure: str,
    images: tuple[Image, Image],
    points: Points,
    verdict: Verdict,
    *,
    imperfect: bool = False,
) -> None:
    """Check that the second image, resampled at the points to which vectors lead, is the first image.

    Resampling must explain the residuals of most pixels or, where imperfections or a lossy encoding change the images,
    both must correlate. They must fit better than with all points moved by a pixel to any side, and best where the
    points are: a parabola through the residuals at these three places has its least value near 0.

    Args:
        check: name of the check in findings.
        name: name of the vectors in findings.
        measure: beginning of the measures' names.
        images: the two images, each (H, W, 3) uint8 RGB or (H, W) grey.
        points: visible pixels of the first image on one surface, and their points in the second image.
        verdict: gets the findings and measures.
        imperfect: whether the images have the imperfections of a rig, or a lossy encoding.
    """
    height, width = images[1].shape[:2]
    inside = (points.x >= 2) & (points.x < width - 3.001)
    if not points.on_rows:
        inside &= (points.y >= 2) & (points.y < height - 3.001)
    points = points.select(inside)
    if len(points.x) < MIN_PIXELS:
        return
    levels, other = np.asarray(points.of(_grey(images[0])), np.float32), _grey(images[1])
    if imperfect:
        warped = _warped(other, points)
        if min(float(levels.std()), float(warped.std())) < 1:
            return
        correlation = float(np.corrcoef(levels, warped)[0, 1])
        verdict.measures[f"{measure}image_correlation"] = correlation
        if correlation < _CORRELATION:
            verdict.add(
                check, f"{name}: the images correlate with {correlation:.2f}, at least {_CORRELATION} was expected"
            )
            return
        # As bright, and as rich in contrast, as the other image.
        levels = (levels - levels.mean()) * (warped.std() / levels.std()) + warped.mean()
    else:
        explained = float(np.mean(_explained(levels, other, points)))
        least = 1 - most_share(_UNEXPLAINED_SHARE, len(levels))
        verdict.measures[f"{measure}residual_explained_share"] = explained
        if explained < least:
            verdict.add(
                check,
                f"{name}: resampling explains the residual in {explained:.1%} of {len(levels)} visible pixels, at "
                f"least {least:.1%} were expected",
            )
            return
    for axis in "x" if points.on_rows else "xy":
        shift_px = _best_shift_px(levels, other, points, axis)
        if shift_px is None:
            continue
        verdict.measures[f"{measure}best_shift_{axis}_px"] = shift_px
        if abs(shift_px) > _SHIFT_PX:
            verdict.add(
                check, f"{name}: the images fit best {shift_px:+.2f} px in {axis}; at most {_SHIFT_PX} px may be"
            )


def _best_shift_px(levels: Values, other: Values, points: Points, axis: str) -> float | None:
    """Return by how much the points would have to move along an axis for the best fit, at most a pixel either way.

    Moves by whole pixels interpolate alike, so that the error of interpolation moves nothing.

    Returns:
        The shift; None where the residuals hardly depend on it.
    """
    residuals = []
    for step in (-1, 0, 1):
        moved = replace(points, x=points.x + step * (axis == "x"), y=points.y + step * (axis == "y"))
        # Capped, so that pixels beside edges and on minified texture do not decide.
        residuals.append(float(np.minimum(np.abs(levels - _warped(other, moved)), _CAP_LEVELS).mean()))
    before, here, after = residuals
    if max(residuals) - min(residuals) < _VALLEY * max(residuals):
        return None
    if here > min(before, after):
        return -1.0 if before < after else 1.0
    return 0.5 * (before - after) / (before - 2 * here + after)


def _warped(other: Values, points: Points) -> Values:
    return np.asarray(points.between(points.corners(other[..., None]))[:, 0], np.float32)


def _grey(image: Image) -> Values:
    """Return the mean of the channels of (H, W, 3) uint8, or (H, W) uint8 as it is, as (H, W) float32 levels."""
    return image.astype(np.float32) if image.ndim == 2 else image.mean(axis=2, dtype=np.float32)


def _explained(levels: Values, other: Values, points: Points) -> NDArray[np.bool_]:
    """Return where levels (N,) lie in the range of the other image's pixels around the points, with a margin, (N,).

    A function whose second derivative is at most c lies within c / 8 of its chord. As c, the margin takes twice the
    pixels' second difference, since texture may bend more between pixels than their values show. The second differences
    of rows and columns are added.
    """
    column, row = np.floor(points.x).astype(np.int64), np.floor(points.y).astype(np.int64)
    if points.on_rows:
        samples = np.array([[other[points.row, column + right] for right in _TAPS]])
        inner, bend = samples[0, 1:3], np.abs(np.diff(samples, 2, axis=1)).max(axis=(0, 1))
    else:
        samples = np.array([[other[row + below, column + right] for right in _TAPS] for below in _TAPS])
        inner = samples[1:3, 1:3].reshape(4, -1)
        bend = np.abs(np.diff(samples[1:3], 2, axis=1)).max(axis=(0, 1))
        bend += np.abs(np.diff(samples[:, 1:3], 2, axis=0)).max(axis=(0, 1))
    margin = _ROUNDING_LEVELS + _BEND * bend
    inside: NDArray[np.bool_] = (levels >= inner.min(axis=0) - margin) & (levels <= inner.max(axis=0) + margin)
    return inside
