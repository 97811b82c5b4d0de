"""A pair as files in memory, encoded by the roles of a layout, and read back under the same names from any layout."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.codecs import Codec, Encodings
from semisynth_gl.codecs.calib import Calibration
from semisynth_gl.frame.camera import EYES, Eye, StereoCamera
from semisynth_gl.frame.channels import CHANNELS, ROLES, SKY, VISIBLE, Channel, View
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.errors import InputError, ReadError
from semisynth_gl.layouts import Key, Layout
from semisynth_gl.layouts.roles import Sample, codec_name, mask_from_not_occluded, not_occluded_role, restore_outside


@dataclass(frozen=True, slots=True, eq=False)
class StoredFrame(Frame):
    """A pair read from files: a frame with the facts that its files state.

    Attributes:
        name: the pair's name, such as ``middlebury-000012``.
        split: ``train``, ``validation`` or ``test``.
        index: the pair's number in the split.
        provenance: the content of the pair's JSON file, which says how the pair was made.
        calibration: the content of Middlebury's calib.txt; None in layouts without this file.
        encodings: codecs of the files; they know how far each file's values are rounded.
    """

    name: str = ""
    split: str = "train"
    index: int = 0
    provenance: dict[str, Any] = field(default_factory=dict)
    calibration: Calibration | None = None
    encodings: Encodings = field(default_factory=Encodings)

    @property
    def recipe(self) -> str | None:
        """Name of the recipe that the scene was made by; None where the config has no recipes."""
        return self.provenance.get("recipe")

    def sky(self, eye: Eye) -> NDArray[np.bool_] | None:
        """Return where a view shows the sky, (H, W) bool; None where the files do not say it.

        A pair whose scene has a sky needs the output ``sky`` or ``instances`` for it. All other pairs show no sky.
        """
        view = self.view(eye)
        return np.asarray(view.sky == SKY) if "sky" in view else self.sky_of_instances(eye)

    def sky_of_instances(self, eye: Eye) -> NDArray[np.bool_] | None:
        """Return where a view shows the sky, (H, W) bool, by the output ``instances`` only; see `sky`."""
        view, rows = self.view(eye), self.provenance.get("instances")
        ids = view.get("instances")
        if self.provenance.get("sky") is not True:
            return np.zeros((self.camera.height_px, self.camera.width_px), bool)
        if ids is None or not isinstance(rows, list):
            return None
        is_sky = np.array([False, *(isinstance(row, dict) and row.get("sky") is True for row in rows)])
        return np.asarray(is_sky[np.minimum(ids, len(rows))])

    @property
    def border_disparity(self) -> bool:
        """Whether disparities reach into the borders that a lens leaves; see the config's ``lens.border_disparity``."""
        match self.provenance.get("lens"):
            case {"border_disparity": False}:
                return False
        return True

    def left_out(self, eye: Eye) -> NDArray[np.bool_]:
        """Return where a view has no disparity because its sensor saw nothing, (H, W) bool.

        It is empty unless the config says ``border_disparity: false`` of the lens.
        """
        if not self.border_disparity and "valid" in self.view(eye):
            return np.asarray(self.view(eye).valid != VISIBLE)
        return np.zeros((self.camera.height_px, self.camera.width_px), bool)

    def rounding_px(self, disparity: NDArray[np.floating[Any]] | float) -> NDArray[np.float64]:
        """Return the largest rounding error of stored disparities in pixels, float64 of the shape of ``disparity``."""
        error = self.encodings.disparity.error_px
        if self.encodings.disparity.signed:
            return np.full(np.shape(disparity), error)
        # 0 means "no disparity": disparities that would round to 0 are stored as the smallest step.
        return np.where(np.asarray(disparity) <= 2 * error, 2 * error, error)


@dataclass(frozen=True, slots=True)
class EncodedPair:
    """A pair as files in memory: their bytes by path.

    ``share_beyond`` is the share of pixels, 0 to 1, whose disparity the codec cannot store, in the view with more.
    """

    files: dict[str, bytes]
    share_beyond: float


def encode_pair(
    layout: Layout, key: Key, frame: Frame, provenance: Mapping[str, Any], ndisp: int, encodings: Encodings
) -> EncodedPair:
    """Encode a pair as files; a channel that the frame lacks gets no file.

    Disparities and flow that the codec cannot store become invalid. They become invalid in the masks, in the changes of
    disparity and in the calibration too, and the written provenance counts them by view under `Channel.beyond_key`.

    Args:
        layout: the files' names and roles.
        key: the pair's identity, which its files are named after.
        frame: the pair; it is not changed.
        provenance: how the pair was made, in JSON's types.
        ndisp: upper bound of the disparities in whole pixels.
        encodings: the codecs that `Layout.encodings_for` returns.
    """
    beyond: dict[str, dict[str, int]] = {}
    for channel in CHANNELS.values():
        codec = encodings.codec(codec_name(channel))
        if channel.mask is not None and isfinite(codec.limit_px):
            frame, counts = _invalidate(frame, channel, codec)
            if counts:
                beyond[channel.beyond_key] = counts
    provenance = {**provenance, **beyond}
    sample = Sample(key, frame, provenance, ndisp)
    files = {}
    for name, path in layout.files(key, encodings).items():
        role = layout.role(name)
        value = role.value(sample)
        if value is not None:
            files[path] = role.codec(encodings).encode(value)
    pixels = frame.camera.width_px * frame.camera.height_px
    return EncodedPair(files, max(beyond.get(View.disparity.beyond_key, {}).values(), default=0) / pixels)


