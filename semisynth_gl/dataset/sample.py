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
from semisynth_gl.frame.frame import CHANNELS, ROLES, SKY, Channel, Frame, View
from semisynth_gl.inputs.errors import InputError, ReadError
from semisynth_gl.layouts import Key, Layout
from semisynth_gl.layouts.roles import Sample, mask_from_not_occluded, not_occluded_role, restore_outside


@dataclass(frozen=True, slots=True, eq=False)
class StoredFrame(Frame):
    """A pair read from files: the arrays of its files, and the facts in them.

    Attributes:
        name: the pair's name, such as ``middlebury-000012``.
        split: ``train``, ``validation`` or ``test``.
        index: the pair's number in the split.
        provenance: the origin of the pair, in JSON's types.
        calibration: Middlebury's calib.txt, in layouts that have one.
        encodings: codecs of the files, with the values that they round and cannot store.
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
        """Return where a view shows the sky, (H, W) bool; None where that is not known.

        It is known in all pairs without a sky, and with one by the output ``sky``, or by ``instances``.
        """
        view = self.view(eye)
        return np.asarray(view.sky == SKY) if "sky" in view else self.sky_of_instances(eye)

    def sky_of_instances(self, eye: Eye) -> NDArray[np.bool_] | None:
        """Return where a view shows the sky, (H, W) bool, by its instances alone; see `sky`."""
        view, rows = self.view(eye), self.provenance.get("instances")
        ids = view.get("instances")
        if self.provenance.get("sky") is not True:
            return np.zeros((self.camera.height_px, self.camera.width_px), bool)
        if ids is None or not isinstance(rows, list):
            return None
        is_sky = np.array([False, *(isinstance(row, dict) and row.get("sky") is True for row in rows)])
        return np.asarray(is_sky[np.minimum(ids, len(rows))])

    def rounding_px(self, disparity: NDArray[np.floating[Any]] | float) -> NDArray[np.float64]:
        """Return the largest error that the codec puts on disparities, of the same shape, float64 px."""
        error = self.encodings.disparity.error_px
        if self.encodings.disparity.signed:
            return np.full(np.shape(disparity), error)
        # 0 means "no disparity": disparities that would round to 0 are stored as the smallest step.
        return np.where(np.asarray(disparity) <= 2 * error, 2 * error, error)


LatestFiles = dict[str, tuple[NDArray[Any], bytes]]
"""Value and file of each role of the latest pair, for successive pairs that share a left view."""


@dataclass(frozen=True, slots=True)
class EncodedPair:
    """A pair as files in memory: their bytes by path.

    ``share_beyond`` is the share of pixels whose disparity the codec cannot store, in the view with the larger share.
    """

    files: dict[str, bytes]
    share_beyond: float


def encode_pair(
    layout: Layout,
    key: Key,
    frame: Frame,
    provenance: Mapping[str, Any],
    ndisp: int,
    encodings: Encodings,
    latest: LatestFiles | None = None,
) -> EncodedPair:
    """Encode a pair as files; a channel that the frame lacks gets no file.

    Disparities that the codec cannot store become invalid, in the masks, in the changes of disparity and in the
    calibration too; the provenance, in JSON's types, then counts them by view under `Channel.beyond_key`. Likewise
    flow. ``ndisp`` is an upper bound of the disparities in whole pixels, and ``encodings`` are those of
    `Layout.encodings_for`. Where pairs share a view, ``latest`` has the files of earlier pairs, no value of which may
    have been changed since. Raises InputError where a codec needs a package that is not installed.
    """
    beyond: dict[str, dict[str, int]] = {}
    for channel in CHANNELS.values():
        codec = encodings.codec(channel.codec)
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
            files[path] = _encode(name, role.codec(encodings), value, latest)
    pixels = frame.camera.width_px * frame.camera.height_px
    return EncodedPair(files, max(beyond.get(View.disparity.beyond_key, {}).values(), default=0) / pixels)


def _encode(role: str, codec: Codec[Any], value: Any, latest: LatestFiles | None) -> bytes:  # noqa: ANN401 - by role
    """Encode a role's value, or return the latest pair's file where that pair has the value bit for bit."""
    if latest is None or not isinstance(value, np.ndarray):
        return codec.encode(value)
    earlier = latest.get(role)
    if earlier is None or not _same_bits(earlier[0], value):
        earlier = latest[role] = value, codec.encode(value)
    return earlier[1]


def _same_bits(first: NDArray[Any], second: NDArray[Any]) -> bool:
    alike = first.shape == second.shape and first.dtype == second.dtype
    return first is second or (alike and first.tobytes() == second.tobytes())


def decode_file(layout: Layout, role: str, data: bytes, path: Path, encodings: Encodings) -> Any:  # noqa: ANN401 - by role
    """Decode a role's file; the path is for messages. Raises ReadError where the file is cut off or of another kind."""
    return layout.role(role).unwrap(layout.role(role).codec(encodings).decode(data, path), path)


def wrong_sizes(values: Mapping[str, Any], size: tuple[int, int]) -> Iterator[tuple[str, str]]:
    """Yield the role of each of a pair's values whose size differs from the dataset's height and width, and the fault.

    The size of a camera, a calibration or a provenance is that of the camera's images.
    """
    for role, value in values.items():
        if isinstance(value, np.ndarray):
            expected = (*size, *value.shape[2:])
            if value.shape != expected:
                yield role, f"expected shape {expected}, as the dataset's images have it, got {value.shape}"
        elif (found := camera_size(value)) is not None and found != size:
            height, width = found
            yield role, f"expected a camera of the dataset's images, {size[1]} x {size[0]} px, got {width} x {height}"


def camera_size(value: object) -> tuple[Any, Any] | None:
    """Return height and width in a camera, a calibration or a provenance, px; None of anything else."""
    if isinstance(value, Calibration):
        value = value.camera
    if isinstance(value, StereoCamera):
        return value.height_px, value.width_px
    camera = value.get("camera") if isinstance(value, Mapping) else None
    return (camera.get("height_px"), camera.get("width_px")) if isinstance(camera, Mapping) else None


def assemble_frame(key: Key, values: Mapping[str, Any], encodings: Encodings) -> StoredFrame:
    """Assemble a pair from values by role: at least both images, the left disparity and the provenance.

    Raises:
        ReadError: where the provenance has no camera, or the truth of points that are not occluded is not among the
            truth of all points.
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
        # A calibration is that of the rectified pair.
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
    """Return a view whose mask knows of points that lie above or below the other image; see `restore_outside`."""
    view = frame.view(eye)
    if frame.camera.rectified or not view.keys() >= {"disparity", "visibility"}:
        return view
    if view["visibility"].shape != view["disparity"].shape:
        return view
    way = view["correspondence"] if "correspondence" in view else frame.ways(eye).astype(np.float32)
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
