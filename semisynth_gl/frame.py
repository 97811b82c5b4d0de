"""The renderer's answer: one stereo pair as arrays, top-left origin."""

from dataclasses import dataclass, fields
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.camera import Crop, StereoCamera

VISIBLE = 255
OCCLUDED = 128
OUTSIDE = 0

Output = Literal["visibility", "instances", "depth", "flow", "flow_backward", "disparity_change"]
OUTPUTS: tuple[Output, ...] = get_args(Output)
DEFAULT_OUTPUTS: tuple[Output, ...] = ("visibility",)
FUTURE_OUTPUTS: frozenset[Output] = frozenset({"flow", "disparity_change"})
PAST_OUTPUTS: frozenset[Output] = frozenset({"flow_backward"})
FLOW_OUTPUTS = FUTURE_OUTPUTS | PAST_OUTPUTS
"""Those that compare a pair with the one before or after it in time."""

TruthOf = Literal["both", "left"]
TRUTHS: tuple[TruthOf, ...] = get_args(TruthOf)

# The ways to antialias colour. Drivers have powers of two as numbers of samples.
ANTIALIAS_PATTERN = r"^(none|msaa(2|4|8|16|32)|ssaa[2-8])$"


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A rendered stereo pair with its truth.

    What was not asked for is None.

    Attributes:
        camera: the camera that took it.
        left: (H, W, 3) uint8 RGB.
        right: (H, W, 3) uint8 RGB.
        disparity_left: (H, W) float32, px, positive; inf where nothing is seen or the rig makes it zero or negative.
        disparity_right: (H, W) float32, likewise, in the right view's pixels; None, as the other truth of the right
            view, where the left one's was asked for alone.
        visibility_left: (H, W) uint8: `VISIBLE` where the right eye sees the same point, `OCCLUDED` where something
            hides it there, `OUTSIDE` where it leaves the right image or has no valid disparity.
        visibility_right: (H, W) uint8, likewise for the right view.
        instances_left: (H, W) uint16: k + 1 where instance k of the scene is seen, 0 where nothing is.
        instances_right: (H, W) uint16, likewise for the right view.
        depth_left: (H, W) float32 planar depth, m; inf where nothing is seen.
        depth_right: (H, W) float32, likewise for the right view.
        flow_left: (H, W, 2) float32, px: where the point seen at a pixel is in the same view at the next frame, minus
            the pixel; x right, y down. Both are inf where nothing is seen, or the point is nearer than the near plane
            then, or behind it.
        flow_right: (H, W, 2) float32, likewise for the right view.
        flow_visibility_left: (H, W) uint8: `VISIBLE` where the left view sees the same point at the next frame too,
            `OCCLUDED` where something hides it then or it is no longer there, `OUTSIDE` where it has left the image or
            has no flow.
        flow_visibility_right: (H, W) uint8, likewise for the right view.
        flow_backward_left: (H, W, 2) float32, as `flow_left`, but to the previous frame.
        flow_backward_right: (H, W, 2) float32, likewise for the right view.
        flow_backward_visibility_left: (H, W) uint8, as `flow_visibility_left`, but at the previous frame.
        flow_backward_visibility_right: (H, W) uint8, likewise for the right view.
        disparity_change_left: (H, W) float32, px: the disparity of the point seen at a pixel at the next frame, minus
            the one at this frame; inf where either is none.
        disparity_change_right: (H, W) float32, likewise for the right view, in its own terms.
    """

    camera: StereoCamera
    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    disparity_left: NDArray[np.float32]
    disparity_right: NDArray[np.float32] | None = None
    visibility_left: NDArray[np.uint8] | None = None
    visibility_right: NDArray[np.uint8] | None = None
    instances_left: NDArray[np.uint16] | None = None
    instances_right: NDArray[np.uint16] | None = None
    depth_left: NDArray[np.float32] | None = None
    depth_right: NDArray[np.float32] | None = None
    flow_left: NDArray[np.float32] | None = None
    flow_right: NDArray[np.float32] | None = None
    flow_visibility_left: NDArray[np.uint8] | None = None
    flow_visibility_right: NDArray[np.uint8] | None = None
    flow_backward_left: NDArray[np.float32] | None = None
    flow_backward_right: NDArray[np.float32] | None = None
    flow_backward_visibility_left: NDArray[np.uint8] | None = None
    flow_backward_visibility_right: NDArray[np.uint8] | None = None
    disparity_change_left: NDArray[np.float32] | None = None
    disparity_change_right: NDArray[np.float32] | None = None

    def cropped(self, crop: Crop) -> "Frame":
        """Return a crop of both views, in arrays of its own.

        Raises:
            InputError: where the crop reaches beyond the image.
        """
        camera = self.camera.cropped(crop)
        part = slice(crop.y_px, crop.bottom_px), slice(crop.x_px, crop.right_px)
        arrays = {each.name: getattr(self, each.name) for each in fields(Frame) if each.name != "camera"}
        return Frame(camera, **{name: array[part].copy() for name, array in arrays.items() if array is not None})
