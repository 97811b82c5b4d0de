"""Checks vectors from one image into a second image by the vectors back, the disparities, the mask and the image there.

Disparities lead from one view of a pair to the other. Flow leads from a frame of a sequence to the next or the previous
frame. Textures are not shaded and move with their surfaces, so both images sample the same texture at the same point of
a surface. The images differ by the interpolation between the pixels of the second image, and by imperfections of rigs.
"""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.pair_files import StoredFrame
from semisynth_gl.frame.camera import EYES, OTHER_EYE, Eye
from semisynth_gl.frame.channels import CHANNELS, OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.judge.findings import Verdict
from semisynth_gl.judge.interpolation import Floats, between, corners
from semisynth_gl.judge.lens import find_borders

Where = NDArray[np.bool_]

_OPPOSITE = {"flow": "flow_backward", "flow_backward": "flow"}
# Bounds, which docs/verify.md lists.
_OUTSIDE_PX, _OUTSIDE_SHARE = 0.2, 0.02
_MEDIAN_PX = 0.01
_SEEN_SHARE, _HIDDEN_SHARE = 0.02, 0.1
# Number of pixels that is added to each share, since all pixels around a thin object are wrong together.
_FEW_PIXELS = 20
# If disparities or vectors differ by less than this, both images show the same point.
_SAME_PX = 0.05
# A point is hidden if the disparities of all pixels around it exceed its own by more than this.
_HIDDEN_PX = 0.25
# If second differences are below this, a pixel and its neighbours are one surface.
_SMOOTH_PX = 0.25
# A point that is nearer than this to the image's border may be inside or outside.
_BORDER_PX = 0.01
# Minimum and maximum number of pixels for a median or a correlation; more pixels would only take longer.
_MIN_PIXELS, _MOST_PIXELS = 200, 200_000
# Images: minimum share of the variance that is explained, for perfect and for imperfect images; maximum shift of the
# best fit.
_EXPLAINED, _EXPLAINED_IMPERFECT, _SHIFT_PX = 0.8, -0.2, 0.25
_CAP_LEVELS = 20.0
# If a shift of the points by a pixel changes the residual by a smaller share, there is nothing to align.
_VALLEY = 0.1


def check_masks(frame: StoredFrame, eye: Eye, verdict: Verdict) -> None:
    """Check the masks of a view's disparity and flow at each pixel.

    A mask must be 0 exactly where no vector leads into the image, and not 255 where a lens border hides the point.
    """
    view = frame.view(eye)
    for channel in ("disparity", *_OPPOSITE):
        mask_name = str(CHANNELS[channel].mask)
        if channel not in view or mask_name not in view:
            continue
        mask, (vectors, error_px) = view[mask_name], _vectors(frame, eye, channel)
        known = np.isfinite(vectors).all(axis=2)
        height, width = mask.shape
        x, y = np.arange(width) + vectors[..., 0], np.arange(height)[:, None] + vectors[..., 1]
        # The image's border lies half a pixel outside the centres of the outer pixels.
        within_px = 0.5 + np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y))
        outside = known & (within_px < -_BORDER_PX - error_px)
        inside = known & (within_px > _BORDER_PX + error_px)
        border, _ = find_borders(frame, eye, channel, vectors, error_px)
        verdict.add_pixels(mask_name, eye, f"is not 0 without {channel}", ~known & (mask != OUTSIDE))
        verdict.add_pixels(mask_name, eye, "is not 0 for a point outside the image", outside & (mask != OUTSIDE))
        verdict.add_pixels(mask_name, eye, "is 0 for a point in the image", inside & (mask == OUTSIDE))
        verdict.add_pixels(mask_name, eye, "is 255 though a border hides the point", border & (mask == VISIBLE))


def check_views(frame: StoredFrame, verdict: Verdict, *, imperfect: bool) -> None:
    """Compare both views' disparities, masks and images at points that disparity matches.

    ``imperfect`` says whether the images have the imperfections of a rig, or a lossy encoding.
    """
    if any("disparity" not in frame.view(eye) for eye in EYES):
        return
    for eye in EYES:
        own, other = frame.view(eye), frame.view(OTHER_EYE[eye])
        match = _Match(frame, eye, "disparity", verdict)
        now, there = own["disparity"][match.pixels], match.around(other["disparity"])
        name = f"disparity_{eye} against disparity_{OTHER_EYE[eye]}"
        hidden = match.compare("left-right", f"left_right_{eye}", name, now, there, 2 * match.error_px)
        match.check_mask(match.surface & match.same, hidden)
        if eye == "left":
            match.check_images("images", name, "", own["image"], other["image"], imperfect=imperfect)


def check_frames(before: StoredFrame, after: StoredFrame, verdict: Verdict, *, images: bool) -> None:
    """Check flow, its masks and changes of disparity between a frame and the next frame of its sequence.

    ``images`` says whether both images show the same textures apart from resampling, so that they can be compared, too.
    """
    for eye in EYES:
        for channel in _OPPOSITE:
            start, end = (before, after) if channel == "flow" else (after, before)
            if channel in start.view(eye) and "disparity" in end.view(eye):
                _check_flow(channel, eye, start, end, verdict, images=images)


