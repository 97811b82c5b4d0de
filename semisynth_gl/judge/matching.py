"""Compares the two images of a pair, or of two frames of a sequence, at corresponding points.

The vectors from pixels of the first image to their points in the second image come from disparity, which leads to the
other view, or from flow, which leads to the next or the previous frame. At a point, both images must have the same
disparity, opposite vectors, and the same colour: surfaces are not shaded, and their textures move with them. The colour
differs only by the interpolation between pixels of the second image, and by a rig's imperfections.
"""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.pair_files import StoredFrame
from semisynth_gl.frame.camera import EYES, OTHER_EYE, Eye
from semisynth_gl.frame.channels import CHANNELS, OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.judge.findings import CheckResults
from semisynth_gl.judge.interpolation import Floats, interpolate, pixels_around
from semisynth_gl.judge.lens import hidden_by_borders

Where = NDArray[np.bool_]

_OPPOSITE = {"flow": "flow_backward", "flow_backward": "flow"}
# Bounds, which docs/verify.md lists. A value is wrong if it lies more than _RANGE_PX outside the range of the four
# values around its point; at most _WRONG_SHARE of the values may be wrong.
_RANGE_PX, _WRONG_SHARE = 0.2, 0.02
_MEDIAN_PX = 0.01
# Maximum share of wrong mask values at points that are certainly visible, and certainly occluded.
_VISIBLE_SHARE, _OCCLUDED_SHARE = 0.02, 0.1
# Added to the number that a share allows, since all pixels around a thin object are wrong together.
_MORE_PIXELS = 20
# If disparities or vectors differ by less than this, both images show the same point.
_SAME_PX = 0.05
# A point is hidden if the disparities of all four pixels around it are larger by more than this.
_HIDDEN_PX = 0.25
# A pixel and its neighbours are one surface if their second differences are smaller than this.
_SMOOTH_PX = 0.25
# A point that is nearer than this to the image's border may be inside or outside.
_BORDER_PX = 0.01
# Minimum and maximum number of pixels for a median or a comparison of images; more pixels would only take longer.
_MIN_PIXELS, _MOST_PIXELS = 200, 200_000
# Minimum share of the variance that is explained, for perfect and for imperfect images; maximum shift of the best fit.
_EXPLAINED, _EXPLAINED_IMPERFECT, _SHIFT_PX = 0.8, -0.2, 0.25
# Larger residuals count as this, so that pixels beside edges and on minified textures do not dominate the mean.
_MOST_LEVELS = 20.0
# If shifts by a pixel change the mean residual by less than this share, the image has too little contrast to align.
_LEAST_CHANGE = 0.1


