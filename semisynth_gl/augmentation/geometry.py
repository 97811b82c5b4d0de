"""Changes of a pair that keep its truth exact: mirrored, scaled, badly rectified, cropped, partly hidden.

The changed pair is one that a camera could have taken: its calibration and all its arrays change by one rule each.
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
from semisynth_gl.frame.channels import CHANNELS, FLOW_OUTPUTS, OCCLUDED, VISIBLE, ViewArrays
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.errors import InputError

_FLOWS = ("flow", "flow_backward")
# By how much three values in a row on one surface may be off a line: disparities and displacements, px, and a share of
# inverse depths.
_SURFACE_PX, _SURFACE_SHARE = 0.1, np.float32(2e-3)
# Channels in px: scaled by scale_x only, and by scale_x and scale_y.
_ACROSS, _WAYS = {"disparity", "disparity_change"}, {"correspondence", *_FLOWS}


def mirrored(frame: Frame) -> Frame:
    """Return the pair as a mirror shows it: the eyes change places.

    Raises InputError where only the left view has truth, or the right camera deviates from the rectified one.
    """
    camera, last = frame.camera, frame.camera.width_px - 1
    if set(frame.left) != set(frame.right):
        raise InputError("expected truth of both views: set truth: both, or leave it out", argument="mirrored")
    if not camera.rectified:
        raise InputError("expected a rectified rig, got a right camera that deviates", argument="mirrored")
    views = []
    for eye in EYES:
        arrays = {name: np.flip(array, 1).copy() for name, array in frame.view(OTHER_EYE[eye]).items()}
        for name in arrays.keys() & {*_WAYS, "normals"}:
            across = arrays[name][..., 0]
            np.negative(across, out=across, where=np.isfinite(across))
        views.append(ViewArrays(arrays))
    seen = replace(camera, cx_left_px=last - camera.cx_right_px, cx_right_px=last - camera.cx_left_px)
    return Frame(seen, *views)


def occluded(frame: Frame, rectangles: Sequence[Crop]) -> Frame:
    """Return a pair with rectangles in its right image, in its mean colour.

    Left disparities stay. Masks say `OCCLUDED` where a rectangle hides the point of a visible left pixel, or that of a
    visible right pixel at another frame of the sequence, whose rectangles are the same. Right pixels in a rectangle
    show nothing of the scene: they lose their truth.
    """
    if not rectangles:
        return frame
    hidden = np.zeros((frame.camera.height_px, frame.camera.width_px), bool)
    for each in rectangles:
        hidden[each.y_px : each.bottom_px, each.x_px : each.right_px] = True
    arrays = {name: array.copy() for name, array in frame.right.items()}
    for name, array in arrays.items():
        array[hidden] = CHANNELS[name].nothing
    arrays["image"][hidden] = np.rint(ImageStat.Stat(Image.fromarray(frame.right.image)).mean)
    for name, channel in CHANNELS.items():
        if channel.output in FLOW_OUTPUTS and channel.mask in arrays:
            arrays[channel.mask] = _masked(arrays[channel.mask], arrays[name], hidden)
    left = frame.left
    if "visibility" in left:
        left = left.with_channels({"visibility": _masked(left.visibility, frame.correspondences("left"), hidden)})
    return Frame(frame.camera, left, frame.right.with_channels(arrays))


def _masked(mask: NDArray[np.uint8], way: NDArray[np.floating], hidden: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return a mask, `OCCLUDED` where it says visible, but the way (H, W, 2) leads into what is hidden, (H, W) bool."""
    y, x = np.nonzero((mask == VISIBLE) & np.isfinite(way).all(axis=2))
    column, row = np.rint(np.stack([x, y]) + way[y, x].T).astype(np.intp)
    # Positions beyond the image are clipped into a border of one pixel, which is not hidden.
    padded = np.pad(hidden, 1)
    covered = padded[(row + 1).clip(0, padded.shape[0] - 1), (column + 1).clip(0, padded.shape[1] - 1)]
    masked = mask.copy()
    masked[y[covered], x[covered]] = OCCLUDED
    return masked