def _check_flow(
    channel: str, eye: Eye, start: StoredFrame, end: StoredFrame, verdict: Verdict, *, images: bool
) -> None:
    own, other, name = start.view(eye), end.view(eye), f"{channel}_{eye}"
    match = _Match(start, eye, channel, verdict)
    now, there = own["disparity"][match.pixels], match.around(other["disparity"])
    seen, hidden = np.zeros_like(match.visible), np.zeros_like(match.visible)
    change = (own if channel == "flow" else other).get("disparity_change")
    if change is not None:
        # Compare the disparities at the later moment, to which the earlier frame's change leads.
        now, there = (now + change[match.pixels], there) if channel == "flow" else (now, there + match.around(change))
        label, error_px = f"disparity_change_{eye} by {name} of {start.name}", start.encodings.disparity.error_px
        hidden = match.compare("disparity_change", f"{name}_change", label, now, there, 2 * error_px)
    back = other.get(_OPPOSITE[channel])
    if back is not None:
        label, there = f"{name} of {start.name} against that of {end.name}", -match.around(back)
        match.compare("flow-frames", f"{name}_frames", label, own[channel][match.pixels], there, 2 * match.error_px)
        # Only the flow back distinguishes two surfaces of similar disparity.
        seen = match.surface & match.same
    match.check_mask(seen, hidden)
    if images:
        label = f"{name} of {start.name} to {end.name}"
        match.check_images("flow-images", label, f"{name}_", own["image"], other["image"])


