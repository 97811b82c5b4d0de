"""Encodes a pair as files in memory by a layout's roles, and decodes them; all layouts give the same arrays."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.codecs import Codec, Encodings
from semisynth_gl.codecs.calib import CalibContent
from semisynth_gl.frame.camera import EYES, Eye, StereoCamera
from semisynth_gl.frame.channels import CHANNELS, ROLES, SKY, VISIBLE, Channel, ViewArrays
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.errors import InputError, ReadError, shown
from semisynth_gl.layouts import Layout, PairKey
from semisynth_gl.layouts.roles import StorablePair, mask_from_not_occluded, not_occluded_role, restore_outside


@dataclass(frozen=True, slots=True, eq=False)
class StoredFrame(Frame):
    """A pair read from files: a frame, and facts about it.

    Attributes:
        name: the pair's name, such as ``middlebury-000012``.
        split: ``train``, ``validation`` or ``test``.
        index: the pair's number in the split.
        provenance: the content of the pair's JSON file, which says how the pair was made.
        calibration: the content of Middlebury's calib.txt; None in layouts without this file.
        encodings: codecs of the files, with their rounding errors.
    """

    name: str = ""
    split: str = "train"
    index: int = 0
    provenance: dict[str, Any] = field(default_factory=dict)
    calibration: CalibContent | None = None
    encodings: Encodings = field(default_factory=Encodings)

    @property
    def recipe(self) -> str | None:
        """Name of the scene's recipe; None if the config has no recipes."""
        return self.provenance.get("recipe")

    def sky(self, eye: Eye) -> NDArray[np.bool_] | None:
        """Return where a view shows the sky, (H, W) bool.

        None if the scene has a sky, but the dataset has neither the output ``sky`` nor ``instances``.
        """
        view = self.view(eye)
        return np.asarray(view.sky == SKY) if "sky" in view else self.sky_of_instances(eye)

    def sky_of_instances(self, eye: Eye) -> NDArray[np.bool_] | None:
        """Return where a view shows the sky, (H, W) bool, by the output ``instances`` only; see `sky`."""
        ids, rows = self.view(eye).get("instances"), self.provenance.get("instances")
        if self.provenance.get("sky") is not True:
            return np.zeros((self.camera.height_px, self.camera.width_px), bool)
        if ids is None or not isinstance(rows, list):
            return None
        is_sky = np.array([False, *(row.get("sky") is True for row in rows)])
        return np.asarray(is_sky[np.minimum(ids, len(rows))])

    @property
    def border_disparity(self) -> bool:
        """Whether disparities reach into the borders that a lens leaves; see the config's ``lens.border_disparity``."""
        return (self.provenance.get("lens") or {}).get("border_disparity") is not False

    def cut_border(self, eye: Eye) -> NDArray[np.bool_]:
        """Return where a view has no disparity because its sensor saw nothing, (H, W) bool.

        All are False unless the config's ``lens.border_disparity`` is false.
        """
        if not self.border_disparity and "valid" in self.view(eye):
            return np.asarray(self.view(eye).valid != VISIBLE)
        return np.zeros((self.camera.height_px, self.camera.width_px), bool)

    def rounding_px(self, disparity: NDArray[np.floating[Any]] | float) -> NDArray[np.float64]:
        """Return the largest rounding error of stored disparities, float64 px of the shape of ``disparity``."""
        error = self.encodings.disparity.error_px
        if self.encodings.disparity.signed:
            return np.full(np.shape(disparity), error)
        # 0 means "no disparity": disparities that would round to 0 are stored as the smallest step.
        return np.where(np.asarray(disparity) <= 2 * error, 2 * error, error)


class EncodedPair(NamedTuple):
    """A pair's files, bytes by path below the split's folder or inside the tar, and the pair's provenance."""

    files: dict[str, bytes]
    provenance: Mapping[str, Any]


def encode_pair(
    layout: Layout, key: PairKey, frame: Frame, provenance: Mapping[str, Any], ndisp: int, encodings: Encodings
) -> EncodedPair:
    """Encode a pair as files; a channel that the frame lacks gets no file.

    Disparities and flow that the codec cannot store become invalid, also in the masks, in ``disparity_change`` and in
    the calibration. The written provenance has their number in each view under `Channel.beyond_key`.

    ``provenance`` says how the pair was made, in JSON's types, and ``ndisp`` is an upper bound of the disparities in
    whole pixels. ``encodings`` are the codecs that `Layout.encodings_for` returns.
    """
    provenance = dict(provenance)
    for channel in CHANNELS.values():
        codec = encodings.codec(channel)
        if channel.mask is not None and isfinite(codec.limit_px):
            frame, counts = _invalidate(frame, channel, codec)
            provenance |= {channel.beyond_key: counts} if counts else {}
    pair, present, files = StorablePair(frame, provenance, ndisp), frame.arrays().keys(), {}
    for name, path in layout.files(key, encodings).items():
        role = layout.role(name)
        if role.arrays <= present:
            files[path] = role.codec(encodings).encode(role.value(pair))
    return EncodedPair(files, provenance)


