"""The two disparities against each other, and the masks against both."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame import OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.verify.finding import Verdict

Values = NDArray[np.float32]
Where = NDArray[np.bool_]

# Bounds; docs/verify.md derives them.
SMOOTH_PX = 0.25  # second difference along the row, below which a pixel and its neighbours are one surface
OUTSIDE_PX = 0.2
OUTSIDE_SHARE = 0.02
MEDIAN_PX = 0.01
MEDIAN_SHARE = 0.002
HIDDEN_PX = 0.25
SEEN_PX = 0.05
_BORDER_PX = 1e-3
MASK_SHARE = 0.01
CLASS_SHARE = 0.05
FEWEST = 200
"""Below this many pixels a share or a median says nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Where the pixels of one view lie in the other one, all (H, W).

    Attributes:
        disparity: float32, px; 0 where it is invalid.
        valid: bool.
        position: float64, column in the other view.
        first: float32, the other view's disparity at the pixel before that column.
        second: float32, at the pixel after it.
        between: bool, whether both of these lie in the image.
        smooth: bool, whether the pixel and its neighbours in the row are one surface.
    """

    disparity: Values
    valid: Where
    position: NDArray[np.float64]
    first: Values
    second: Values
    between: Where
    smooth: Where

    @property
    def low(self) -> Values:
        """The smaller disparity of the two pixels."""
        return np.minimum(self.first, self.second)

    @property
    def high(self) -> Values:
        """The larger one."""
        return np.maximum(self.first, self.second)

    @property
    def difference(self) -> Values:
        """Disparity minus the other view's, interpolated at the position; px."""
        fraction = (self.position - np.floor(self.position)).astype(np.float32)
        with np.errstate(invalid="ignore"):
            result: Values = self.disparity - (self.first * (1 - fraction) + self.second * fraction)
        return result


def match_views(own: Values, other: Values, direction: int) -> Match:
    """Find each pixel of one view in the other one by its disparity.

    Args:
        own: (H, W) float32 px, of the view whose pixels are looked up.
        other: likewise, of the other view.
        direction: -1 for the left view (x_right = x_left - d), +1 for the right one.
    """
    height, width = own.shape
    valid = np.isfinite(own) & (own > 0)
    disparity = np.where(valid, own, np.float32(0))
    position = np.arange(width) + direction * disparity.astype(np.float64)
    column = np.floor(position).astype(np.int64)
    row = np.arange(height)[:, None]
    first = other[row, column.clip(0, width - 1)]
    second = other[row, (column + 1).clip(0, width - 1)]
    smooth = np.zeros((height, width), bool)
    if width > 2:
        smooth[:, 1:-1] = np.abs(np.diff(disparity, 2, axis=1)) < SMOOTH_PX
    between = valid & (position >= 0) & (position <= width - 1)
    return Match(disparity, valid, position, first, second, between, smooth)


def visible_pixels(match: Match, mask: NDArray[np.uint8] | None) -> Where:
    """Pixels that both views see: the mask's, or without one all that the other disparity does not hide."""
    if mask is not None:
        seen: Where = match.between & (mask == VISIBLE)
        return seen
    with np.errstate(invalid="ignore"):
        not_hidden: Where = match.between & (match.low <= match.disparity + HIDDEN_PX)
    return not_hidden


def one_surface(match: Match, visible: Where) -> Where:
    """Of the visible pixels, those whose surface goes on to both sides here and in the other view."""
    with np.errstate(invalid="ignore"):
        return visible & match.smooth & (match.high - match.low < 1)