@dataclass(frozen=True, slots=True)
class Warp:
    """A part of a pair at another scale, whose right image is shifted and turned about its principal point."""

    scale_x: float = 1.0
    scale_y: float = 1.0
    right_y_px: float = 0.0  # down, px of the changed pair
    right_roll_rad: float = 0.0  # clockwise
    margin: int = 0  # px around the part, which a moved right image needs

    def source(self, size: tuple[int, int]) -> tuple[int, int]:
        """Return height and width of what a crop of so many px is made of, with the margin on all sides."""
        height, width = size
        return ceil(height / self.scale_y) + 2 * self.margin, ceil(width / self.scale_x) + 2 * self.margin

    def applied(self, frame: Frame, size: tuple[int, int]) -> Frame:
        """Return the changed pair with the height and width ``size``, px, from one as large as `source` says.

        Raises InputError where the right image is moved, and the pair is not rectified or has disparity changes.
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
                image, at = movement.image(image), movement.source(x, y)
            arrays = _truth(view, SamplePoints(*at, image.shape[:2]))
            if moves and arrays:
                arrays |= movement.truth(eye, arrays, x, y)
            for names, factor in ((_ACROSS, scale[0]), (_WAYS, scale)):
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
    """Return all arrays of a view but its image at other points."""
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
    """The turn and shift of the right image, in px of the unscaled pair."""

    def __init__(self, warp: Warp, camera: StereoCamera) -> None:
        self._cos, self._sin = np.cos(warp.right_roll_rad), np.sin(warp.right_roll_rad)
        # Off-diagonal terms of the rotation in px. They differ where fy is not fx.
        self._fall = self._sin * camera.fy_over_fx
        self._lean = self._sin / camera.fy_over_fx
        self._cx, self._cy, self._down = camera.cx_right_px, camera.cy_px, warp.right_y_px / warp.scale_y

    def source(self, x: Positions, y: Positions) -> tuple[Positions, Positions]:
        """Return where in the right image the points of the moved image come from."""
        across, along = x - self._cx, y - self._cy - self._down
        return self._cx + self._cos * across + self._lean * along, self._cy - self._fall * across + self._cos * along

    def image(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the moved right image; beyond the border, the last pixel is repeated."""
        channels = image.reshape(*image.shape[:2], -1).astype(np.float32)
        # ndimage counts rows before columns.
        turn = np.array([[self._cos, -self._fall], [self._lean, self._cos]])
        column, row = self.source(np.zeros(()), np.zeros(()))
        values = [
            ndimage.affine_transform(each, turn, (row, column), mode="nearest") for each in np.moveaxis(channels, 2, 0)
        ]
        moved: NDArray[np.uint8] = np.rint(np.stack(values, axis=2)).clip(0, 255).astype(np.uint8)
        return moved.reshape(image.shape)

    def truth(
        self, eye: Eye, arrays: Mapping[str, NDArray[Any]], x: Positions, y: Positions
    ) -> dict[str, NDArray[Any]]:
        """Return the truth of a view that the movement changes.

        ``arrays`` is its truth before the movement, at the points that the pixels in columns x and rows y show.
        """
        disparity = np.where(np.isfinite(arrays["disparity"]), arrays["disparity"], np.nan).astype(np.float64)
        if eye == "left":
            across, along = x - disparity - self._cx, y - self._cy
            way_x = self._cx + self._cos * across - self._lean * along - x
            way_y = self._cy + self._down + self._fall * across + self._cos * along - y
        else:
            source_x, source_y = self.source(x, y)
            way_x, way_y = source_x + disparity - x, source_y + 0 * disparity - y
        moved, way = -way_x if eye == "left" else way_x, np.stack([way_x, way_y], axis=-1)
        if not (disparity < 0).any():  # only signed disparities may be 0 or less
            moved[~(moved > 0)] = np.nan
        way[np.isnan(moved)] = np.nan
        changed = {"disparity": moved, "correspondence": way}
        if eye == "right":
            in_px = np.array([[self._cos, -self._lean], [self._fall, self._cos]])
            in_metres = np.array([[self._cos, -self._sin], [self._sin, self._cos]])
            for name, turn in (("normals", in_metres), *((name, in_px) for name in _FLOWS)):
                if name in arrays:
                    changed[name] = np.where(np.isfinite(arrays[name]), arrays[name], np.nan)
                    changed[name][..., :2] = changed[name][..., :2] @ turn.T
        return {
            name: np.where(np.isnan(array), np.inf, array).astype(np.float32)
            for name, array in changed.items()
            if name in arrays
        }