def decode_file(layout: Layout, role: str, data: bytes, path: Path, encodings: Encodings) -> Any:  # noqa: ANN401 - by role
    """Decode a role's file; the path is for messages. Raises as `Codec.decode` does."""
    return layout.role(role).codec(encodings).decode(data, path)


def wrong_sizes(values: Mapping[str, Any], size: tuple[int, int]) -> Iterator[tuple[str, str]]:
    """Yield the role of each value with a wrong size, and a message about it.

    ``values`` are a pair's decoded files by role. ``size`` is the height and width of the dataset's images, and of the
    camera in calibration and provenance. Raw images must have the size of the sensor in the provenance's ``lens``. A
    ``lens`` that is not an object of objects is a fault too.
    """
    lens = values.get("provenance", {}).get("lens") or {}
    if not isinstance(lens, dict) or not all(isinstance(lens.get(eye, {}), dict) for eye in EYES):
        yield "provenance", f"lens: expected an object, with one for each eye, got {shown(lens)}"
        lens = {}
    for role, value in values.items():
        eye, channel = ROLES.get(role, (None, None))
        expected, whose = size, "the dataset's images"
        if channel is not None and channel.name == "raw":
            expected, whose = _height_and_width(lens.get(eye, {})), "the camera in the pair's provenance"
        match value:
            case np.ndarray():
                found: tuple[Any, ...] = value.shape[:2]
            case CalibContent():
                found = value.camera.height_px, value.camera.width_px
            case {"camera": {**camera}}:
                found = _height_and_width(camera)
            case _:
                continue
        if found != expected:
            yield role, f"expected a height and width of {expected} px, as {whose}, got {found}"


def _height_and_width(camera: Mapping[Any, Any]) -> tuple[Any, Any]:
    return camera.get("height_px"), camera.get("width_px")


def assemble_frame(key: PairKey, values: Mapping[str, Any], encodings: Encodings) -> StoredFrame:
    """Assemble a pair from its decoded files, in which `wrong_sizes` has found no fault.

    ``values`` are what `decode_file` returns, by role: at least both images, the left disparity and the provenance.
    Raises ReadError if the provenance has no camera, or a file with the truth of visible points contradicts the file
    with the truth of all points.
    """
    path = Path(key.name)
    arrays = {role: value for role, value in values.items() if role in ROLES}
    for role, (eye, channel) in ROLES.items():
        if channel.mask is None or role not in arrays:
            continue
        mask, visible = CHANNELS[channel.mask].role(eye), values.get(not_occluded_role(channel, eye))
        if visible is not None:
            arrays[mask] = mask_from_not_occluded(arrays[role], visible, channel, eye, path)
        elif mask in arrays:
            arrays[mask] = restore_outside(arrays[mask], arrays[role], eye)
    calibration, provenance = values.get("calibration"), values["provenance"]
    try:
        # The calibration of a deviating pair describes rectified cameras.
        deviates = "deviation" in provenance.get("camera", ())
        camera = calibration.camera if calibration and not deviates else StereoCamera.from_values(provenance["camera"])
    except (KeyError, TypeError, InputError) as error:
        raise ReadError(path, f"its provenance has no camera that can be used: {error!r}") from None
    frame = Frame.from_arrays(camera, arrays)
    left, right = (_with_outside(frame, eye) for eye in EYES)
    return StoredFrame(camera, left, right, key.name, key.split, key.index, provenance, calibration, encodings)


def _with_outside(frame: Frame, eye: Eye) -> ViewArrays:
    """Return a view whose mask is 0 also for points above and below the other image; see `restore_outside`."""
    view = frame.view(eye)
    if frame.camera.rectified or not view.keys() >= {"disparity", "visibility"}:
        return view
    vectors = view["correspondence"] if "correspondence" in view else frame.correspondences(eye).astype(np.float32)
    return view.with_channels({"visibility": restore_outside(view["visibility"], vectors, eye)})


def _invalidate(frame: Frame, channel: Channel[Any], codec: Codec[Any]) -> tuple[Frame, dict[str, int]]:
    """Make values that a codec cannot store invalid, and count them in each view that has the channel."""
    affected = {channel.name, channel.mask, "disparity_change" if channel.name == "disparity" else None}
    views = {eye: frame.view(eye) for eye in EYES}
    counts: dict[str, int] = {}
    for eye, view in views.items():
        if channel.name not in view:
            continue
        exceeding = codec.exceeds_limit(view[channel.name])
        counts[eye] = int(exceeding.sum())
        if counts[eye]:
            arrays = {name: array.copy() for name, array in view.items() if name in affected}
            for name, array in arrays.items():
                array[exceeding] = CHANNELS[name].fill
            views[eye] = view.with_channels(arrays)
    return Frame(frame.camera, views["left"], views["right"]), counts
