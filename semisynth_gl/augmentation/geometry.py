"""Geometric changes of a pair with exact truth: mirroring, scaling, a moved right image, and hidden rectangles.

The calibration changes with the arrays, so a rig could have taken the changed pair.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageStat
from scipy import ndimage

from semisynth_gl.augmentation.resampling import Positions, SamplePoints
from semisynth_gl.frame.camera import EYES, OTHER_EYE, CameraDeviation, Crop, Eye, StereoCamera
from semisynth_gl.frame.channels import CHANNELS, MOTION_OUTPUTS, OCCLUDED, VISIBLE, ViewArrays
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.errors import InputError

_FLOWS = ("flow", "flow_backward")
# Tolerances by which neighbouring values on one surface may deviate from a line: px, and a share of inverse depths.
_SURFACE_PX, _SURFACE_SHARE = 0.1, np.float32(2e-3)
# Channels in px: those that scale_x multiplies, and vectors whose x scale_x and whose y scale_y multiplies.
_HORIZONTAL, _DISPLACEMENTS = {"disparity", "disparity_change"}, {"correspondence", *_FLOWS}


def mirrored(frame: Frame) -> Frame:
    """Return the pair mirrored horizontally, with swapped eyes.

    Raises InputError if only the left view has truth, or the rig is not rectified.
    """
    camera, last = frame.camera, frame.camera.width_px - 1
    if set(frame.left) != set(frame.right):
        raise InputError("expected truth of both views: set truth: both in the config", argument="mirrored")
    if not camera.rectified:
        raise InputError("expected a rectified rig, got a right camera that deviates", argument="mirrored")
    views = []
    for eye in EYES:
        arrays = {name: np.flip(array, 1).copy() for name, array in frame.view(OTHER_EYE[eye]).items()}
        for name in arrays.keys() & {*_DISPLACEMENTS, "normals"}:
            x = arrays[name][..., 0]
            np.negative(x, out=x, where=np.isfinite(x))
        views.append(ViewArrays(arrays))
    return Frame(replace(camera, cx_left_px=last - camera.cx_right_px, cx_right_px=last - camera.cx_left_px), *views)


def occluded(frame: Frame, rectangles: Sequence[Crop]) -> Frame:
    """Return a pair whose right image has rectangles in its mean colour.

    Right pixels in a rectangle lose their truth. A visible left pixel becomes `OCCLUDED` if a rectangle hides its point
    in the right image; it keeps its disparity. All frames of a sequence have the same rectangles, so masks of the right
    view's flow change likewise.
    """
    if not rectangles:
        return frame
    hidden = np.zeros((frame.camera.height_px, frame.camera.width_px), bool)
    for each in rectangles:
        hidden[each.y_px : each.bottom_px, each.x_px : each.right_px] = True
    arrays = {name: array.copy() for name, array in frame.right.items()}
    for name, array in arrays.items():
        array[hidden] = CHANNELS[name].fill
    arrays["image"][hidden] = np.rint(ImageStat.Stat(Image.fromarray(frame.right.image)).mean)
    for name, channel in CHANNELS.items():
        if channel.output in MOTION_OUTPUTS and channel.mask in arrays:
            arrays[channel.mask] = _masked(arrays[channel.mask], arrays[name], hidden)
    left = frame.left
    if "visibility" in left:
        left = left.with_channels({"visibility": _masked(left.visibility, frame.correspondences("left"), hidden)})
    return Frame(frame.camera, left, frame.right.with_channels(arrays))


def _masked(mask: NDArray[np.uint8], offset: NDArray[np.floating], hidden: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return a mask whose visible pixels are `OCCLUDED` if their displacement, ``offset``, leads to a hidden pixel."""
    y, x = np.nonzero((mask == VISIBLE) & np.isfinite(offset).all(axis=2))
    column, row = np.rint(np.stack([x, y]) + offset[y, x].T).astype(np.intp)
    # Positions outside the image are clipped to a border of one pixel, which is not hidden.
    padded = np.pad(hidden, 1)
    covered = padded[(row + 1).clip(0, padded.shape[0] - 1), (column + 1).clip(0, padded.shape[1] - 1)]
    masked = mask.copy()
    masked[y[covered], x[covered]] = OCCLUDED
    return masked


