"""The borders of rectified images, where the sensor saw nothing, and the truth of points in borders."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import EYES, OTHER_EYE, Eye
from semisynth_gl.frame.channels import CHANNELS, OCCLUDED, OUTSIDE, VISIBLE, ViewArrays
from semisynth_gl.frame.frame import Frame
from semisynth_gl.lens.rectification import EyeRectification

# The mask of each channel that gives a point's position in the other view, or in the next or previous frame.
_MASKS = {name: channel.mask for name, channel in CHANNELS.items() if channel.mask is not None}
# The channels that exist only where a pixel has a disparity.
_NEED_DISPARITY = ("disparity", "correspondence", "disparity_change", "visibility")


def with_borders(
    frame: Frame, lenses: Mapping[Eye, EyeRectification], outputs: Collection[str], *, border_disparity: bool
) -> Frame:
    """Return the frame with masks in which no point in a border is visible.

    The ``frame`` must not be cropped yet, since ``lenses`` describe whole images.
    Views with truth get the output ``valid`` if it is requested. Without ``border_disparity``, pixels in a border lose
    their disparity and all values that need one; other truth stays.
    """
    valid = {eye: lens.valid for eye, lens in lenses.items()}
    views: dict[Eye, ViewArrays] = {}
    for eye in EYES:
        view = frame.view(eye)
        changed: dict[str, NDArray[Any]] = {}
        for channel, mask in _MASKS.items():
            if mask in view:
                # Not OUTSIDE: files have one value for OCCLUDED and OUTSIDE, and readers take it for OUTSIDE only where
                # the point is outside the image.
                limit = np.where(in_border(frame, eye, valid, channel), np.uint8(OCCLUDED), np.uint8(VISIBLE))
                changed[mask] = np.minimum(view[mask], limit)
        if "valid" in outputs and "disparity" in view:
            changed["valid"] = np.where(valid[eye], np.uint8(VISIBLE), np.uint8(OUTSIDE))
        if not border_disparity and "disparity" in view:
            for name in _NEED_DISPARITY:
                if name in view:
                    # The change of disparity needs the disparity in the next frame too.
                    lost = in_border(frame, eye, valid, "flow") if name == "disparity_change" else ~valid[eye]
                    changed[name] = changed.get(name, view[name]).copy()
                    changed[name][lost] = CHANNELS[name].fill
        views[eye] = view.with_channels(changed)
    return Frame(frame.camera, views["left"], views["right"])


def in_border(
    frame: Frame, eye: Eye, valid: Mapping[Eye, NDArray[np.bool_]], channel: str = "disparity"
) -> NDArray[np.bool_]:
    """Return the pixels, (H, W) bool, that are in a border themselves, or whose points are in a border elsewhere.

    ``channel`` says where: ``disparity`` in the other view, ``flow`` and ``flow_backward`` in the same view of the next
    and the previous frame. ``valid`` is (H, W) bool for each eye, False in its border.
    """
    if channel != "disparity":
        return ~(valid[eye] & valid_at(valid[eye], *np.moveaxis(frame.view(eye)[channel], 2, 0)))
    if frame.camera.rectified:
        disparity = frame.view(eye).disparity
        along, down = -disparity if eye == "left" else disparity, np.float32(0)
    else:
        along, down = np.moveaxis(frame.correspondences(eye), 2, 0)
    return ~(valid[eye] & valid_at(valid[OTHER_EYE[eye]], along, down))


def valid_at(
    valid: NDArray[np.bool_], along: NDArray[np.floating], down: NDArray[np.floating] | np.float32
) -> NDArray[np.bool_]:
    """Return whether the pixel nearest to the end of each pixel's vector is valid, (H, W) bool.

    ``along`` and ``down`` are the vectors, (H, W) px. The result is True for vectors that are not finite, and for
    vectors that end outside the image, where masks are 0 anyway.
    """
    height, width = valid.shape
    if valid.all():
        return valid
    with np.errstate(invalid="ignore"):
        column = np.rint(np.arange(width, dtype=np.float32) + along)
        row = np.rint(np.arange(height)[:, None] + down)
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    position = np.where(inside, row * width + column, 0).astype(np.intp)
    return np.asarray(valid.ravel().take(position) | ~inside)