def check_masks(frame: StoredFrame, eye: Eye, results: CheckResults) -> None:
    """Check the masks of a view's disparity and flow at each pixel.

    A mask must be 0 where there is no vector or the vector leads out of the second image, and nowhere else. It must not
    be 255 where a border hides the point, see `hidden_by_borders`.
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
        hidden, _ = hidden_by_borders(frame, eye, channel, vectors, error_px)
        results.add_pixels(mask_name, eye, f"is not 0 without {channel}", ~known & (mask != OUTSIDE))
        results.add_pixels(mask_name, eye, "is not 0 for a point outside the image", outside & (mask != OUTSIDE))
        results.add_pixels(mask_name, eye, "is 0 for a point in the image", inside & (mask == OUTSIDE))
        results.add_pixels(mask_name, eye, "is 255 though a border hides the point", hidden & (mask == VISIBLE))


def check_views(frame: StoredFrame, results: CheckResults, *, imperfect: bool) -> None:
    """Compare the disparities, masks and images of both views at the points to which disparity leads.

    ``imperfect`` says whether the images have the imperfections of a rig, or a lossy encoding.
    """
    if any("disparity" not in frame.view(eye) for eye in EYES):
        return
    for eye in EYES:
        view, other = frame.view(eye), frame.view(OTHER_EYE[eye])
        points = _Correspondences(frame, eye, "disparity", results)
        name = f"disparity_{eye} against disparity_{OTHER_EYE[eye]}"
        first, second = view["disparity"], other["disparity"]
        hidden = points.compare("left-right", f"left_right_{eye}", name, first, second, 2 * points.error_px)
        points.check_mask(points.one_surface & points.same, hidden)
        if eye == "left":
            points.check_images("images", name, "", view["image"], other["image"], imperfect=imperfect)


def check_frames(before: StoredFrame, after: StoredFrame, results: CheckResults, *, images: bool) -> None:
    """Check flow, its masks and changes of disparity between a frame and the next frame of its sequence.

    ``images`` says whether to compare the images, too: a surface has the same colour in both, apart from resampling.
    """
    for eye in EYES:
        for channel in _OPPOSITE:
            start, end = (before, after) if channel == "flow" else (after, before)
            if channel in start.view(eye) and "disparity" in end.view(eye):
                _check_flow(channel, eye, start, end, results, images=images)


def _check_flow(
    channel: str, eye: Eye, start: StoredFrame, end: StoredFrame, results: CheckResults, *, images: bool
) -> None:
    view, other, name = start.view(eye), end.view(eye), f"{channel}_{eye}"
    points = _Correspondences(start, eye, channel, results)
    seen, hidden = np.zeros_like(points.visible), np.zeros_like(points.visible)
    change = (view if channel == "flow" else other).get("disparity_change")
    if change is not None:
        # The change leads from the earlier frame to the later one, where the disparities are compared.
        first, second = view["disparity"], other["disparity"]
        first, second = (first + change, second) if channel == "flow" else (first, second + change)
        label, error_px = f"disparity_change_{eye} by {name} of {start.name}", start.encodings.disparity.error_px
        hidden = points.compare("disparity_change", f"{name}_change", label, first, second, 2 * error_px)
    opposite = other.get(_OPPOSITE[channel])
    if opposite is not None:
        label = f"{name} of {start.name} against that of {end.name}"
        points.compare("flow-frames", f"{name}_frames", label, view[channel], -opposite, 2 * points.error_px)
        # Disparities do not distinguish two surfaces of similar depth; the opposite flow does.
        seen = points.one_surface & points.same
    points.check_mask(seen, hidden)
    if images:
        label = f"{name} of {start.name} to {end.name}"
        points.check_images("flow-images", label, f"{name}_", view["image"], other["image"])


class _Correspondences:
    """Pixels of a view that lie on smooth surfaces, and their points in a second image.

    `compare` narrows ``one_surface`` and ``same`` with each comparison and, without a mask, ``visible``.

    Attributes:
        pixels: rows and columns (N,) of at most 200,000 pixels, evenly spread.
        points: x and y (N,), px, of the pixels' points in the second image.
        error_px: largest error of the vectors by their encoding.
        visible: (N,) True where the second image shows the point: by the mask, or without a mask, unless a nearer
            surface was found there.
        one_surface: (N,) True where the four pixels around the point show one surface.
        same: (N,) True where both images show the same point of a surface.
    """

    def __init__(self, frame: StoredFrame, eye: Eye, channel: str, results: CheckResults) -> None:
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
        self.one_surface, self.same = np.ones(len(inside), bool), np.ones(len(inside), bool)
        self._no_border = ~hidden_by_borders(frame, eye, channel, vectors, self.error_px)[1][self.pixels]
        self._mask_name, self._eye, self._results = str(CHANNELS[channel].mask), eye, results

    def compare(self, check: str, measure: str, name: str, first: Floats, second: Floats, error_px: float) -> Where:
        """Compare an array of the first image with one of the second at the points; both are (H, W) or (H, W, C), px.

        Few values may lie outside the range of the four pixels around their points, and the median difference from the
        interpolated values must be small. Both bounds grow by ``error_px``. Findings have ``check`` and ``name``, and
        measures begin with ``measure``. Returns (N,) True where all four pixels have larger values: for disparities,
        where a nearer surface hides the point.
        """
        around = pixels_around(second, *self.points)
        values, low, high = first[self.pixels].reshape(around.shape[1:]), around.min(axis=0), around.max(axis=0)
        hidden = (low > values + _HIDDEN_PX + error_px).all(axis=1)
        if self._mask is None:
            self.visible &= ~hidden
        bound = _RANGE_PX + error_px
        wrong = self.visible & ~(np.maximum(low - values, values - high) <= bound).all(axis=1)
        self._results.measures[f"{measure}_outside_share"] = float(wrong.sum() / max(self.visible.sum(), 1))
        if _too_many(wrong, self.visible, _WRONG_SHARE):
            pixels = f"{wrong.sum()} of {self.visible.sum()} visible pixels"
            self._results.add(check, f"{name}: {pixels} are off by more than {bound:.3g} px")
        self.one_surface &= (high - low < 1).all(axis=1)
        differences, bound = np.abs(values - interpolate(around, *self.points)), _MEDIAN_PX + error_px
        self.same &= (differences < _SAME_PX + error_px).all(axis=1)
        compared = self.visible & self.one_surface
        if compared.sum() >= _MIN_PIXELS:
            median = float(np.median(differences[compared], axis=0).max())
            self._results.measures[f"{measure}_median_px"] = median
            if not median <= bound:
                self._results.add(check, f"{name}: the median difference is {median:.3g} px, over {bound:.3g} px")
        return np.asarray(hidden & np.isfinite(low).all(axis=1))

    def check_mask(self, seen: Where, hidden: Where) -> None:
        """Check the mask at the points that the second image shows, ``seen`` (N,), or hides, ``hidden`` (N,)."""
        if self._mask is None:
            return
        seen, hidden, name = seen & self._no_border, hidden & self._no_border, f"{self._mask_name}_{self._eye}"
        wrong = (seen & (self._mask != VISIBLE)) | (hidden & (self._mask != OCCLUDED))
        self._results.measures[f"{name}_disagree_share"] = float(wrong.sum() / max((seen | hidden).sum(), 1))
        for state, where, share in (("visible", seen, _VISIBLE_SHARE), ("occluded", hidden, _OCCLUDED_SHARE)):
            if _too_many(wrong & where, where, share):
                counts = f"{(wrong & where).sum()} of {where.sum()} pixels"
                self._results.add(self._mask_name, f"{name}: {counts} that are {state} have a different value")

    def check_images(
        self, check: str, name: str, measure: str, image: Floats, other: Floats, *, imperfect: bool = False
    ) -> None:
        """Check that the second image, resampled at the points of visible surfaces, equals the first image.

        It must explain 80 % of the variance. ``imperfect`` images are first given equal means and deviations. Their
        correlation r then explains 2 r - 1 of the variance, and must be at least 0.4. All images must fit best without
        a shift: a parabola through the mean residuals at shifts of -1, 0 and 1 px must have its minimum near 0.
        """
        image, other = (each.reshape(*each.shape[:2], -1).mean(axis=2) for each in (image, other))
        height, width = other.shape
        row, (x, y) = self.pixels[0], self.points
        level_rows = bool((y == row).all())
        # Points shifted by a pixel must be in the image, too.
        inside = (x >= 1) & (x <= width - 2) & (((y >= 1) & (y <= height - 2)) | level_rows)
        compared = inside & self.visible & self.one_surface
        if compared.sum() < _MIN_PIXELS:
            return

        def warp(right_px: int, down_px: int) -> Floats:
            along, down = x[compared] + right_px, y[compared] + down_px
            return interpolate(pixels_around(other, along, down), along, down)[:, 0]

        levels, warped = image[self.pixels][compared], warp(0, 0)
        contrasts = levels.std(), warped.std()
        if max(contrasts) < 1 or (imperfect and min(contrasts) < 1):
            return
        if imperfect:
            levels = (levels - levels.mean()) * (warped.std() / levels.std()) + warped.mean()
        least = _EXPLAINED_IMPERFECT if imperfect else _EXPLAINED
        explained = float(1 - np.mean((levels - warped) ** 2) / max(warped.var(), 1))
        self._results.measures[f"{measure}image_explained"] = explained
        if explained < least:
            fault = f"the other image explains {explained:.0%} of the variance, not {least:.0%}"
            self._results.add(check, f"{name}: {fault}")
            return
        for axis in "x" if level_rows else "xy":
            moved = (warp(step * (axis == "x"), step * (axis == "y")) for step in (-1, 0, 1))
            residuals = (float(np.minimum(abs(levels - there), _MOST_LEVELS).mean()) for there in moved)
            shift_px = _minimum_of_parabola(*residuals)
            if shift_px is not None:
                self._results.measures[f"{measure}best_shift_{axis}_px"] = shift_px
                if abs(shift_px) > _SHIFT_PX:
                    fault = f"the images fit best at a shift of {shift_px:+.2f} px in {axis}, over {_SHIFT_PX} px"
                    self._results.add(check, f"{name}: {fault}")


def _vectors(frame: StoredFrame, eye: Eye, channel: str) -> tuple[Floats, float]:
    """Return a view's vectors (H, W, 2), px, by disparity or flow, and the largest error of their encoding, px."""
    if channel == "disparity":
        return frame.correspondences(eye), frame.encodings.disparity.error_px
    return frame.view(eye)[channel], frame.encodings.flow.error_px


def _too_many(wrong: Where, among: Where, share: float) -> bool:
    return bool(wrong.sum() > share * among.sum() + _MORE_PIXELS)


def _minimum_of_parabola(before: float, here: float, after: float) -> float | None:
    """Return where a parabola through residuals at -1, 0 and 1 is least, from -1 to 1; None if they hardly differ."""
    if max(before, here, after) - min(before, here, after) < _LEAST_CHANGE * max(before, here, after):
        return None
    if here > min(before, after):
        return -1.0 if before < after else 1.0
    return 0.5 * (before - after) / (before - 2 * here + after)
