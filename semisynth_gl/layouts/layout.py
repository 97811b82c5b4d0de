"""What a layout is: names of files, and what each holds.

A layout is a module of this package with one class and its instance, `LAYOUT`. A new one is a new module.
"""

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import isfinite
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.camera import StereoCamera
from semisynth_gl.config import Config
from semisynth_gl.dataset.stored import StoredFrame
from semisynth_gl.encodings import Encodings
from semisynth_gl.errors import InputError
from semisynth_gl.frame import FLOW_OUTPUTS, OUTSIDE, Frame, Output, TruthOf
from semisynth_gl.read.calib import decode_calib
from semisynth_gl.read.encodings import FLOW_DECODERS, disparity_decoder, image_decoder
from semisynth_gl.read.error import ReadError
from semisynth_gl.read.json import decode_json
from semisynth_gl.read.pfm import decode_pfm
from semisynth_gl.read.png import decode_grey, decode_grey16
from semisynth_gl.splits import SplitName
from semisynth_gl.write.calib import encode_calib
from semisynth_gl.write.encodings import FLOW_ENCODERS, disparity_encoder, image_encoder
from semisynth_gl.write.pfm import encode_pfm
from semisynth_gl.write.png import encode_png

BEYOND = "disparity_beyond"
"""Key of a pair's provenance: how many pixels of each view have a disparity that the encoding cannot say."""
FLOW_BEYOND = "flow_beyond"
"""Likewise of flow to the next frame."""
FLOW_BACKWARD_BEYOND = "flow_backward_beyond"
"""Likewise of flow to the previous frame."""

Decode = Callable[[bytes, Path], Any]


@dataclass(frozen=True, slots=True)
class Key:
    """What the names of a pair's files depend on.

    Attributes:
        config: the config's name; letters, digits and hyphens.
        split: the split that the pair is of.
        index: its number there.
        sequence_length: how many pairs make a sequence in a dataset with an output of `FLOW_OUTPUTS`, whose loaders
            take names that follow each other for successive frames; None in any other, where each pair is named by
            itself.
    """

    config: str
    split: SplitName
    index: int
    sequence_length: int | None = None

    @property
    def sequence(self) -> int:
        """The number of its sequence in the split; its own where it is named by itself."""
        return self.index // (self.sequence_length or 1)

    @property
    def frame(self) -> int:
        """Its number in that sequence; 0 where it is named by itself."""
        return self.index % (self.sequence_length or 1)

    @property
    def scene(self) -> str:
        """A name for the pair: sorted by name is sorted by index up to a million pairs."""
        return f"{self.config}-{self.index:06d}"


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """A pair on its way into files.

    Attributes:
        key: which one.
        frame: images and truth; what the encodings of disparity and flow cannot say is invalid already.
        provenance: what made it, in JSON's types.
        ndisp: an upper bound of its disparities, whole pixels.
        encodings: of images, disparities and flow.
    """

    key: Key
    frame: Frame
    provenance: Mapping[str, Any]
    ndisp: int
    encodings: Encodings


