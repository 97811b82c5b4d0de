"""The roles of files: the content of a pair's file, its encoding, and the output that it belongs to.

A role is the name of an array of a frame (see `semisynth_gl.frame.channels.ROLES`), or another name in `ROLES` below.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.codecs import Codec, Encodings
from semisynth_gl.codecs.calib import KITTI_CALIB, MIDDLEBURY_CALIB, Calibration
from semisynth_gl.codecs.json_object import JSON_OBJECT
from semisynth_gl.frame.camera import EYES, OTHER_EYE, Eye
from semisynth_gl.frame.channels import CHANNELS, OCCLUDED, OUTSIDE, VISIBLE, Channel, View
from semisynth_gl.frame.channels import ROLES as FRAME_ROLES
from semisynth_gl.frame.frame import Frame, finite_range, through_levels
from semisynth_gl.inputs.errors import ReadError
from semisynth_gl.layouts.key import Key

_LARGEST_OBJECT = 255
# Codec of a channel by its dtype and components, where a dataset's encodings do not choose it.
_CODECS = {
    ("uint8", 1): "grey8",
    ("uint16", 1): "grey16",
    ("float32", 1): "float",
    ("float32", 2): "shift",
    ("float32", 3): "vector",
}


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """A pair to be encoded; values of its frame that the codecs cannot store are already invalid.

    ``provenance`` says in JSON's types how the pair was made, and ``ndisp`` is an upper bound of its disparities in
    whole pixels.
    """

    key: Key
    frame: Frame
    provenance: Mapping[str, Any]
    ndisp: int


@dataclass(frozen=True, slots=True)
class Role:
    """The content of one kind of file.

    Attributes:
        meaning: the content in a few words.
        codec_or_name: the file's codec, or its name for `Encodings.codec`.
        value: returns the value of a sample that the codec encodes.
        output: the output to which the file belongs; None for a file that every pair has.
        eye: the view whose truth the file holds; None for images, their maps, and files about the pair.
        arrays: arrays of the frame that the value needs, by role; pairs that lack one get no such file.
        unwrap: returns the value for readers, from the decoded value and the file's path, which is for messages.
    """

    meaning: str
    codec_or_name: Codec[Any] | str
    value: Callable[[Sample], Any]
    output: str | None = None
    eye: Eye | None = None
    arrays: frozenset[str] = frozenset()
    unwrap: Callable[[Any, Path], Any] = lambda value, _: value

    def codec(self, encodings: Encodings) -> Codec[Any]:
        """Return the file's codec in a dataset with these encodings."""
        return encodings.codec(self.codec_or_name) if isinstance(self.codec_or_name, str) else self.codec_or_name


def codec_name(channel: Channel[Any]) -> str:
    """Return the name of a channel's codec, see `semisynth_gl.codecs.Encodings.codec`."""
    chosen = {"image": "image", "raw": "image", "disparity": "disparity", "flow": "flow", "flow_backward": "flow"}
    return chosen.get(channel.name) or _CODECS[channel.dtype.name, channel.components]


def not_occluded_role(channel: Channel[Any], eye: Eye) -> str:
    """Return the name of the role of a channel's values at visible points only, such as ``not_occluded_left``."""
    return f"{channel.name.removeprefix('disparity')}_not_occluded_{eye}".removeprefix("_")


def mask_from_not_occluded(
    truth: NDArray[np.float32], not_occluded: NDArray[np.float32], channel: Channel[Any], eye: Eye, path: Path
) -> NDArray[np.uint8]:
    """Return the mask of a disparity or flow, (H, W) uint8, from all values and from those of visible points.

    Both arrays are (H, W) float32 px, or (H, W, 2) for flow, and inf where unknown; the path is for messages. A hidden
    point is occluded or outside the other image, see `restore_outside`. Raises ReadError where a finite value of
    ``not_occluded`` differs from the one in ``truth``.
    """
    seen = _is_known(not_occluded, channel)
    if (truth[seen] != not_occluded[seen]).any():
        roles = not_occluded_role(channel, eye), channel.role(eye)
        raise ReadError(path, f"pixels in {roles[0]} are not those in {roles[1]}")
    mask = np.where(seen, VISIBLE, np.where(_is_known(truth, channel), OCCLUDED, OUTSIDE)).astype(np.uint8)
    return restore_outside(mask, truth, channel, eye)


