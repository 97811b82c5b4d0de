"""Changes of a pair's geometry that keep its truth exact: mirrored, scaled, badly rectified, cropped.

The changed pair is one that a camera could have taken: its calibration and all its arrays change by one rule each.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from semisynth_gl.augmentation.resampling import Points, sheared
from semisynth_gl.frame.camera import EYES, OTHER_EYE, RECTIFIED, Eye, StereoCamera
from semisynth_gl.frame.channels import View
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.errors import InputError

_SURFACE_PX = 0.1
"""By how much three disparities (or ways) in a row on one surface may be off a line."""
_SURFACE_SHARE = 2e-3
"""The same for inverse depths, as a share of each."""
_NEAREST = ("visibility", "instances", "sky", "valid", "normals", "flow_visibility", "flow_backward_visibility")
_WAYS = ("correspondence", "flow", "flow_backward")


def mirrored(frame: Frame) -> Frame:
    """Return the pair as a mirror shows it: the eyes change places.

    Raises:
        InputError: where only the left view has truth, or the right camera deviates from the rectified one.
    """
    if set(frame.left) != set(frame.right):
        raise InputError("mirrored: expected truth of both views, got the left one's: set truth: both, or leave it out")
    if not frame.camera.rectified:
        raise InputError("mirrored: expected a rectified rig, got a right camera that deviates: leave it out")
    camera, last = frame.camera, frame.camera.width_px - 1
    left, right = (_flipped(frame.view(OTHER_EYE[eye])) for eye in EYES)
    return Frame(
        replace(camera, cx_left_px=last - camera.cx_right_px, cx_right_px=last - camera.cx_left_px), left, right
    )


def _flipped(view: View) -> View:
    """Flip the columns of a view's arrays, and the directions that they hold."""
    arrays = {name: np.flip(array, 1).copy() for name, array in view.items()}
    for name in arrays.keys() & {*_WAYS, "normals"}:
        across = arrays[name][..., 0]
        np.negative(across, out=across, where=np.isfinite(across))
    return View(arrays)


@dataclass(frozen=True, slots=True)
class Warp:
    """A part of a pair at another scale, whose right image is shifted and turned.

    Attributes:
        scale_x: factor of the width.
        scale_y: factor of the height.
        right_y_px: by which the right image is moved down, px of the changed pair.
        right_roll_rad: by which the right image is turned about its principal point, clockwise.
    """

    scale_x: float = 1.0
    scale_y: float = 1.0
    right_y_px: float = 0.0
    right_roll_rad: float = 0.0

    @property
    def rectified(self) -> bool:
        """Whether the right image stays where it is."""
        return self.right_y_px == self.right_roll_rad == 0

    def source(self, sides: tuple[int, int], margin: int) -> tuple[int, int]:
        """Return height and width of what a crop of so many px is made of, with a margin on all sides."""
        height, width = sides
        return ceil(height / self.scale_y) + 2 * margin, ceil(width / self.scale_x) + 2 * margin

    def applied(self, frame: Frame, sides: tuple[int, int], margin: int) -> Frame:
        """Return the changed pair.

        Args:
            frame: as large as `source` says.
            sides: height and width of the result, px.
            margin: of the pair, px.

        Raises:
            InputError: where the right image is moved and the pair is not rectified, or has a channel that this
                module cannot move.
        """
        camera = frame.camera
        if not self.rectified and not camera.rectified:
            raise InputError("right_y_px, right_roll_deg: expected a rectified rig, got a right camera that deviates")
        if not self.rectified and "disparity_change" in frame.left:
            raise InputError("right_y_px, right_roll_deg: a moved right image has no disparity_change: leave one out")
        (height, width), (scale_x, scale_y) = sides, (self.scale_x, self.scale_y)
        turn = _Turn(self, camera)
        x = margin + (np.arange(width)[None] + 0.5) / scale_x - 0.5
        y = margin + (np.arange(height)[:, None] + 0.5) / scale_y - 0.5
        box = (float(margin), float(margin), margin + width / scale_x, margin + height / scale_y)
        views: dict[Eye, View] = {}
        for eye in EYES:
            view = frame.view(eye)
            image, at = view.image, (x, y)
            if eye == "right" and not self.rectified:
                image, at = turn.image(image), turn.undone(x, y)
            arrays: dict[str, NDArray[Any]] = {"image": _resized(image, sides, box)}
            if len(view) > 1:
                arrays |= _truth(view, Points(*at, image.shape[:2]))
                if not self.rectified:
                    arrays |= turn.truth(eye, arrays, x, y, at)
                _scaled(arrays, scale_x, scale_y)
            views[eye] = View(arrays)
        deviation = replace(camera.deviation, y_px=camera.deviation.y_px * scale_y)
        if not self.rectified:
            deviation = replace(RECTIFIED, roll_rad=self.right_roll_rad, y_px=self.right_y_px)

        def moved(position: float, scale: float) -> float:
            return (position - margin + 0.5) * scale - 0.5

        changed = replace(
            camera, width_px=width, height_px=height, focal_px=camera.focal_px * scale_x,
            cx_left_px=moved(camera.cx_left_px, scale_x), cx_right_px=moved(camera.cx_right_px, scale_x),
            cy_px=moved(camera.cy_px, scale_y), deviation=deviation,
            fy_over_fx=camera.fy_over_fx * scale_y / scale_x,
        )  # fmt: skip
        return Frame(changed, views["left"], views["right"])


