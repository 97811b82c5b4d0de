"""The folders of KITTI 2015, of which there is ``training`` alone.

``training/`` holds, for pair NNNNNN:

- ``image_2/NNNNNN_10.png`` and ``image_3/NNNNNN_10.png``, the left and the right image
- ``disp_occ_0/NNNNNN_10.png``, the left view's disparity, and ``disp_noc_0/``, the same where the right view sees the
  point too; ``disp_occ_1/`` and ``disp_noc_1/`` are the right view's
- ``obj_map/NNNNNN_10.png``, 0 in the background and 1 to 255 elsewhere, of the left view
- ``calib_cam_to_cam/NNNNNN.txt``
- ``flow_occ/NNNNNN_10.png``, the left view's flow to the next frame, and ``flow_noc/``, the same where that frame
  shows the point too
- what no loader of KITTI looks for: ``instances_0/``, ``instances_1/``, ``depth_0/`` and ``depth_1/``;
  ``flow_occ_right/`` and ``flow_noc_right/``; ``flow_backward_occ/`` and ``flow_backward_noc/``, to the previous frame,
  and the right view's; ``disparity_change_0/NNNNNN_10.pfm`` and ``disparity_change_1/``

``pairs/NNNNNN.json`` is the provenance, ``filenames/KITTI_2015_train.txt`` a list for loaders that read such, and
``Kitti2015/training`` leads to the same files, for torchvision. Masks have no file: they follow from disparities and
flow, see `visibility_of` and `flow_visibility_of`.

In a dataset with an output of flow, NNNNNN is the sequence, and its frames are ``NNNNNN_10``, ``NNNNNN_11`` and so on,
each with all files. The calibration keeps its name for the first one, as loaders look for it, and is
``NNNNNN_11.txt`` for the second one; provenances are ``NNNNNN_10.json`` and so on. ``KittiFlow/training`` leads to the
same files then.
"""

from collections.abc import Mapping, Sequence
from math import ceil
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.camera import StereoCamera
from semisynth_gl.config import Config
from semisynth_gl.dataset.stored import StoredFrame
from semisynth_gl.encodings import Encodings
from semisynth_gl.errors import InputError
from semisynth_gl.frame import FLOW_OUTPUTS, OCCLUDED, OUTSIDE, VISIBLE, Output
from semisynth_gl.layouts.layout import FLOWS, SHORT_NAMES, Key, Layout, Sample, pair_lines
from semisynth_gl.read.encodings import FLOW_DECODERS, disparity_decoder
from semisynth_gl.read.error import ReadError
from semisynth_gl.read.png import decode_grey
from semisynth_gl.scene.background import FACE
from semisynth_gl.splits import SplitName
from semisynth_gl.write.encodings import FLOW_ENCODERS, disparity_encoder
from semisynth_gl.write.png import encode_png

View = Literal["left", "right"]

# Roles that hold what another array has, where a mask says that the point is visible: both names in `Frame`.
_NOT_OCCLUDED: Mapping[str, tuple[str, str]] = {
    "not_occluded_left": ("disparity_left", "visibility_left"),
    "not_occluded_right": ("disparity_right", "visibility_right"),
    "flow_not_occluded_left": ("flow_left", "flow_visibility_left"),
    "flow_not_occluded_right": ("flow_right", "flow_visibility_right"),
    "flow_backward_not_occluded_left": ("flow_backward_left", "flow_backward_visibility_left"),
    "flow_backward_not_occluded_right": ("flow_backward_right", "flow_backward_visibility_right"),
}
_OBJECTS = "objects"
_CALIBRATION = "calib_cam_to_cam"
_LARGEST_OBJECT = 255
# KITTI numbers the frames of a scene with two digits, and begins with this.
_FIRST_FRAME = 10

# HSM's, the evaluation kit's and every repository's own lists count on that many.
_FEWEST = 200
_PSMNET_SIZE = 1232, 368
_PADDED_SIZE = 1248, 384