def decode_file(layout: Layout, role: str, data: bytes, path: Path, encodings: Encodings) -> Any:  # noqa: ANN401 - by role
    """Decode a role's file to what `Role.unwrap` returns; the path is for messages. Raises as `Codec.decode` does."""
    return layout.role(role).unwrap(layout.role(role).codec(encodings).decode(data, path), path)


def wrong_sizes(values: Mapping[str, Any], size: tuple[int, int]) -> Iterator[tuple[str, str]]:
    """Yield the role of each value that does not have the dataset's size, and a message about it.

    ``values`` are a pair's decoded files by role, and ``size`` is the height and width of the dataset's images. A
    camera, a calibration or a provenance has the size of its camera's images. A raw image has the size of the camera
    that the provenance describes, if there is one among the values.
    """
    for role, value in values.items():
        eye, channel = ROLES.get(role, (None, None))
        if isinstance(value, np.ndarray):
            of_sensor = channel is not None and channel.of_sensor
            expected = _sensor_size(values.get("provenance"), eye) if of_sensor else size
            if expected is not None and value.shape[:2] != expected:
                whose = "the camera in the pair's provenance" if of_sensor else "the dataset's images"
                yield role, f"expected shape {(*expected, *value.shape[2:])}, as {whose}, got {value.shape}"
        elif (found := _camera_size(value)) is not None and found != size:
            height, width = found
            yield role, f"expected a camera of the dataset's images, {size[1]} x {size[0]} px, got {width} x {height}"


def _sensor_size(provenance: object, eye: Eye | None) -> tuple[int, int] | None:
    """Return height and width in px of an eye's raw images from a provenance; None where it does not state them."""
    match provenance:
        case {"lens": {**eyes}}:
            match eyes.get(eye):
                case {"height_px": int(height), "width_px": int(width)}:
                    return height, width
    return None


def _camera_size(value: object) -> tuple[Any, Any] | None:
    """Return height and width in px from a camera, a calibration or a provenance; None from any other value."""
    value = value.camera if isinstance(value, Calibration) else value
    match value:
        case StereoCamera():
            return value.height_px, value.width_px
        case {"camera": {**camera}}:
            return camera.get("height_px"), camera.get("width_px")
    return None


def assemble_frame(key: Key, values: Mapping[str, Any], encodings: Encodings) -> StoredFrame:
    """Assemble a pair from its decoded files.

    ``values`` are what `decode_file` returns, by role: at least both images, the left disparity and the provenance.

    Raises:
        ReadError: where the provenance has no camera, or the truth of visible points differs from the truth of all
            points.
    """
    path = Path(key.name)
    arrays = {role: value for role, value in values.items() if role in ROLES}
    for role, (eye, channel) in ROLES.items():
        if channel.mask is None or role not in arrays:
            continue
        mask, visible = CHANNELS[channel.mask].role(eye), values.get(not_occluded_role(channel, eye))
        if visible is not None:
            arrays[mask] = mask_from_not_occluded(arrays[role], visible, channel, eye, path)
        elif mask in arrays and arrays[mask].shape == arrays[role].shape[:2]:
            arrays[mask] = restore_outside(arrays[mask], arrays[role], channel, eye)
    calibration, provenance = values.get("calibration"), values["provenance"]
    stored_camera = provenance.get("camera")
    if calibration is None or (isinstance(stored_camera, dict) and "deviation" in stored_camera):
        # The calibration of a deviating pair describes its rectified twin.
        try:
            camera = StereoCamera.from_values(provenance["camera"])
        except (KeyError, TypeError, InputError) as error:
            raise ReadError(path, f"its provenance has no camera that can be used: {error!r}") from None
    else:
        camera = calibration.camera
    frame = Frame.from_arrays(camera, arrays)
    left, right = (_with_outside(frame, eye) for eye in EYES)
    return StoredFrame(camera, left, right, key.name, key.split, key.index, provenance, calibration, encodings)


def _with_outside(frame: Frame, eye: Eye) -> View:
    """Return a view whose mask marks points above and below the other image as outside; see `restore_outside`."""
    view = frame.view(eye)
    if frame.camera.rectified or not view.keys() >= {"disparity", "visibility"}:
        return view
    if view["visibility"].shape != view["disparity"].shape:
        return view
    way = view["correspondence"] if "correspondence" in view else frame.correspondences(eye).astype(np.float32)
    return view.with_channels({"visibility": restore_outside(view["visibility"], way, View.correspondence, eye)})


def _invalidate(frame: Frame, channel: Channel[Any], codec: Codec[Any]) -> tuple[Frame, dict[str, int]]:
    """Make values that a codec cannot store invalid, and count their pixels in each view that has the channel."""
    affected = {channel.name, channel.mask, "disparity_change" if channel.name == "disparity" else None}
    views, counts = {eye: frame.view(eye) for eye in EYES}, {}
    for eye, view in views.items():
        if channel.name not in view:
            continue
        exceeding = codec.exceeds_limit(view[channel.name])
        counts[eye] = int(exceeding.sum())
        if counts[eye]:
            arrays = {name: array.copy() for name, array in view.items() if name in affected}
            for name, array in arrays.items():
                array[exceeding] = CHANNELS[name].nothing
            views[eye] = view.with_channels(arrays)
    return Frame(frame.camera, views["left"], views["right"]), {str(eye): count for eye, count in counts.items()}