class Layout(ABC):
    """Names of files, and what each holds.

    A file's role is the name of the array of `Frame` that it holds, ``calibration``, ``provenance``, or one of the
    layout's own. Layouts whose files are encoded in the common ways define `files` alone.

    Attributes:
        packed: whether the files of a shard are packed into one tar; else they stand by themselves.
        needs: outputs that the layout cannot do without.
        encodings: its own; None where the config's section ``files`` decides.
        exact_images: whether images come back bit for bit.
        right_truth_for: names loaders that read the right view's truth too; "" where none does.
        most_frames: how many frames of a sequence names can tell apart, where they count them; None for any number.
    """

    packed: ClassVar[bool] = False
    needs: ClassVar[frozenset[Output]] = frozenset()
    encodings: ClassVar[Encodings | None] = None
    exact_images: ClassVar[bool] = True
    right_truth_for: ClassVar[str] = ""
    most_frames: ClassVar[int | None] = None

    @abstractmethod
    def files(self, key: Key, encodings: Encodings) -> dict[str, str]:
        """Return the path of each role's file, below the split's folder, or inside the shard's tar."""

    def output_of(self, role: str) -> Output | None:
        """Return the output without which a role has no file; None for those that always have one."""
        return _OUTPUT_OF.get(role)

    def is_of_right_truth(self, role: str) -> bool:
        """Whether a role has no file where truth is of the left view alone."""
        return role in _RIGHT_TRUTH

    def roles(self, files: Mapping[str, str], outputs: Collection[Output], truth: TruthOf) -> dict[str, str]:
        """Keep those of a pair's `files` that it has with these outputs and this truth."""
        return {
            role: path
            for role, path in files.items()
            if (self.output_of(role) is None or self.output_of(role) in outputs)
            and (truth == "both" or not self.is_of_right_truth(role))
        }

    def encode_file(self, role: str, sample: Sample) -> bytes | None:
        """Return what a role's file holds; None where the frame lacks it."""
        if role == "calibration":
            return encode_calib(sample.frame, sample.ndisp)
        if role == "provenance":
            return encode_json(sample.provenance)
        array = getattr(sample.frame, role)
        return None if array is None else self._encoder(role, sample.encodings)(array)

    def decode_file(self, role: str, data: bytes, path: Path, encodings: Encodings) -> Any:  # noqa: ANN401 - by role
        """Return what a role's file says; the path is for messages.

        Raises:
            ReadError: where it is cut off, or not what its role says.
        """
        if role in ("left", "right"):
            return image_decoder(encodings.image)(data, path)
        if role in ("disparity_left", "disparity_right"):
            return disparity_decoder(encodings.disparity).decode(data, path)
        if role in FLOWS:
            return FLOW_DECODERS[encodings.flow].decode(data, path)
        return _DECODERS[role](data, path)

    def assemble(self, key: Key, values: Mapping[str, Any], encodings: Encodings) -> StoredFrame:
        """Make a frame of what the files say, by role: at least both images, the left disparity and the provenance."""
        calibration = values.get("calibration")
        provenance = values["provenance"]
        decoder, flow_decoder = disparity_decoder(encodings.disparity), FLOW_DECODERS[encodings.flow]
        return StoredFrame(
            camera=_camera(provenance, Path(key.scene)) if calibration is None else calibration.camera,
            **{role: values[role] for role in ARRAYS if role in values},
            name=key.scene,
            split=key.split,
            index=key.index,
            provenance=provenance,
            calibration=calibration,
            disparity_error_px=decoder.error_px,
            disparity_largest_px=decoder.largest_px,
            flow_error_px=flow_decoder.error_px,
            flow_largest_px=flow_decoder.largest_px,
            exact_images=self.exact_images,
        )

    def encode(
        self, key: Key, frame: Frame, provenance: Mapping[str, Any], ndisp: int, encodings: Encodings
    ) -> dict[str, bytes]:
        """Encode a pair as files, by path.

        What the frame lacks is not written. Disparities that the encoding cannot say become invalid, in the masks, in
        the changes of disparity and in the calibration too; the provenance then counts them under `BEYOND`, by view.
        Likewise flow, under `FLOW_BEYOND` and `FLOW_BACKWARD_BEYOND`.

        Args:
            key: which pair.
            frame: images and truth.
            provenance: what made it, in JSON's types.
            ndisp: an upper bound of its disparities, whole pixels.
            encodings: of images, disparities and flow; see `chosen_encodings`.

        Raises:
            InputError: where an encoding needs what is not installed.
        """
        limit = disparity_encoder(encodings.disparity).beyond_px
        if isfinite(limit):
            frame, beyond = _without_disparities(frame, limit)
            provenance = {**provenance, BEYOND: beyond}
        flow_beyond = FLOW_ENCODERS[encodings.flow].beyond
        if flow_beyond is not None:
            for kind, name in _FLOW_COUNTS.items():
                frame, lost = _without_flow(frame, kind, flow_beyond)
                provenance = {**provenance, name: lost} if lost else provenance
        sample = Sample(key, frame, provenance, ndisp, encodings)
        written = {path: self.encode_file(role, sample) for role, path in self.files(key, encodings).items()}
        return {path: data for path, data in written.items() if data is not None}

    def lists(self, keys: Sequence[Key], encodings: Encodings) -> dict[str, bytes]:
        """Return files about all pairs of a split, by path below its folder; for lists of names."""
        del keys, encodings
        return {}

    def links(self, keys: Sequence[Key]) -> dict[str, str]:
        """Return symbolic links below a split's folder: path, and where it leads, relative to the link's folder."""
        del keys
        return {}

    def folders(self) -> tuple[str, ...]:
        """Return folders that loaders want to exist though they may be empty."""
        return ()

    def folder(self, split: SplitName, splits: Collection[SplitName]) -> str:
        """Return the folder of a split below the dataset's, "" for that itself; ``splits`` are all that it has."""
        return "" if len(splits) == 1 else split

    def advice(self, pairs: int, config: Config, split: SplitName = "train") -> list[str]:
        """Return sentences on what will keep loaders of this layout from reading a split of so many pairs."""
        del pairs, split
        if config.truth == "both" or not self.right_truth_for:
            return []
        return [f"{self.right_truth_for} read the right view's truth too: set truth to both."]

    def chosen_encodings(self, config: Config) -> Encodings:
        """Return the encodings that pairs of a config have in this layout."""
        return config.files.encodings if self.encodings is None else self.encodings

    def _encoder(self, role: str, encodings: Encodings) -> Callable[[Any], bytes]:
        if role in ("left", "right"):
            return image_encoder(encodings.image)
        if role in ("disparity_left", "disparity_right"):
            return disparity_encoder(encodings.disparity).encode
        if role in FLOWS:
            return FLOW_ENCODERS[encodings.flow].encode
        # What is read as PFM is written so.
        return encode_pfm if _DECODERS[role] is decode_pfm else encode_png