def stored_mask(mask: NDArray[np.uint8], truth: NDArray[np.float32], channel: Channel[Any]) -> NDArray[np.uint8]:
    """Return a frame's mask, (H, W) uint8, as files have it: points outside the other image count as occluded.

    As in Middlebury's files, a pixel is 255 where its point is visible too, 128 where it is hidden, and 0 where there
    is no truth. ``truth`` is the mask's disparity or flow, (H, W) or (H, W, 2) float32 px, inf where unknown.
    """
    # OUTSIDE is 0, so that the maximum turns it into OCCLUDED where there is truth.
    stored = _is_known(truth, channel).view(np.uint8)
    stored *= np.uint8(OCCLUDED)
    return np.maximum(mask, stored, out=stored)


def restore_outside(
    mask: NDArray[np.uint8], truth: NDArray[np.float32], channel: Channel[Any], eye: Eye
) -> NDArray[np.uint8]:
    """Return a mask of `stored_mask` with a frame's values: OUTSIDE for points beyond the other image's border.

    ``truth`` is the disparity or flow of the view ``eye``, (H, W) or (H, W, 2) float32 px, inf where unknown. The
    renderer compares positions in float32 too, but a rounded disparity may fall on the other side of the border. A 0 in
    the file stays 0, even where there is truth.
    """
    height, width = mask.shape
    # Without truth, the point's position is unknown: NaN lies on no side of a border.
    shift = np.where(np.isfinite(truth), truth, np.float32(np.nan)).reshape(height, width, -1)
    if channel.components == 1 and eye == "left":
        shift = -shift
    outside = _is_outside(np.arange(width, dtype=np.float32) + shift[..., 0], width)
    if channel.components > 1:
        outside |= _is_outside(np.arange(height, dtype=np.float32)[:, None] + shift[..., 1], height)
    return np.where((mask == OCCLUDED) & outside, np.uint8(OUTSIDE), mask)


def number_objects(instances: NDArray[np.uint16], table: Sequence[Mapping[str, Any]]) -> NDArray[np.uint8]:
    """Return KITTI's map of objects, (H, W): 0 for no instance and for instances that are "still", else 1 to 255.

    ``instances`` are (H, W) ids, and row k of the provenance's ``table`` describes id k + 1. Ids above 255 begin again
    at 1.
    """
    objects = [0, *(0 if row["still"] else 1 + number % _LARGEST_OBJECT for number, row in enumerate(table))]
    return np.array(objects, np.uint8)[instances]


def expose(image: NDArray[np.uint8], stops: float) -> NDArray[np.uint8]:
    """Return 8-bit values, of any shape, times 2 to the power of stops, as `semisynth_gl.pairs.imperfections` does."""
    levels = np.rint(np.clip(np.arange(256, dtype=np.float32) * np.float32(2.0**stops), 0, 255)).astype(np.uint8)
    return through_levels(image, levels)


def _is_known(truth: NDArray[np.float32], channel: Channel[Any]) -> NDArray[np.bool_]:
    """Return where there is a disparity, or flow, (H, W) bool."""
    known = np.isfinite(truth)
    return np.asarray(known if channel.components == 1 else known[..., 0] & known[..., 1])


def _is_outside(position: NDArray[np.float32], length: int) -> NDArray[np.bool_]:
    return np.asarray((position < -0.5) | (position >= length - 0.5))