class _Match:
    """Pixels of a view that lie on smooth surfaces, and their points in another image.

    Attributes:
        pixels: rows and columns (N,) of at most 200,000 pixels, evenly spread.
        points: x and y (N,) px of their points.
        error_px: largest error of the vectors by their encoding.
        visible: (N,) where the other image shows the point, by the mask; without a mask, where nothing hides the point.
        surface: (N,) where the values around the point belong to one surface in all comparisons so far.
        same: (N,) where both images show the same point in all comparisons so far.
    """

    def __init__(self, frame: StoredFrame, eye: Eye, channel: str, verdict: Verdict) -> None:
        vectors, self.error_px = _vectors(frame, eye, channel)
        height, width = vectors.shape[:2]
        values, smooth = np.dstack([vectors, frame.view(eye)["disparity"]]), np.zeros((height, width), bool)
        bends = np.diff(values[1:-1], 2, axis=1), np.diff(values[:, 1:-1], 2, axis=0)
        smooth[1:-1, 1:-1] = np.logical_and(*(np.abs(bend) < _SMOOTH_PX for bend in bends)).all(axis=2)
        row, column = np.nonzero(smooth)
        x, y = column + vectors[row, column, 0].astype(float), row + vectors[row, column, 1].astype(float)
        inside = np.flatnonzero((x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1))
        inside = inside[:: max(1, -(-len(inside) // _MOST_PIXELS))]
        self.pixels, self.points = (row[inside], column[inside]), (x[inside], y[inside])
        mask = frame.view(eye).get(str(CHANNELS[channel].mask))
        self._mask = None if mask is None else mask[self.pixels]
        self.visible = np.ones(len(inside), bool) if self._mask is None else self._mask == VISIBLE
        self.surface, self.same = np.ones(len(inside), bool), np.ones(len(inside), bool)
        self._certain = ~find_borders(frame, eye, channel, vectors, self.error_px)[1][self.pixels]
        self._mask_name, self._eye, self._verdict = str(CHANNELS[channel].mask), eye, verdict

    def around(self, array: Floats) -> Floats:
        """Return the other image's array in the four pixels around the points, (4, N, C)."""
        return corners(array, *self.points)

    def compare(self, check: str, measure: str, name: str, own: Floats, around: Floats, error_px: float) -> Where:
        """Compare values (N,) or (N, C) px with the values around their points (4, N, C): outliers and the median.

        Returns:
            (N,) where all values around the point are larger: for disparities, where a nearer surface hides it.
        """
        own, low, high = own.reshape(around.shape[1:]), around.min(axis=0), around.max(axis=0)
        hidden = (low > own + _HIDDEN_PX + error_px).all(axis=1)
        if self._mask is None:
            self.visible &= ~hidden
        bound = _OUTSIDE_PX + error_px
        wrong = self.visible & ~(np.maximum(low - own, own - high) <= bound).all(axis=1)
        self._verdict.measures[f"{measure}_outside_share"] = float(wrong.sum() / max(self.visible.sum(), 1))
        if _too_many(wrong, self.visible, _OUTSIDE_SHARE):
            pixels = f"{wrong.sum()} of {self.visible.sum()} visible pixels"
            self._verdict.add(check, f"{name}: {pixels} are off by more than {bound:.3g} px")
        self.surface &= (high - low < 1).all(axis=1)
        differences, bound = np.abs(own - between(around, *self.points)), _MEDIAN_PX + error_px
        self.same &= (differences < _SAME_PX + error_px).all(axis=1)
        if (self.visible & self.surface).sum() >= _MIN_PIXELS:
            median = float(np.median(differences[self.visible & self.surface], axis=0).max())
            self._verdict.measures[f"{measure}_median_px"] = median
            if not median <= bound:
                self._verdict.add(check, f"{name}: the median difference is {median:.3g} px, over {bound:.3g} px")
        return np.asarray(hidden & np.isfinite(low).all(axis=1))

    def check_mask(self, seen: Where, hidden: Where) -> None:
        """Judge the mask at points that the other image certainly shows, ``seen`` (N,), or hides, ``hidden`` (N,)."""
        if self._mask is None:
            return
        seen, hidden, name = seen & self._certain, hidden & self._certain, f"{self._mask_name}_{self._eye}"
        wrong = (seen & (self._mask != VISIBLE)) | (hidden & (self._mask != OCCLUDED))
        self._verdict.measures[f"{name}_disagree_share"] = float(wrong.sum() / max((seen | hidden).sum(), 1))
        for state, where, share in (("visible", seen, _SEEN_SHARE), ("occluded", hidden, _HIDDEN_SHARE)):
            if _too_many(wrong & where, where, share):
                counts = f"{(wrong & where).sum()} of {where.sum()} pixels"
                self._verdict.add(self._mask_name, f"{name}: {counts} that are {state} have a different value")

    def check_images(
        self, check: str, name: str, measure: str, own: Floats, other: Floats, *, imperfect: bool = False
    ) -> None:
        """Check that the other image, resampled at the points of visible surfaces, equals this image.

        It must explain 80 % of the variance. Imperfect images, of a rig or with a lossy encoding, get equal brightness
        and contrast first, and must correlate by 0.4, which then explains -20 %. All images must fit best without a
        shift: a parabola through the residuals at shifts of -1, 0 and 1 px must have its minimum near 0.
        """
        own, other = (image.reshape(*image.shape[:2], -1).mean(axis=2) for image in (own, other))
        height, width = other.shape
        row, (x, y) = self.pixels[0], self.points
        level_rows = bool((y == row).all())
        inside = (x >= 1) & (x <= width - 2) & (((y >= 1) & (y <= height - 2)) | level_rows)
        judged = inside & self.visible & self.surface
        if judged.sum() < _MIN_PIXELS:
            return

        def warp(right_px: int, down_px: int) -> Floats:
            along, down = x[judged] + right_px, y[judged] + down_px
            return between(corners(other, along, down), along, down)[:, 0]

        levels, warped, least = own[self.pixels][judged], warp(0, 0), _EXPLAINED
        contrasts = levels.std(), warped.std()
        if max(contrasts) < 1 or (imperfect and min(contrasts) < 1):
            return
        if imperfect:
            levels = (levels - levels.mean()) * (warped.std() / levels.std()) + warped.mean()
            least = _EXPLAINED_IMPERFECT
        explained = float(1 - np.mean((levels - warped) ** 2) / max(warped.var(), 1))
        self._verdict.measures[f"{measure}image_explained"] = explained
        if explained < least:
            fault = f"the other image explains {explained:.0%} of the variance, not {least:.0%}"
            self._verdict.add(check, f"{name}: {fault}")
            return
        for axis in "x" if level_rows else "xy":
            moved = (warp(step * (axis == "x"), step * (axis == "y")) for step in (-1, 0, 1))
            # Limited, so that pixels beside edges and on minified texture do not dominate.
            shift_px = _least_at(*(float(np.minimum(abs(levels - there), _CAP_LEVELS).mean()) for there in moved))
            if shift_px is not None:
                self._verdict.measures[f"{measure}best_shift_{axis}_px"] = shift_px
                if abs(shift_px) > _SHIFT_PX:
                    fault = f"the images fit best at a shift of {shift_px:+.2f} px in {axis}, over {_SHIFT_PX} px"
                    self._verdict.add(check, f"{name}: {fault}")


def _vectors(frame: StoredFrame, eye: Eye, channel: str) -> tuple[Floats, float]:
    """Return a view's vectors (H, W, 2) px, of disparity or flow, and the maximum error of the encoding, px."""
    if channel == "disparity":
        return frame.correspondences(eye), frame.encodings.disparity.error_px
    return frame.view(eye)[channel], frame.encodings.flow.error_px


def _too_many(wrong: Where, among: Where, share: float) -> bool:
    return bool(wrong.sum() > share * among.sum() + _FEW_PIXELS)


def _least_at(before: float, here: float, after: float) -> float | None:
    """Return the minimum, from -1 to 1, of a parabola through residuals at -1, 0 and 1; None if they hardly differ."""
    if max(before, here, after) - min(before, here, after) < _VALLEY * max(before, here, after):
        return None
    if here > min(before, after):
        return -1.0 if before < after else 1.0
    return 0.5 * (before - after) / (before - 2 * here + after)