class Kitti(Layout):
    """KITTI 2015: RAFT-Stereo, PSMNet, HSM, GwcNet, CasStereo, MobileStereoNet, AANet, OpenStereo, torchvision."""

    needs = frozenset({"visibility", "instances"})
    encodings = Encodings(disparity="png16", flow="png16")
    most_frames = 100 - _FIRST_FRAME
    right_truth_for = "torchvision's Kitti2015Stereo and OpenStereo"

    def files(self, key: Key, encodings: Encodings) -> dict[str, str]:
        """Return a pair's files, of the same name in many folders."""
        del encodings
        number = f"{key.sequence:06d}"
        name = f"{number}_{_FIRST_FRAME + key.frame}"
        return {role: f"training/{folder}/{name}{ending}" for role, (folder, ending) in _FOLDERS.items()} | {
            _CALIBRATION: f"training/{_CALIBRATION}/{name if key.frame else number}.txt",
            "provenance": f"pairs/{number if key.sequence_length is None else name}.json",
        }

    def output_of(self, role: str) -> Output | None:
        """Return the output without which a role has no file."""
        if role in _NOT_OCCLUDED:
            return super().output_of(_NOT_OCCLUDED[role][1])
        return "instances" if role == _OBJECTS else super().output_of(role)

    def is_of_right_truth(self, role: str) -> bool:
        """Whether a role has no file where truth is of the left view alone."""
        return super().is_of_right_truth(_NOT_OCCLUDED[role][0] if role in _NOT_OCCLUDED else role)

    def encode_file(self, role: str, sample: Sample) -> bytes | None:
        """Return what a role's file holds; None where the frame lacks it."""
        if role in _NOT_OCCLUDED:
            return _encode_not_occluded(role, sample)
        if role == _OBJECTS:
            ids = sample.frame.instances_left
            return None if ids is None else encode_png(objects_of(ids, sample.provenance["instances"]))
        if role == _CALIBRATION:
            return encode_calibration(sample.frame.camera)
        return super().encode_file(role, sample)

    def decode_file(self, role: str, data: bytes, path: Path, encodings: Encodings) -> Any:  # noqa: ANN401 - by role
        """Return what a role's file says; see `Layout.decode_file`."""
        if role in _NOT_OCCLUDED:
            flows = _NOT_OCCLUDED[role][0] in FLOWS
            decoder = FLOW_DECODERS[encodings.flow] if flows else disparity_decoder(encodings.disparity)
            return decoder.decode(data, path)
        if role == _OBJECTS:
            return decode_grey(data, path)
        if role == _CALIBRATION:
            return decode_calibration(data, path)
        return super().decode_file(role, data, path, encodings)

    def assemble(self, key: Key, values: Mapping[str, Any], encodings: Encodings) -> StoredFrame:
        """Make a frame of what the files say, with the masks that follow from them.

        Raises:
            ReadError: where the disparities of points that both views see are not among those of all points, or the
                flow of points that both frames show.
        """
        path = Path(key.scene)
        masks: dict[str, NDArray[np.uint8]] = {}
        for role, (name, mask) in _NOT_OCCLUDED.items():
            if role not in values or name not in values:
                continue
            if name in FLOWS:
                masks[mask] = flow_visibility_of(values[name], values[role], name, path)
            else:
                view: View = "left" if name == "disparity_left" else "right"
                masks[mask] = visibility_of(values[name], values[role], view, path)
        return super().assemble(key, {**values, **masks}, encodings)

    def lists(self, keys: Sequence[Key], encodings: Encodings) -> dict[str, bytes]:
        """Return a list of the pairs: left image, right image and left disparity, as paths below the split's folder."""
        if not keys:
            return {}
        text = pair_lines(self.files(key, encodings) for key in keys)
        return {f"filenames/KITTI_2015_{SHORT_NAMES[keys[0].split]}.txt": text}

    def links(self, keys: Sequence[Key]) -> dict[str, str]:
        """Return the links under which torchvision looks for the pairs."""
        flow = {"KittiFlow/training": "../training"} if any(key.sequence_length for key in keys) else {}
        return {"Kitti2015/training": "../training"} | flow

    def advice(self, pairs: int, config: Config, split: SplitName = "train") -> list[str]:
        """Tell of too few pairs or frames, of sizes that loaders cannot crop or pad to theirs, of other splits too."""
        sentences = super().advice(pairs, config, split)
        what = "pairs"
        if FLOW_OUTPUTS.intersection(config.outputs):
            if config.sequence.length == 1:
                sentences.append(
                    "RAFT and torchvision take a flow's second image from the frames _11, and without sequences there "
                    "are none: set sequence.length to 2 or more."
                )
            # Loaders count first frames.
            what, pairs = "sequences", ceil(pairs / config.sequence.length)
        width, height = config.camera.width_px, config.camera.height_px
        if pairs < _FEWEST:
            sentences.append(
                f"KITTI 2015 has {_FEWEST} {what}, here are {pairs}: HSM, the evaluation kit and the lists that "
                f"repositories bring along fail with fewer than {_FEWEST}."
            )
        if width < _PSMNET_SIZE[0] or height < _PSMNET_SIZE[1]:
            sentences.append(
                f"PSMNet crops {_PSMNET_SIZE[0]} x {_PSMNET_SIZE[1]} from KITTI, but images are {width} x {height}."
            )
        if width >= _PADDED_SIZE[0] or height >= _PADDED_SIZE[1]:
            sentences.append(
                f"CasStereo, GwcNet and MobileStereoNet pad KITTI to {_PADDED_SIZE[0]} x {_PADDED_SIZE[1]} and want "
                f"less than that, but images are {width} x {height}."
            )
        if split != "train":
            sentences.append(f"KITTI has truth under training alone: {split} pairs get such a folder of their own.")
        return sentences