def _of_view(
    eye: Eye,
    meaning: str,
    codec: str,
    value: Callable[[View], NDArray[Any]],
    *channels: Channel[Any],
    output: str | None,
    is_truth: bool = True,
) -> Role:
    """Return the role of a file whose ``value`` is computed from channels of a view."""
    return Role(
        meaning.format(view=eye, other=OTHER_EYE[eye]),
        codec,
        lambda sample: value(sample.frame.view(eye)),
        output,
        eye if is_truth else None,
        frozenset(channel.role(eye) for channel in channels),
    )


def _channel(eye: Eye, each: Channel[Any]) -> Role:
    def value(view: View) -> NDArray[Any]:
        return view[each.name]

    return _of_view(eye, each.meaning, codec_name(each), value, each, output=each.output, is_truth=each.is_truth)


def _mask(eye: Eye, mask: Channel[Any], truth: Channel[Any]) -> Role:
    def value(view: View) -> NDArray[np.uint8]:
        return stored_mask(view[mask.name], view[truth.name], truth)

    seen = mask.meaning.partition(",")[0]
    meaning = f"{seen}, {OCCLUDED} where it does not, {OUTSIDE} where there is no {codec_name(truth)}"
    return _of_view(eye, meaning, codec_name(mask), value, mask, truth, output=mask.output)


def _not_occluded(eye: Eye, mask: Channel[Any], truth: Channel[Any]) -> Role:
    def value(view: View) -> NDArray[np.float32]:
        seen = view[mask.name] == VISIBLE
        return np.where(seen[..., None] if truth.components > 1 else seen, view[truth.name], np.float32(np.inf))

    meaning = f"{truth.role(eye)}, where its mask says that the point is visible too"
    return _of_view(eye, meaning, codec_name(truth), value, mask, truth, output=mask.output)


def _vertical(eye: Eye) -> Role:
    def value(view: View) -> NDArray[np.float32]:
        down = view.correspondence[..., 1]
        # y_left - y_right in both views, as the disparity is x_left - x_right.
        return down if eye == "right" else np.where(np.isinf(down), np.float32(np.inf), -down)

    meaning = "y_left - y_right of the {view} view's pixels, float32 px; inf where there is no disparity"
    return _of_view(eye, meaning, "float", value, View.correspondence, output="correspondence")


def _calibration(sample: Sample) -> Calibration:
    _, vmin, vmax = finite_range(sample.frame.left.disparity)
    camera = sample.frame.camera
    return Calibration(camera, camera.doffs_px, sample.ndisp, vmin, vmax)


_MASKED = [
    (eye, CHANNELS[channel.mask], channel) for channel in CHANNELS.values() if channel.mask is not None for eye in EYES
]

ROLES: Mapping[str, Role] = {
    **{role: _channel(eye, channel) for role, (eye, channel) in FRAME_ROLES.items()},
    **{mask.role(eye): _mask(eye, mask, channel) for eye, mask, channel in _MASKED},
    **{not_occluded_role(channel, eye): _not_occluded(eye, mask, channel) for eye, mask, channel in _MASKED},
    **{f"disparity_y_{eye}": _vertical(eye) for eye in EYES},
    "right_under": Role("right image a stop darker", "image", lambda sample: expose(sample.frame.right.image, -1)),
    "right_over": Role("right image a stop brighter", "image", lambda sample: expose(sample.frame.right.image, 1)),
    "objects": Role(
        "8-bit: 1 to 255 for objects, 0 for all else; of the left view",
        "grey8",
        lambda sample: number_objects(sample.frame.left.instances, sample.provenance["instances"]),
        "instances",
        arrays=frozenset({"instances_left"}),
    ),
    "calibration": Role("the cameras, as Middlebury's calib.txt has them", MIDDLEBURY_CALIB, _calibration),
    "calib_cam_to_cam": Role(
        "the cameras, as KITTI's calib_cam_to_cam.txt has them", KITTI_CALIB, lambda sample: sample.frame.camera
    ),
    "provenance": Role(
        "what made the pair: seeds, camera, and every instance in the scene", JSON_OBJECT, lambda each: each.provenance
    ),
}