# By the names of `Frame`, less the side: with which output there is such an array, and, where every layout encodes it
# alike, how it is read back.
_KINDS: Mapping[str, tuple[Output, Decode | None]] = {
    "visibility": ("visibility", decode_grey),
    "instances": ("instances", decode_grey16),
    "depth": ("depth", decode_pfm),
    "flow": ("flow", None),
    "flow_visibility": ("flow", decode_grey),
    "flow_backward": ("flow_backward", None),
    "flow_backward_visibility": ("flow_backward", decode_grey),
    "disparity_change": ("disparity_change", decode_pfm),
}
_SIDES = ("left", "right")
_FLOW_COUNTS: Mapping[str, str] = {"flow": FLOW_BEYOND, "flow_backward": FLOW_BACKWARD_BEYOND}

FLOWS = frozenset(f"{kind}_{side}" for kind in _FLOW_COUNTS for side in _SIDES)
"""The arrays of `Frame` that are encoded as `Encodings.flow` says."""
ARRAYS = tuple(f"{kind}{side}" for kind in ("", "disparity_", *(f"{kind}_" for kind in _KINDS)) for side in _SIDES)
"""The arrays of `Frame`."""

_OUTPUT_OF: Mapping[str, Output] = {f"{kind}_{side}": each for kind, (each, _) in _KINDS.items() for side in _SIDES}
_RIGHT_TRUTH = frozenset({"disparity_right", *(f"{kind}_right" for kind in _KINDS)})
_DECODERS: Mapping[str, Decode] = {
    **{f"{kind}_{side}": each for kind, (_, each) in _KINDS.items() if each is not None for side in _SIDES},
    "calibration": decode_calib,
    "provenance": decode_json,
}


