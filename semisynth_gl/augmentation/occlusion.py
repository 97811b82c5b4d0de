"""Rectangles in front of the right camera, which hide the scene there and say so in the masks."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageStat

from semisynth_gl.frame.camera import Crop
from semisynth_gl.frame.channels import CHANNELS, FLOW_OUTPUTS, OCCLUDED, VISIBLE
from semisynth_gl.frame.frame import Frame


def occluded(frame: Frame, rectangles: Sequence[Crop]) -> Frame:
    """Return a pair with rectangles in its right image, in its mean colour.

    Left disparities stay. Masks say `OCCLUDED` where a rectangle hides the point of a visible left pixel, or that of a
    visible right pixel at another frame of the sequence, whose rectangles are the same. Right pixels in a rectangle
    show nothing of the scene: they lose their truth.

    Args:
        frame: the pair.
        rectangles: within the right image.
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
