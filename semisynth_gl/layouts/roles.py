"""The roles of files: the content of a pair's file, its encoding, and the output that it belongs to.

`FILE_ROLES` lists all roles. Some have the name of an array of a frame, as in `semisynth_gl.frame.channels.ROLES`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from operator import itemgetter, methodcaller
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.codecs import Codec, Encodings
from semisynth_gl.codecs.calib import KITTI_CALIB, MIDDLEBURY_CALIB, CalibContent
from semisynth_gl.codecs.json_object import JSON_OBJECT
from semisynth_gl.codecs.png import GREY8
from semisynth_gl.frame.camera import OTHER_EYE, Eye
from semisynth_gl.frame.channels import CHANNELS, OCCLUDED, OUTSIDE, VISIBLE, Channel, ViewArrays
from semisynth_gl.frame.frame import Frame, finite_range
from semisynth_gl.inputs.errors import ReadError

NEEDED_ROLES = frozenset({"left", "right", "disparity_left", "provenance"})
"""Roles of the files that every pair must have."""
_LARGEST_OBJECT = 255


class StorablePair(NamedTuple):
    """A pair to be encoded. Values of its frame that the codecs cannot store are already marked as invalid.

    ``provenance`` says how the pair was made, in JSON's types. ``ndisp`` is an upper bound of its disparities in whole
    pixels.
    """

    frame: Frame
    provenance: Mapping[str, Any]
    ndisp: int


@dataclass(frozen=True, slots=True)
class FileRole:
    """The content of one kind of file.

    Attributes:
        meaning: the content in a few words.
        codec: returns the file's codec for a dataset's encodings.
        value: returns the value that the codec encodes.
        output: the output to which the file belongs; None for a file that every pair has.
        eye: the view whose truth the file holds; None for images, maps into raw images, and files about the pair.
        arrays: roles of the arrays that the value needs; a pair that lacks one gets no such file.
    """

    meaning: str
    codec: Callable[[Encodings], Codec[Any]]
    value: Callable[[StorablePair], Any]
    output: str | None = None
    eye: Eye | None = None
    arrays: frozenset[str] = frozenset()


def not_occluded_role(channel: Channel[Any], eye: Eye) -> str:
    """Return the role of a channel's values at visible points only, such as ``not_occluded_left``."""
    return f"{channel.name.removeprefix('disparity')}_not_occluded_{eye}".removeprefix("_")


def mask_from_not_occluded(
    truth: NDArray[np.float32], not_occluded: NDArray[np.float32], channel: Channel[Any], eye: Eye, path: Path
) -> NDArray[np.uint8]:
    """Return the mask of a disparity or flow, (H, W) uint8, from all values and from those of visible points.

    Both arrays are (H, W) float32 px, or (H, W, 2) for flow, and inf where unknown; the path is for messages. Raises
    ReadError where a finite value of ``not_occluded`` differs from the one in ``truth``.
    """
    seen = _is_known(not_occluded)
    if (truth[seen] != not_occluded[seen]).any():
        raise ReadError(path, f"pixels in {not_occluded_role(channel, eye)} are not those in {channel.role(eye)}")
    mask = np.where(seen, VISIBLE, np.where(_is_known(truth), OCCLUDED, OUTSIDE)).astype(np.uint8)
    return restore_outside(mask, truth, eye)


def restore_outside(mask: NDArray[np.uint8], truth: NDArray[np.float32], eye: Eye) -> NDArray[np.uint8]:
    """Return a frame's mask from a file's ``mask``: OCCLUDED points that lie outside the other image become OUTSIDE.

    ``truth`` is the disparity or flow of the view ``eye``, (H, W) or (H, W, 2) float32 px, inf where unknown. Since
    files round disparities, the result may differ from the frame's mask at the border. A 0 in the file stays 0.
    """
    height, width = mask.shape
    # Without truth, the point's position is unknown. NaN is neither inside nor outside.
    shift = np.where(np.isfinite(truth), truth, np.float32(np.nan)).reshape(height, width, -1)
    along = -shift[..., 0] if truth.ndim == 2 and eye == "left" else shift[..., 0]
    outside = _is_outside(np.arange(width, dtype=np.float32) + along, width)
    if truth.ndim == 3:
        outside |= _is_outside(np.arange(height, dtype=np.float32)[:, None] + shift[..., 1], height)
    return np.where((mask == OCCLUDED) & outside, np.uint8(OUTSIDE), mask)


def number_objects(instances: NDArray[np.uint16], table: Sequence[Mapping[str, Any]]) -> NDArray[np.uint8]:
    """Return KITTI's map of objects, (H, W): 0 for no instance and for instances that are "still", else 1 to 255.

    ``instances`` are (H, W) ids, and row k of the provenance's ``table`` describes id k + 1. The number after 255 is 1.
    """
    objects = [0, *(0 if row["still"] else 1 + number % _LARGEST_OBJECT for number, row in enumerate(table))]
    return np.array(objects, np.uint8)[instances]


