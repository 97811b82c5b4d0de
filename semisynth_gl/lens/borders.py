"""The borders of rectified images, where the sensor saw nothing, and the masks there."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import EYES, OTHER_EYE, Eye
from semisynth_gl.frame.channels import CHANNELS, OCCLUDED, OUTSIDE, VISIBLE, ViewArrays
from semisynth_gl.frame.frame import Frame
from semisynth_gl.lens.chain import LensChain

# The masks, by the truth that gives a point's position in the other view or at the other moment.
_MASKS = {name: channel.mask for name, channel in CHANNELS.items() if channel.mask is not None}
# The channels that are computed from a pixel's disparity.
_OF_DISPARITY = ("disparity", "correspondence", "disparity_change", "visibility")


def with_borders(
    frame: Frame, chains: Mapping[Eye, LensChain], outputs: Collection[str], *, border_disparity: bool
) -> Frame:
    """Return a whole frame whose masks exclude points in a border, in either view or at either moment.

    The output ``valid`` is added to views that have truth. ``border_disparity`` says whether disparities in the view's
    own border stay; all other truth does.
    """
    valid = {eye: chain.valid for eye, chain in chains.items()}
    views: dict[Eye, ViewArrays] = {}
    for eye in EYES:
        view = frame.view(eye)
        changed: dict[str, NDArray[Any]] = {}
        for channel, mask in _MASKS.items():
            if mask in view:
                # Files store only whether a point is visible, so borders are OCCLUDED too.
                most = np.where(bordered(frame, eye, valid, channel), np.uint8(OCCLUDED), np.uint8(VISIBLE))
                changed[mask] = np.minimum(view[mask], most)
        if "valid" in outputs and "disparity" in view:
            changed["valid"] = np.where(valid[eye], np.uint8(VISIBLE), np.uint8(OUTSIDE))
        if not border_disparity and "disparity" in view:
            for name in _OF_DISPARITY:
                if name in view:
                    lost = bordered(frame, eye, valid, "flow") if name == "disparity_change" else ~valid[eye]
                    changed[name] = changed.get(name, view[name]).copy()
                    changed[name][lost] = CHANNELS[name].fill
        views[eye] = view.with_channels(changed)
    return Frame(frame.camera, views["left"], views["right"])


def bordered(
    frame: Frame, eye: Eye, valid: Mapping[Eye, NDArray[np.bool_]], channel: str = "disparity"
) -> NDArray[np.bool_]:
    """Return the pixels, (H, W) bool, whose point lies in a border, in this view or where ``channel`` leads.

    The channel ``disparity`` leads to the other view, ``flow`` and ``flow_backward`` to the same view at the next and
    the previous frame. ``valid`` is (H, W) bool for each eye, True where its sensor saw something.
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
    """Return where the pixel nearest to a vector's end is valid, (H, W) bool; True outside the image.

    ``along`` and ``down`` are (H, W) px, from each pixel. Vectors that are not finite end outside.
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