SHORT_NAMES: Mapping[SplitName, str] = {"train": "train", "validation": "val", "test": "test"}
"""What the lists of pairs that loaders bring along call the splits."""

# The provenance has more of the camera than it takes to make one.
_CAMERA = tuple(each.name for each in fields(StereoCamera))


def encode_json(values: Mapping[str, Any]) -> bytes:
    """Encode values in JSON's types, readable, with a line break at the end."""
    return (json.dumps(values, indent=1) + "\n").encode()


def pair_lines(pairs: Iterable[Mapping[str, str]]) -> bytes:
    """Write a list as loaders read it: left image, right image and left disparity of a pair, a line each.

    Args:
        pairs: paths by role; none may hold a blank.
    """
    return "".join(f"{files['left']} {files['right']} {files['disparity_left']}\n" for files in pairs).encode()


def sequence_length(outputs: Collection[Output], length: int) -> int | None:
    """Return `Key.sequence_length` of a dataset with these outputs whose sequences have so many pairs."""
    return length if FLOW_OUTPUTS.intersection(outputs) else None


def share_beyond(frame: Frame, encodings: Encodings) -> float:
    """Return the share of a frame's pixels whose disparity the encoding cannot say, of the view that has more."""
    limit = disparity_encoder(encodings.disparity).beyond_px
    if not isfinite(limit):
        return 0.0
    views = [view for view in (frame.disparity_left, frame.disparity_right) if view is not None]
    return max(float(_beyond(view, limit).mean()) for view in views)


def _camera(provenance: Mapping[str, Any], path: Path) -> StereoCamera:
    try:
        return StereoCamera(**{name: provenance["camera"][name] for name in _CAMERA})
    except (KeyError, TypeError, InputError) as error:
        raise ReadError(path, f"its provenance has no camera that can be used: {error!r}") from None


def _without_disparities(frame: Frame, limit_px: float) -> tuple[Frame, dict[str, int]]:
    """Make disparities from a limit on invalid; return how many there are in each view."""
    counts: dict[str, int] = {}
    for side in _SIDES:
        disparity = getattr(frame, f"disparity_{side}")
        if disparity is not None:
            beyond = _beyond(disparity, limit_px)
            counts[side] = int(beyond.sum())
            none = {"disparity": np.inf, "visibility": OUTSIDE, "disparity_change": np.inf}
            frame = _with(frame, {f"{kind}_{side}": value for kind, value in none.items()}, beyond)
    return frame, counts


def _without_flow(
    frame: Frame, kind: str, beyond: Callable[[NDArray[np.float32]], NDArray[np.bool_]]
) -> tuple[Frame, dict[str, int]]:
    """Make flow that an encoding cannot say invalid; return how many pixels of each view have such, {} without flow."""
    counts: dict[str, int] = {}
    for side in _SIDES:
        flow = getattr(frame, f"{kind}_{side}")
        if flow is not None:
            lost = beyond(flow)
            counts[side] = int(lost.sum())
            frame = _with(frame, {f"{kind}_{side}": np.inf, f"{kind}_visibility_{side}": OUTSIDE}, lost)
    return frame, counts


def _with(frame: Frame, values: Mapping[str, float], where: NDArray[np.bool_]) -> Frame:
    """Set those arrays that a frame has to values, by name, where (H, W) is true."""
    if not where.any():
        return frame
    changed: dict[str, Any] = {}
    for name, value in values.items():
        array = getattr(frame, name)
        if array is not None:
            changed[name] = array.copy()
            changed[name][where] = value
    return replace(frame, **changed)


def _beyond(disparity: NDArray[np.float32], limit_px: float) -> NDArray[np.bool_]:
    beyond: NDArray[np.bool_] = np.isfinite(disparity) & (disparity >= np.float32(limit_px))
    return beyond