def check_left_right(match: Match, visible: Where, verdict: Verdict) -> None:
    """Check the left disparity against the right one at x - d, in visible pixels.

    Disparity is linear along the row of a plane, so the right one, interpolated at x - d, is d again. Two numbers are
    judged: the share of pixels whose d lies outside what its two neighbours there span, and the median difference,
    which a constant or proportional error shifts.
    """
    judged = visible & match.smooth
    if judged.sum() < FEWEST:
        return
    with np.errstate(invalid="ignore"):
        beyond = np.maximum(match.low - match.disparity, match.disparity - match.high)[judged]
        share = float(np.mean(~(beyond <= OUTSIDE_PX)))
    verdict.measures["left_right_outside_share"] = share
    if share > OUTSIDE_SHARE:
        verdict.add(
            "left-right",
            f"{share:.2%} of {judged.sum()} visible pixels differ by more than {OUTSIDE_PX} px from the right view's "
            f"disparity; at most {OUTSIDE_SHARE:.0%} may",
        )
    flat = one_surface(match, visible)
    if flat.sum() < FEWEST:
        return
    difference = match.difference[flat]
    median, relative = float(np.median(difference)), float(np.median(difference / match.disparity[flat]))
    verdict.measures["left_right_median_px"] = median
    if abs(median) > MEDIAN_PX or abs(relative) > MEDIAN_SHARE:
        verdict.add(
            "left-right",
            f"the left disparity is {median:+.4f} px ({relative:+.3%}) off the right one in the median; "
            f"at most {MEDIAN_PX} px and {MEDIAN_SHARE:.1%} may be",
        )


def expected_visibility(match: Match, width: int) -> tuple[NDArray[np.uint8], Where]:
    """Work a view's mask out again from both disparities.

    Returns:
        The mask (H, W) uint8, and where it is certain (H, W) bool. Beside depth edges it is not: what is between two
        pixels of the other view depends on where exactly a surface ends.
    """
    inside = (match.position >= -0.5 + _BORDER_PX) & (match.position <= width - 0.5 - _BORDER_PX)
    outside = (match.position < -0.5 - _BORDER_PX) | (match.position > width - 0.5 + _BORDER_PX)
    with np.errstate(invalid="ignore"):
        hidden = inside & match.smooth & (match.low > match.disparity + HIDDEN_PX)
        seen = inside & match.smooth & (match.high - match.low < 1) & (np.abs(match.difference) < SEEN_PX)
    mask = np.full(match.disparity.shape, OUTSIDE, np.uint8)
    mask[match.valid & hidden] = OCCLUDED
    mask[match.valid & seen] = VISIBLE
    return mask, ~match.valid | outside | hidden | seen


def check_mask(name: str, mask: NDArray[np.uint8], match: Match, verdict: Verdict) -> None:
    """Check a mask's values, and that it agrees with the disparities where they leave no doubt.

    Each of the three classes is judged by itself too: almost everything is visible in most pairs, so a mask of another
    pair may be right nearly everywhere.
    """
    values = np.unique(mask)
    strange = values[~np.isin(values, (OUTSIDE, OCCLUDED, VISIBLE))]
    if strange.size:
        verdict.add("mask", f"{name}: expected the values 0, 128 and 255, got {', '.join(map(str, strange[:5]))}")
    expected, certain = expected_visibility(match, mask.shape[1])
    invalid = ~match.valid & (mask != OUTSIDE)
    if invalid.any():
        verdict.add("mask", f"{name}: {int(invalid.sum())} pixels without disparity are not 0")
    judge_mask("mask", (name, name), mask, expected, certain, "the disparities", verdict)


def judge_mask(
    check: str,
    names: tuple[str, str],
    mask: NDArray[np.uint8],
    expected: NDArray[np.uint8],
    certain: Where,
    others: str,
    verdict: Verdict,
) -> None:
    """Judge a mask, all of it and class by class, by what it should be.

    Args:
        check: the check's name.
        names: the mask's in messages, and the one that the measure's begins with.
        mask: uint8 of any shape.
        expected: of the same shape.
        certain: bool of the same shape, where that is known.
        others: what it follows from, for messages.
        verdict: takes findings and measures.
    """
    wrong = certain & (mask != expected)
    share = float(wrong.sum() / max(certain.sum(), 1))
    verdict.measures[f"{names[1]}_disagree_share"] = share
    shares = {"all": (share, MASK_SHARE)}
    for label, value in (("outside", OUTSIDE), ("occluded", OCCLUDED), ("visible", VISIBLE)):
        of = certain & (expected == value)
        if of.sum() >= FEWEST:
            shares[label] = (float((wrong & of).sum() / of.sum()), CLASS_SHARE)
    for label, (measured, allowed) in shares.items():
        if measured > allowed:
            verdict.add(
                check,
                f"{names[0]}: {measured:.2%} of the {'certain' if label == 'all' else label} pixels disagree with "
                f"{others}; at most {allowed:.0%} may",
            )
            return