class _Turn:
    """The movement of the right image, in px of the unscaled pair."""

    def __init__(self, warp: Warp, camera: StereoCamera) -> None:
        self._cos, self._sin = np.cos(warp.right_roll_rad), np.sin(warp.right_roll_rad)
        # How far a step to the right leads down, and a step down to the left: a circle is an ellipse in px.
        self._fall = self._sin * camera.fy_over_fx
        self._lean = self._sin / camera.fy_over_fx
        self._cx, self._cy, self._down = camera.cx_right_px, camera.cy_px, warp.right_y_px / warp.scale_y

    def done(self, x: NDArray[Any], y: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return where points of the right image go."""
        across, along = x - self._cx, y - self._cy
        return (
            self._cx + self._cos * across - self._lean * along,
            self._cy + self._down + self._fall * across + self._cos * along,
        )

    def undone(self, x: NDArray[Any], y: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return where points of the moved image come from."""
        across, along = x - self._cx, y - self._cy - self._down
        return self._cx + self._cos * across + self._lean * along, self._cy - self._fall * across + self._cos * along

    def image(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the moved image."""
        height, width = image.shape[:2]
        across, along = np.arange(width) - self._cx, np.arange(height) - self._cy
        lean = self._lean / (1 + self._cos)
        # Three shears make a turn.
        values = image.reshape(height, width, -1).astype(np.float32)
        values = sheared(values, lean * along, axis=1)
        values = sheared(values, -self._fall * across - self._down, axis=0)
        values = sheared(values, lean * (along - self._down), axis=1)
        return np.rint(values).clip(0, 255).astype(np.uint8).reshape(image.shape)

    def truth(
        self, eye: Eye, arrays: Mapping[str, NDArray[Any]], x: NDArray[Any], y: NDArray[Any], at: tuple[Any, Any]
    ) -> dict[str, NDArray[Any]]:
        """Return the truth of a view that the movement changes.

        Args:
            eye: the view.
            arrays: its truth at ``at``, not moved.
            x: columns of its pixels.
            y: rows of its pixels.
            at: columns and rows where the view shows the same, before the movement.
        """
        known = np.isfinite(arrays["disparity"])
        disparity = np.where(known, arrays["disparity"].astype(np.float64), np.nan)
        if eye == "left":
            other_x, other_y = self.done(x - disparity, np.broadcast_to(y, disparity.shape))
            sign = -1
        else:
            other_x, other_y = at[0] + disparity, np.broadcast_to(at[1], disparity.shape)
            sign = 1
        found = sign * (other_x - x)
        if not (disparity[known] < 0).any():
            known &= found > 0
        changed: dict[str, NDArray[Any]] = {"disparity": np.where(known, found, np.inf).astype(np.float32)}
        if "correspondence" in arrays:
            way = np.stack([other_x - x, other_y - y], axis=-1)
            changed["correspondence"] = np.where(known[..., None], way, np.inf).astype(np.float32)
        if eye == "right":
            in_px = np.array([[self._cos, -self._lean], [self._fall, self._cos]], np.float32)
            in_metres = np.array([[self._cos, -self._sin], [self._sin, self._cos]], np.float32)
            for name in ("normals", "flow", "flow_backward"):
                if name in arrays:
                    vectors, turn = arrays[name].copy(), in_metres if name == "normals" else in_px
                    finite = np.isfinite(vectors).all(-1)
                    vectors[finite, :2] = vectors[finite, :2] @ turn.T
                    changed[name] = vectors
        return changed


def _resized(
    image: NDArray[np.uint8], sides: tuple[int, int], box: tuple[float, float, float, float]
) -> NDArray[np.uint8]:
    whole = (box[0], box[1], box[0] + sides[1], box[1] + sides[0])
    if box == whole and box[1].is_integer():
        return image[int(box[1]) : int(box[3]), int(box[0]) : int(box[2])].copy()
    return np.array(Image.fromarray(image).resize(sides[::-1], Image.Resampling.BILINEAR, box))


def _truth(view: View, points: Points) -> dict[str, NDArray[Any]]:
    """Return all arrays of a view but its image at other points."""
    rules: dict[str, Callable[[NDArray[Any]], NDArray[Any]]] = dict.fromkeys(_NEAREST, points.nearest)
    rules |= dict.fromkeys(("disparity", "disparity_change", *_WAYS), lambda each: points.on_surface(each, _SURFACE_PX))
    rules["depth"] = lambda each: _by_inverse(each, points)
    return {name: rules[name](array) for name, array in view.items() if name != "image"}


def _by_inverse(depth: NDArray[np.float32], points: Points) -> NDArray[np.float32]:
    with np.errstate(divide="ignore"):
        inverse = np.reciprocal(depth)
        return np.reciprocal(points.on_surface(inverse, np.float32(_SURFACE_SHARE) * inverse))


def _scaled(arrays: dict[str, NDArray[Any]], scale_x: float, scale_y: float) -> None:
    """Scale what is counted in px, in place."""
    for name in ("disparity", "disparity_change"):
        if name in arrays:
            arrays[name] *= np.float32(scale_x)
    for name in _WAYS:
        if name in arrays:
            arrays[name] *= np.array([scale_x, scale_y], np.float32)
