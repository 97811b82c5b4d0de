"""Rectangles in front of the right camera, which hide the scene there and say so in the masks."""

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageStat

from semisynth_gl.frame.camera import Crop
from semisynth_gl.frame.frame import CHANNELS, OCCLUDED, VISIBLE, Frame


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
        ways = frame.ways("left")
        along, down = ways[:, :, 0], ways[:, :, 1]
        known = np.isfinite(along)
        y, x = np.nonzero(known)
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
