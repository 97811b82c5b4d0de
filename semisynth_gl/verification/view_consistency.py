"""The two disparities against each other, and the visibility masks against both."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.frame import OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.verification.agreement import SEEN_PX, UNCERTAIN, Agreement, Points, check_visibility
from semisynth_gl.verification.verdict import Verdict

Values = NDArray[np.float32]
Where = NDArray[np.bool_]

# Bounds; docs/verify.md derives them.
SMOOTH_PX = 0.25
"""A pixel and its neighbours are one surface where the second difference is smaller."""
HIDDEN_PX = 0.25
"""A point is hidden where both pixels around it are nearer by more."""
_BORDER_PX = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class ViewMatch:
    """The pixels (H, W) of one view, and their positions, which are columns of the other view.

    Attributes:
        disparity: px, 0 where it is not valid.
        inside: where both pixels around the position lie in the image.
        smooth: where the pixel and its neighbours in the row are one surface.
        corners: (2, H, W), the other view's disparity in the two pixels around the position.
    """

    disparity: Values
    valid: Where
    position: NDArray[np.float64]
    inside: Where
    smooth: Where
    corners: Values

    def points(self, row: NDArray[np.intp], column: NDArray[np.intp]) -> Points:
        """Return pixels (N,) with their points in the other view."""
        return Points(row, column, self.position[row, column], row.astype(np.float64), on_rows=True)

    @property
    def low(self) -> Values:
        """The smaller disparity of the two pixels, (H, W) float32."""
        return np.asarray(self.corners.min(axis=0))

    @property
    def reference(self) -> Values:
        """The other view's disparity, interpolated at the column, (H, W) float32."""
        fraction = (self.position - np.floor(self.position)).astype(np.float32)
        return np.asarray(self.corners[0] * (1 - fraction) + self.corners[1] * fraction)

    @property
    def close(self) -> Where:
        """Where the two pixels have similar disparities, as on one surface, (H, W) bool."""
        return np.asarray(np.ptp(self.corners, axis=0) < 1)


def match_views(own: Values, other: Values, direction: int, *, signed: bool = False) -> ViewMatch:
    """Look each pixel of one view up in the other one by its disparity, (H, W) float32 px each.

    The direction is -1 for the left view (x_right = x_left - d), and +1 for the right one.
    """
    height, width = own.shape
    valid = np.isfinite(own) & (signed | (own > 0))
    disparity = np.where(valid, own, np.float32(0))
    position = np.arange(width) + direction * disparity.astype(np.float64)
    column = np.floor(position).astype(np.int64)
    row = np.arange(height)[:, None]
    smooth = np.zeros((height, width), bool)
    if width > 2:
        smooth[:, 1:-1] = np.abs(np.diff(disparity, 2, axis=1)) < SMOOTH_PX
    return ViewMatch(
        disparity=disparity,
        valid=valid,
        position=position,
        inside=valid & (position >= 0) & (position <= width - 1),
        smooth=smooth,
        corners=np.stack([other[row, (column + step).clip(0, width - 1)] for step in (0, 1)]),
    )


def visible_pixels(match: ViewMatch, mask: NDArray[np.uint8] | None) -> Where:
    """Return where both views see a point, (H, W) bool: by the mask, or by the two disparities without one."""
    seen = match.low <= match.disparity + HIDDEN_PX if mask is None else mask == VISIBLE
    return np.asarray(match.inside & seen)


def one_surface(match: ViewMatch, visible: Where) -> Where:
    """Return which of the visible pixels lie on a surface that goes on to both sides in both views, (H, W) bool."""
    return visible & match.smooth & match.close


def check_left_right(
    left: Values, right: Values, match: ViewMatch, visible: Where, verdict: Verdict, *, signed: bool = False
) -> None:
    """Check the left disparity against the right one at x - d, in visible pixels, (H, W) px each.

    Disparity is linear along the row of a plane, so the right one, interpolated at x - d, is d again. Signed
    disparities about 0 have no relative difference.
    """
    row, column = np.nonzero(visible & match.smooth)
    targets = match.points(row, column)
    names = "disparity_left", "disparity_right at x - d"
    corners = targets.corners(right[..., None])
    agreement = Agreement(names, left[..., None], corners, targets, 0.0, scaled_from_px=1.0 if signed else 0.0)
    agreement.check("left-right", "left_right", np.ones(len(row), bool), agreement.close, verdict)


def check_matched_mask(name: str, mask: NDArray[np.uint8], match: ViewMatch, verdict: Verdict) -> None:
    """Check a mask, and that it agrees with the disparities where they leave no doubt."""
    # Beside depth edges the mask depends on where between two pixels of the other view a surface ends.
    border = mask.shape[1] - 0.5
    within = (match.position >= -0.5 + _BORDER_PX) & (match.position <= border - _BORDER_PX)
    beyond = (match.position < -0.5 - _BORDER_PX) | (match.position > border + _BORDER_PX)
    judged = match.valid & within & match.smooth
    expected = np.full(mask.shape, UNCERTAIN, np.uint8)
    expected[~match.valid | beyond] = OUTSIDE
    expected[judged & (match.low > match.disparity + HIDDEN_PX)] = OCCLUDED
    expected[judged & match.close & (np.abs(match.disparity - match.reference) < SEEN_PX)] = VISIBLE
    check_visibility(name, mask, match.valid, expected, verdict)
