"""Left and right disparity compared with each other, and the visibility masks compared with both."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.channels import OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.verification.agreement import SEEN_PX, UNCERTAIN, Agreement, Points, check_visibility
from semisynth_gl.verification.verdict import Verdict

Values = NDArray[np.float32]
Where = NDArray[np.bool_]

# Bounds; docs/verify.md derives them.
SMOOTH_PX = 0.25
"""Second difference of disparity, px, below which a pixel and its neighbours are one surface."""
HIDDEN_PX = 0.25
"""A point is hidden where both pixels around it have a disparity that is larger by more than this, px."""
_BORDER_PX = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class ViewMatch:
    """The pixels of one view matched with columns of the other view; arrays are (H, W) unless noted.

    Attributes:
        disparity: px, 0 where it is not valid.
        valid: where the view has a valid disparity.
        position: the column of the other view that shows the same point, px.
        inside: where both pixels around the position lie in the image.
        smooth: where the pixel and its two neighbours in the row are one surface.
        corners: (2, H, W) px, the other view's disparity in the two pixels around the position.
    """

    disparity: Values
    valid: Where
    position: NDArray[np.float64]
    inside: Where
    smooth: Where
    corners: Values

    def points(self, row: NDArray[np.intp], column: NDArray[np.intp]) -> Points:
        """Return pixels, by row (N,) and column (N,), with their points in the other view."""
        return Points(row, column, self.position[row, column], row.astype(np.float64), on_rows=True)

    @property
    def low(self) -> Values:
        """The smaller disparity of the two pixels around the position, (H, W) float32 px."""
        return np.asarray(self.corners.min(axis=0))

    @property
    def reference(self) -> Values:
        """The other view's disparity, interpolated at the position, (H, W) float32 px."""
        fraction = (self.position - np.floor(self.position)).astype(np.float32)
        return np.asarray(self.corners[0] * (1 - fraction) + self.corners[1] * fraction)

    @property
    def close(self) -> Where:
        """Where the two pixels' disparities differ by less than 1 px, as on one surface, (H, W) bool."""
        return np.asarray(np.ptp(self.corners, axis=0) < 1)


def match_views(own: Values, other: Values, direction: int, *, signed: bool = False) -> ViewMatch:
    """Find the place of each pixel of one view in the other view, by its disparity.

    Args:
        own: (H, W) float32 px, the disparity of the view.
        other: (H, W) float32 px, the disparity of the other view.
        direction: -1 to match the left view with the right one (x_right = x_left - d), +1 for the reverse.
        signed: whether disparities of 0 and below are valid.
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
    """Return where both views see the point, (H, W) bool, as the mask says, or without a mask the two disparities."""
    seen = match.low <= match.disparity + HIDDEN_PX if mask is None else mask == VISIBLE
    return np.asarray(match.inside & seen)


def one_surface(match: ViewMatch, visible: Where) -> Where:
    """Return the visible pixels whose surface continues to both sides in both views, (H, W) bool."""
    return visible & match.smooth & match.close


def check_left_right(
    left: Values, right: Values, match: ViewMatch, visible: Where, verdict: Verdict, *, signed: bool = False
) -> None:
    """Compare the left disparity with the right disparity at x - d, in the visible pixels.

    Disparity is linear along a row of a plane, so the right disparity, interpolated at x - d, is d again. Signed
    disparities below 1 px in size are not judged by their relative difference. Disparities are (H, W) px, and
    ``visible`` is (H, W) bool.
    """
    row, column = np.nonzero(visible & match.smooth)
    targets = match.points(row, column)
    names = "disparity_left", "disparity_right at x - d"
    corners = targets.corners(right[..., None])
    agreement = Agreement(names, left[..., None], corners, targets, 0.0, scaled_from_px=1.0 if signed else 0.0)
    agreement.check("left-right", "left_right", np.ones(len(row), bool), agreement.close, verdict)


def check_matched_mask(
    name: str, mask: NDArray[np.uint8], match: ViewMatch, borders: Where | None, verdict: Verdict
) -> None:
    """Check a mask's values, and that it agrees with the disparities and borders wherever these are conclusive.

    ``borders`` (H, W) is where a sensor saw nothing of the point; None for pairs without a lens.
    """
    # Beside depth edges the mask depends on where between two pixels of the other view a surface ends.
    border = mask.shape[1] - 0.5
    within = (match.position >= -0.5 + _BORDER_PX) & (match.position <= border - _BORDER_PX)
    beyond = (match.position < -0.5 - _BORDER_PX) | (match.position > border + _BORDER_PX)
    judged = match.valid & within & match.smooth
    expected = np.full(mask.shape, UNCERTAIN, np.uint8)
    expected[~match.valid | beyond] = OUTSIDE
    expected[judged & (match.low > match.disparity + HIDDEN_PX)] = OCCLUDED
    expected[judged & match.close & (np.abs(match.disparity - match.reference) < SEEN_PX)] = VISIBLE
    if borders is not None:
        expected[borders & match.valid & within] = OCCLUDED
    check_visibility(name, mask, match.valid, expected, verdict)