@dataclass(frozen=True, slots=True)
class PairWarp:
    """Scales a crop of a pair, and moves its right image: a shift, and a rotation about its principal point."""

    scale_x: float = 1.0
    scale_y: float = 1.0
    right_y_px: float = 0.0  # down, px of the changed pair
    right_roll_rad: float = 0.0  # clockwise
    margin: int = 0  # px around the crop, which a moved right image needs

    def source_size(self, size: tuple[int, int]) -> tuple[int, int]:
        """Return the height and width, px, from which a result of height and width ``size`` is made, with margins."""
        height, width = size
        return ceil(height / self.scale_y) + 2 * self.margin, ceil(width / self.scale_x) + 2 * self.margin

    def applied(self, frame: Frame, size: tuple[int, int]) -> Frame:
        """Return the changed pair of height and width ``size``, px, from a pair of the size `source_size`.

        Raises InputError if the right image is moved, but the pair is not rectified or has disparity changes.
        """
        moves = (self.right_y_px, self.right_roll_rad) != (0, 0)
        if moves and not (frame.camera.rectified and "disparity_change" not in frame.left):
            raise InputError("right_y_px, right_roll_deg: expected a rectified rig without the output disparity_change")
        (height, width), scale, margin = size, np.array([self.scale_x, self.scale_y]), self.margin
        x = margin + (np.arange(width)[None] + 0.5) / self.scale_x - 0.5
        y = margin + (np.arange(height)[:, None] + 0.5) / self.scale_y - 0.5
        movement = _Movement(self, frame.camera)
        views = []
        for eye in EYES:
            view, at = frame.view(eye), (x, y)
            image = view.image
            if moves and eye == "right":
                image, at = movement.image(image), movement.position_before(x, y)
            arrays = _truth(view, SamplePoints(*at, image.shape[:2]))
            if moves and arrays:
                arrays |= movement.truth(eye, arrays, x, y)
            for names, factor in ((_HORIZONTAL, scale[0]), (_DISPLACEMENTS, scale)):
                for name in arrays.keys() & names:
                    arrays[name] *= factor
            views.append(ViewArrays({"image": self._resized(image, size)} | arrays))
        inner = Crop(margin, margin, frame.camera.width_px - 2 * margin, frame.camera.height_px - 2 * margin)
        camera = frame.camera.cropped(inner).scaled(self.scale_x, self.scale_y, size)
        if moves:
            camera = replace(camera, deviation=CameraDeviation(self.right_roll_rad, 0.0, self.right_y_px))
        return Frame(camera, *views)

    def _resized(self, image: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
        (height, width), start = size, self.margin
        if self.scale_x == self.scale_y == 1:
            return image[start : start + height, start : start + width].copy()
        box = start, start, start + width / self.scale_x, start + height / self.scale_y
        return np.array(Image.fromarray(image).resize((width, height), Image.Resampling.BILINEAR, box))


def _truth(view: ViewArrays, points: SamplePoints) -> dict[str, NDArray[Any]]:
    """Return all arrays of a view, except its image, at other points."""
    arrays: dict[str, NDArray[Any]] = {}
    for name in view.keys() - {"image"}:
        if view[name].dtype != np.float32 or name == "normals":
            arrays[name] = points.nearest(view[name])
        elif name == "depth":
            with np.errstate(divide="ignore"):
                inverse = np.reciprocal(view.depth)
                arrays[name] = np.reciprocal(points.on_surface(inverse, _SURFACE_SHARE * inverse))
        else:
            arrays[name] = points.on_surface(view[name], _SURFACE_PX)
    return arrays


class _Movement:
    """The rotation and shift of the right image, px before scaling."""

    def __init__(self, warp: PairWarp, camera: StereoCamera) -> None:
        self._cos, self._sin = np.cos(warp.right_roll_rad), np.sin(warp.right_roll_rad)
        # The off-diagonal terms of the rotation in px, which differ if fy is not fx.
        self._y_of_x = self._sin * camera.fy_over_fx
        self._x_of_y = self._sin / camera.fy_over_fx
        self._cx, self._cy, self._down = camera.cx_right_px, camera.cy_px, warp.right_y_px / warp.scale_y

    def position_before(self, x: Positions, y: Positions) -> tuple[Positions, Positions]:
        """Return the positions in the right image of points of the moved image."""
        dx, dy = x - self._cx, y - self._cy - self._down
        return self._cx + self._cos * dx + self._x_of_y * dy, self._cy - self._y_of_x * dx + self._cos * dy

    def image(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the moved right image; its border pixels continue beyond the border."""
        channels = np.moveaxis(image.reshape(*image.shape[:2], -1).astype(np.float32), 2, 0)
        # affine_transform takes (row, column), so matrix and offset have y first.
        turn = np.array([[self._cos, -self._y_of_x], [self._x_of_y, self._cos]])
        offset = self.position_before(np.zeros(()), np.zeros(()))[::-1]
        values = [ndimage.affine_transform(each, turn, offset, mode="nearest") for each in channels]
        moved: NDArray[np.uint8] = np.rint(np.stack(values, axis=2)).clip(0, 255).astype(np.uint8)
        return moved.reshape(image.shape)

    def truth(
        self, eye: Eye, arrays: Mapping[str, NDArray[Any]], x: Positions, y: Positions
    ) -> dict[str, NDArray[Any]]:
        """Return the arrays of a view's truth that the movement changes.

        ``arrays`` is the truth before the movement, at the points that the pixels in columns ``x`` and rows ``y`` show.
        """
        disparity = np.where(np.isfinite(arrays["disparity"]), arrays["disparity"], np.nan).astype(np.float64)
        if eye == "left":
            dx, dy = x - disparity - self._cx, y - self._cy
            to_x = self._cx + self._cos * dx - self._x_of_y * dy - x
            to_y = self._cy + self._down + self._y_of_x * dx + self._cos * dy - y
        else:
            before_x, before_y = self.position_before(x, y)
            to_x, to_y = before_x + disparity - x, before_y + 0 * disparity - y
        moved, correspondence = -to_x if eye == "left" else to_x, np.stack([to_x, to_y], axis=-1)
        if not (disparity < 0).any():  # unsigned disparities are above 0
            moved[~(moved > 0)] = np.nan
        correspondence[np.isnan(moved)] = np.nan
        changed = {"disparity": moved, "correspondence": correspondence}
        if eye == "right":
            in_px = np.array([[self._cos, -self._x_of_y], [self._y_of_x, self._cos]])
            in_metres = np.array([[self._cos, -self._sin], [self._sin, self._cos]])
            for name, turn in (("normals", in_metres), *((name, in_px) for name in _FLOWS)):
                if name in arrays:
                    changed[name] = np.where(np.isfinite(arrays[name]), arrays[name], np.nan)
                    changed[name][..., :2] = changed[name][..., :2] @ turn.T
        kept = {name: array for name, array in changed.items() if name in arrays}
        return {name: np.where(np.isnan(array), np.inf, array).astype(np.float32) for name, array in kept.items()}
