"""Rectangles in front of the right camera, which hide the scene there and say so in the masks."""

from collections.abc import Sequence
from math import ceil

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageStat

from semisynth_gl.frame.camera import Crop
from semisynth_gl.frame.channels import CHANNELS, OCCLUDED, VISIBLE
from semisynth_gl.frame.frame import Frame


def occluded(frame: Frame, rectangles: Sequence[Crop]) -> Frame:
    """Return a pair with rectangles in its right image, in its mean colour.

    Left disparities stay. Left pixels whose point a rectangle hides become `OCCLUDED` in the visibility, where the
    left view has one. Right pixels in a rectangle show nothing of the scene: they lose their truth.

    Args:
        frame: the pair.
        rectangles: within the right image.
    """
    if not rectangles:
        return frame
    height, width = frame.camera.height_px, frame.camera.width_px
    hidden = np.zeros((height, width), bool)
    for each in rectangles:
        hidden[each.y_px : each.bottom_px, each.x_px : each.right_px] = True
    arrays = {name: array.copy() for name, array in frame.right.items()}
    arrays["image"][hidden] = np.rint(ImageStat.Stat(Image.fromarray(frame.right.image)).mean).astype(np.uint8)
    for name in arrays.keys() - {"image"}:
        arrays[name][hidden] = CHANNELS[name].nothing
    left = frame.left
    if "visibility" in left:
        top, bottom = _reached(frame, hidden)
        ways = frame.cropped(Crop(0, top, width, bottom - top)).ways("left")
        along, down = ways[:, :, 0], ways[:, :, 1]
        known = np.isfinite(along)
        y, x = np.nonzero(known)
        y += top
        column = np.rint(x + along[known]).astype(np.intp)
        row = np.rint(y + down[known]).astype(np.intp)
        within = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        covered = np.zeros(len(x), bool)
        covered[within] = hidden[row[within], column[within]]
        visibility = left.visibility.copy()
        seen = visibility[y, x] == VISIBLE
        visibility[y[covered & seen], x[covered & seen]] = OCCLUDED
        left = left.with_channels({"visibility": visibility})
    return Frame(frame.camera, left, frame.right.with_channels(arrays))


def _reached(frame: Frame, hidden: NDArray[np.bool_]) -> tuple[int, int]:
    """Return the first left row whose points may be hidden, and the one after the last, to look at no others."""
    disparity, (height, width) = frame.left.disparity, hidden.shape
    rows = np.flatnonzero(hidden.any(1))
    finite = disparity[np.isfinite(disparity)]
    # The way down is largest at a corner, for the nearest or the farthest point.
    y, x, d = np.meshgrid((0.0, height - 1.0), (0.0, width - 1.0), (finite.min(initial=0), finite.max(initial=0)))
    ways = frame.camera.correspondence("left", x, y, frame.camera.depth_at("left", x, y, d))
    down = np.abs(ways[..., 1]).max()
    if not np.isfinite(down):
        return 0, height
    reach = ceil(down) + 1
    return max(0, int(rows[0]) - reach), min(height, int(rows[-1]) + 1 + reach)