def visibility_of(
    disparity: NDArray[np.float32], not_occluded: NDArray[np.float32], view: View, path: Path
) -> NDArray[np.uint8]:
    """Work out a view's mask from its disparities, all of them and those that the other view sees too.

    A point that the other view does not see is outside it where its column is, and else occluded. Where rounding puts
    the column right on the image's border, either may have been rendered.

    Args:
        disparity: (H, W) float32 px, inf where there is none.
        not_occluded: likewise.
        view: whose they are.
        path: of the pair, for messages.

    Raises:
        ReadError: where they are of two sizes, or a disparity of the latter is not the former's.
    """
    column = np.arange(disparity.shape[1], dtype=np.float64) + (-disparity if view == "left" else disparity)
    outside = _is_outside(column, disparity.shape[1])
    return _mask(disparity[..., None], not_occluded[..., None], outside, _FOLDERS[f"disparity_{view}"][0], path)


def flow_visibility_of(
    flow: NDArray[np.float32], not_occluded: NDArray[np.float32], name: str, path: Path
) -> NDArray[np.uint8]:
    """Work out a mask of flow from all of it, and from that of points which the other frame shows too.

    A point that it does not show is outside of it where its column and row are, and else occluded; see `visibility_of`.

    Args:
        flow: (H, W, 2) float32 px, inf where there is none.
        not_occluded: likewise.
        name: the array of `Frame` that the former is, for messages.
        path: of the pair, for messages.

    Raises:
        ReadError: where they are of two sizes, or a flow of the latter is not the former's.
    """
    height, width = flow.shape[:2]
    column = np.arange(width, dtype=np.float64) + flow[..., 0]
    row = np.arange(height, dtype=np.float64)[:, None] + flow[..., 1]
    outside = _is_outside(column, width) | _is_outside(row, height)
    return _mask(flow, not_occluded, outside, _FOLDERS[name][0], path)


def _is_outside(position: NDArray[np.float64], length: int) -> NDArray[np.bool_]:
    outside: NDArray[np.bool_] = (position < -0.5) | (position >= length - 0.5)
    return outside


def _mask(
    truth: NDArray[np.float32],
    not_occluded: NDArray[np.float32],
    outside: NDArray[np.bool_],
    occ: str,
    path: Path,
) -> NDArray[np.uint8]:
    """Put a mask together of (H, W, C) truth, that of visible points, and (H, W), where points leave the image.

    ``occ`` is the folder of the former, for messages.
    """
    noc = occ.replace("_occ", "_noc")
    if truth.shape != not_occluded.shape:
        raise ReadError(path, f"{occ} has shape {truth.shape[:2]}, {noc} {not_occluded.shape[:2]}")
    seen = np.isfinite(not_occluded).all(axis=2)
    wrong = int((seen & (truth != not_occluded).any(axis=2)).sum())
    if wrong:
        raise ReadError(path, f"{wrong} pixels in {noc} are not those in {occ}")
    hidden = np.where(outside, OUTSIDE, OCCLUDED)
    return np.where(seen, VISIBLE, np.where(np.isfinite(truth).all(axis=2), hidden, OUTSIDE)).astype(np.uint8)


def objects_of(instances: NDArray[np.uint16], rows: Sequence[Mapping[str, Any]]) -> NDArray[np.uint8]:
    """Return KITTI's map of objects: 0 where the background or nothing is seen, else the instance's id, cut to 8 bits.

    Args:
        instances: (H, W) uint16 ids.
        rows: what each is; row k describes id k + 1.
    """
    ids = np.arange(len(rows) + 1)
    objects = 1 + (ids - 1) % _LARGEST_OBJECT
    objects[0] = 0
    objects[1:][[row["model"] == FACE.name for row in rows]] = 0
    mapped: NDArray[np.uint8] = objects.astype(np.uint8)[instances]
    return mapped