def _is_known(truth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return where there is a disparity, or both components of flow, (H, W) bool."""
    known = np.isfinite(truth)
    return np.asarray(known if known.ndim == 2 else known[..., 0] & known[..., 1])


def _is_outside(position: NDArray[np.float32], length: int) -> NDArray[np.bool_]:
    return np.asarray((position < -0.5) | (position >= length - 0.5))


def _stored_mask(truth: Channel[Any], view: ViewArrays) -> NDArray[np.uint8]:
    """Return the mask of a disparity or flow as Middlebury's files have it.

    A pixel is 255 where its point is visible in the other view or at the other moment, 128 where it is hidden or
    outside the image there, and 0 without truth.
    """
    # OUTSIDE is 0, so the maximum turns it into OCCLUDED where there is truth.
    stored = _is_known(view[truth.name]).view(np.uint8)
    stored *= np.uint8(OCCLUDED)
    mask: NDArray[np.uint8] = view[str(truth.mask)]
    return np.maximum(mask, stored, out=stored)


def _not_occluded(truth: Channel[Any], view: ViewArrays) -> NDArray[np.float32]:
    seen = view[str(truth.mask)] == VISIBLE
    return np.where(seen[..., None] if truth.components > 1 else seen, view[truth.name], np.float32(np.inf))


def _vertical(eye: Eye, view: ViewArrays) -> NDArray[np.float32]:
    down = view.correspondence[..., 1]
    # y_left - y_right in both views, as the disparity is x_left - x_right.
    return down if eye == "right" else np.where(np.isinf(down), np.float32(np.inf), -down)


def _right_exposed(stops: float, pair: StorablePair) -> NDArray[np.uint8]:
    """Return the right image times 2 to the power of stops, as `semisynth_gl.pairs.imperfections` does."""
    levels = np.rint(np.clip(np.arange(256, dtype=np.float32) * np.float32(2.0**stops), 0, 255)).astype(np.uint8)
    exposed: NDArray[np.uint8] = levels[pair.frame.right.image]
    return exposed


def _calibration(pair: StorablePair) -> CalibContent:
    _, vmin, vmax = finite_range(pair.frame.left.disparity)
    camera = pair.frame.camera
    return CalibContent(camera, camera.doffs_px, pair.ndisp, vmin, vmax)


def _roles_of(eye: Eye) -> dict[str, FileRole]:
    """Return the roles of the files about one view."""

    def role(meaning: str, like: Channel[Any], value: Callable[[ViewArrays], Any], *channels: Channel[Any]) -> FileRole:
        """Return the role of a file that needs ``channels``, with the output of the first and the codec of ``like``."""
        return FileRole(
            meaning.format(view=eye, other=OTHER_EYE[eye]),
            methodcaller("codec", like),
            lambda pair: value(pair.frame.view(eye)),
            channels[0].output,
            eye if channels[0].is_truth else None,
            frozenset(channel.role(eye) for channel in channels),
        )

    roles = {each.role(eye): role(each.meaning, each, itemgetter(each.name), each) for each in CHANNELS.values()}
    for truth in CHANNELS.values():
        if truth.mask is None:
            continue
        mask, truth_name = CHANNELS[truth.mask], truth.name.removesuffix("_backward")
        seen = mask.meaning.partition(",")[0]
        meaning = f"{seen}, {OCCLUDED} where it does not, {OUTSIDE} where there is no {truth_name}"
        roles[mask.role(eye)] = role(meaning, mask, partial(_stored_mask, truth), mask, truth)
        meaning = f"{truth.role(eye)}, where its mask says that the point is visible too"
        roles[not_occluded_role(truth, eye)] = role(meaning, truth, partial(_not_occluded, truth), mask, truth)
    meaning = "y_left - y_right of the {view} view's pixels, float32 px; inf where there is no disparity"
    roles[f"disparity_y_{eye}"] = role(meaning, ViewArrays.depth, partial(_vertical, eye), ViewArrays.correspondence)
    return roles


FILE_ROLES: Mapping[str, FileRole] = {
    **_roles_of("left"),
    **_roles_of("right"),
    "right_under": FileRole(
        "right image a stop darker", methodcaller("codec", ViewArrays.image), partial(_right_exposed, -1)
    ),
    "right_over": FileRole(
        "right image a stop brighter", methodcaller("codec", ViewArrays.image), partial(_right_exposed, 1)
    ),
    "objects": FileRole(
        "8-bit: 1 to 255 for objects, 0 for all else; of the left view",
        lambda _: GREY8,
        lambda pair: number_objects(pair.frame.left.instances, pair.provenance["instances"]),
        "instances",
        arrays=frozenset({"instances_left"}),
    ),
    "calibration": FileRole(
        "the cameras, as Middlebury's calib.txt has them", lambda _: MIDDLEBURY_CALIB, _calibration
    ),
    "calib_cam_to_cam": FileRole(
        "the cameras, as KITTI's calib_cam_to_cam.txt has them",
        lambda _: KITTI_CALIB,
        lambda pair: pair.frame.camera,
    ),
    "provenance": FileRole(
        "what made the pair: seeds, camera, and every instance in the scene",
        lambda _: JSON_OBJECT,
        lambda pair: pair.provenance,
    ),
}
