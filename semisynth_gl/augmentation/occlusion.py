"""Rectangles in front of the right camera, which hide the scene there and say so in the masks."""

from collections.abc import Sequence
from typing import Any

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
    arrays["image"][hidden] = np.rint(ImageStat.Stat(Image.fromarray(frame.right.image)).mean).astype(np.uint8)
    for name in arrays.keys() - {"image"}:
        arrays[name][hidden] = CHANNELS[name].nothing
    for name, channel in CHANNELS.items():
        if channel.output in FLOW_OUTPUTS and channel.mask in arrays:
            _hide(arrays[channel.mask], arrays[name], hidden)
    left = frame.left
    if "visibility" in left:
        left = left.with_channels({"visibility": left.visibility.copy()})
        _hide(left.visibility, frame.correspondences("left"), hidden)
    return Frame(frame.camera, left, frame.right.with_channels(arrays))


def _hide(mask: NDArray[np.uint8], way: NDArray[np.floating[Any]], hidden: NDArray[np.bool_]) -> None:
    """Set to `OCCLUDED` where a mask says visible, but the way (H, W, 2) leads into what is hidden, (H, W) bool."""
    y, x = np.nonzero((mask == VISIBLE) & np.isfinite(way[..., 0]))
    column = np.rint(x + way[y, x, 0]).astype(np.intp)
    row = np.rint(y + way[y, x, 1]).astype(np.intp)
    height, width = hidden.shape
    within = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    y, x, row, column = y[within], x[within], row[within], column[within]
    covered = hidden[row, column]
    mask[y[covered], x[covered]] = OCCLUDED
