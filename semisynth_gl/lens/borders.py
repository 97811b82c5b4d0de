"""The borders that a rectification leaves: where a sensor saw nothing, and what that means for masks."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import EYES, OTHER_EYE, Eye
from semisynth_gl.frame.channels import CHANNELS, OCCLUDED, OUTSIDE, VISIBLE, View
from semisynth_gl.frame.frame import Frame
from semisynth_gl.lens.chain import LensChain

# What hangs on a pixel's disparity.
_OF_DISPARITY = ("disparity", "correspondence", "disparity_change")


def with_borders(
    frame: Frame, chains: Mapping[Eye, LensChain], outputs: Collection[str], *, border_disparity: bool
) -> Frame:
    """Return a frame whose masks leave out what a sensor did not see, in either view.

    Args:
        frame: a whole pair.
        chains: each eye's lens.
        outputs: of the dataset; ``valid`` is added to views that have truth.
        border_disparity: whether disparities stay that the view's own sensor did not see, as all other truth does.
    """
    valid = {eye: chain.valid for eye, chain in chains.items()}
    views: dict[Eye, View] = {}
    for eye in EYES:
        view = frame.view(eye)
        changed: dict[str, NDArray[Any]] = {}
        if "visibility" in view:
            # As files have it: not visible, for whatever reason.
            most = np.where(bordered(frame, eye, valid), np.uint8(OCCLUDED), np.uint8(VISIBLE))
            changed["visibility"] = np.minimum(view.visibility, most)
        if "valid" in outputs and "disparity" in view:
            changed["valid"] = np.where(valid[eye], np.uint8(VISIBLE), np.uint8(OUTSIDE))
        if not border_disparity and "disparity" in view:
            for name in (*_OF_DISPARITY, "visibility"):
                if name in view:
                    changed[name] = changed.get(name, view[name]).copy()
                    changed[name][~valid[eye]] = CHANNELS[name].nothing
        views[eye] = view.with_channels(changed)
    return Frame(frame.camera, views["left"], views["right"])


def bordered(frame: Frame, eye: Eye, valid: Mapping[Eye, NDArray[np.bool_]]) -> NDArray[np.bool_]:
    """Return where a sensor saw nothing of a view's point, its own or the other eye's, (H, W) bool.

    Args:
        frame: the pair; the view has a disparity.
        eye: the view.
        valid: (H, W) bool by eye, where its sensor saw something.
    """
    return ~(valid[eye] & _seen_by_other(frame, eye, valid[OTHER_EYE[eye]]))


def _seen_by_other(frame: Frame, eye: Eye, valid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return where the other view's nearest pixel to a view's point is valid, (H, W) bool; True outside the image."""
    height, width = valid.shape
    if valid.all():
        return valid
    columns, rows = np.arange(width, dtype=np.float32), np.arange(height)[:, None]
    if frame.camera.rectified:
        disparity = frame.view(eye).disparity
        column = np.rint(columns - disparity if eye == "left" else columns + disparity)
        inside = (column >= 0) & (column < width)
        place = np.where(inside, column, 0).astype(np.intp)
        place += rows * width
    else:
        along, down = np.moveaxis(frame.correspondences(eye), 2, 0)
        with np.errstate(invalid="ignore"):
            column, row = np.rint(columns + along), np.rint(rows + down)
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        place = np.where(inside, row * width + column, 0).astype(np.intp)
    return np.asarray(valid.ravel().take(place) | ~inside)