def encode_calibration(camera: StereoCamera) -> bytes:
    """Write size, rotation and projection of both colour cameras as calib_cam_to_cam has them; lengths in metres."""
    f, cy = float(camera.focal_px), float(camera.cy_px)
    lines = []
    for number, cx, shift in (
        ("02", float(camera.cx_left_px), 0.0),
        ("03", float(camera.cx_right_px), -float(camera.focal_baseline)),
    ):
        lines += [
            f"S_rect_{number}: {camera.width_px} {camera.height_px}",
            f"R_rect_{number}: 1 0 0 0 1 0 0 0 1",
            f"P_rect_{number}: {f!r} 0 {cx!r} {shift!r} 0 {f!r} {cy!r} 0 0 0 1 0",
        ]
    return ("\n".join(lines) + "\n").encode()


def decode_calibration(data: bytes, path: Path) -> StereoCamera:
    """Decode what `encode_calibration` writes.

    Raises:
        ReadError: where lines are missing, cut off, or no rectified pair.
    """
    try:
        text = data.decode("ascii")
        lines = {name: rest.split() for name, _, rest in (line.partition(":") for line in text.splitlines())}
        size = [int(value) for value in lines["S_rect_02"]]
        left, right = ([float(value) for value in lines[f"P_rect_{number}"]] for number in ("02", "03"))
        f, cx_left, cy, cx_right, shift = left[0], left[2], left[6], right[2], right[3]
        if not text.endswith("\n") or size != [int(value) for value in lines["S_rect_03"]]:
            raise ReadError(path, "the last line has no end, or the two cameras are not of one size")
        for number, came, wanted in (
            ("02", left, [f, 0, cx_left, 0, 0, f, cy, 0, 0, 0, 1, 0]),
            ("03", right, [f, 0, cx_right, shift, 0, f, cy, 0, 0, 0, 1, 0]),
        ):
            if came != wanted:
                raise ReadError(path, f"P_rect_{number} is {came}, expected {wanted}: f and cy of P_rect_02, no skew")
        width, height = size
        return StereoCamera(width, height, f, -shift / f, cx_left, cx_right, cy)
    except (UnicodeDecodeError, KeyError, IndexError, ValueError, ZeroDivisionError, InputError) as error:
        raise ReadError(path, f"expected S_rect and P_rect of the cameras 02 and 03: {error!r}") from None


def _encode_not_occluded(role: str, sample: Sample) -> bytes | None:
    name, mask = _NOT_OCCLUDED[role]
    truth, visibility = getattr(sample.frame, name), getattr(sample.frame, mask)
    if truth is None or visibility is None:
        return None
    flows = name in FLOWS
    seen = visibility == VISIBLE
    encoder = FLOW_ENCODERS[sample.encodings.flow] if flows else disparity_encoder(sample.encodings.disparity)
    return encoder.encode(np.where(seen[..., None] if flows else seen, truth, np.float32(np.inf)))


_FOLDERS: Mapping[str, tuple[str, str]] = {
    "left": ("image_2", ".png"),
    "right": ("image_3", ".png"),
    "disparity_left": ("disp_occ_0", ".png"),
    "not_occluded_left": ("disp_noc_0", ".png"),
    "disparity_right": ("disp_occ_1", ".png"),
    "not_occluded_right": ("disp_noc_1", ".png"),
    _OBJECTS: ("obj_map", ".png"),
    "instances_left": ("instances_0", ".png"),
    "instances_right": ("instances_1", ".png"),
    "depth_left": ("depth_0", ".pfm"),
    "depth_right": ("depth_1", ".pfm"),
    "flow_left": ("flow_occ", ".png"),
    "flow_not_occluded_left": ("flow_noc", ".png"),
    "flow_right": ("flow_occ_right", ".png"),
    "flow_not_occluded_right": ("flow_noc_right", ".png"),
    "flow_backward_left": ("flow_backward_occ", ".png"),
    "flow_backward_not_occluded_left": ("flow_backward_noc", ".png"),
    "flow_backward_right": ("flow_backward_occ_right", ".png"),
    "flow_backward_not_occluded_right": ("flow_backward_noc_right", ".png"),
    "disparity_change_left": ("disparity_change_0", ".pfm"),
    "disparity_change_right": ("disparity_change_1", ".pfm"),
}

LAYOUT = Kitti()
