"""The folders of KITTI 2015, of which there is ``training`` alone.

``training/`` holds, for pair NNNNNN:

- ``image_2/NNNNNN_10.png`` and ``image_3/NNNNNN_10.png``, the left and the right image
- ``disp_occ_0/NNNNNN_10.png``, the left view's disparity, and ``disp_noc_0/``, the same where the right view sees the
  point too; ``disp_occ_1/`` and ``disp_noc_1/`` are the right view's
- ``obj_map/NNNNNN_10.png``, 0 in the background and 1 to 255 elsewhere, of the left view
- ``calib_cam_to_cam/NNNNNN.txt``
- what no loader of KITTI looks for: ``instances_0/``, ``instances_1/``, ``depth_0/`` and ``depth_1/``

``pairs/NNNNNN.json`` is the provenance, ``filenames/KITTI_2015_train.txt`` a list for loaders that read such, and
``Kitti2015/training`` leads to the same files, for torchvision. Masks have no file: they follow from the disparities,
see `visibility_of`.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.camera import StereoCamera
from semisynth_gl.config import Config
from semisynth_gl.encodings import Encodings
from semisynth_gl.errors import InputError
from semisynth_gl.frame import OCCLUDED, OUTSIDE, VISIBLE, Frame, Output
from semisynth_gl.layouts.layout import SHORT_NAMES, Key, Layout, Sample, pair_lines
from semisynth_gl.read.encodings import disparity_decoder
from semisynth_gl.read.error import ReadError
from semisynth_gl.read.png import decode_grey
from semisynth_gl.read.stored import StoredFrame
from semisynth_gl.scene.background import FACE
from semisynth_gl.splits import SplitName
from semisynth_gl.write.encodings import disparity_encoder
from semisynth_gl.write.png import encode_png

View = Literal["left", "right"]

_NOT_OCCLUDED: Mapping[str, View] = {"not_occluded_left": "left", "not_occluded_right": "right"}
_OBJECTS = "objects"
_CALIBRATION = "calib_cam_to_cam"
_LARGEST_OBJECT = 255

# HSM's, the evaluation kit's and every repository's own lists count on that many.
_FEWEST = 200
_PSMNET_SIZE = 1232, 368
_PADDED_SIZE = 1248, 384


class Kitti(Layout):
    """KITTI 2015: RAFT-Stereo, PSMNet, HSM, GwcNet, CasStereo, MobileStereoNet, AANet, OpenStereo, torchvision."""

    needs = frozenset({"visibility", "instances"})
    encodings = Encodings(disparity="png16")
    right_truth_for = "torchvision's Kitti2015Stereo and OpenStereo"

    def files(self, key: Key, encodings: Encodings) -> dict[str, str]:
        """Return a pair's files, of the same name in many folders."""
        del encodings
        number = f"{key.index:06d}"
        return {role: f"training/{folder}/{number}_10{ending}" for role, (folder, ending) in _FOLDERS.items()} | {
            _CALIBRATION: f"training/{_CALIBRATION}/{number}.txt",
            "provenance": f"pairs/{number}.json",
        }

    def output_of(self, role: str) -> Output | None:
        """Return the output without which a role has no file."""
        if role in _NOT_OCCLUDED:
            return "visibility"
        return "instances" if role == _OBJECTS else super().output_of(role)

    def is_of_right_truth(self, role: str) -> bool:
        """Whether a role has no file where truth is of the left view alone."""
        return _NOT_OCCLUDED.get(role) == "right" or super().is_of_right_truth(role)

    def encode_file(self, role: str, sample: Sample) -> bytes | None:
        """Return what a role's file holds; None where the frame lacks it."""
        if role in _NOT_OCCLUDED:
            seen = _not_occluded(sample.frame, _NOT_OCCLUDED[role])
            return None if seen is None else disparity_encoder(sample.encodings.disparity).encode(seen)
        if role == _OBJECTS:
            ids = sample.frame.instances_left
            return None if ids is None else encode_png(objects_of(ids, sample.provenance["instances"]))
        if role == _CALIBRATION:
            return encode_calibration(sample.frame.camera)
        return super().encode_file(role, sample)

    def decode_file(self, role: str, data: bytes, path: Path, encodings: Encodings) -> Any:  # noqa: ANN401 - by role
        """Return what a role's file says; see `Layout.decode_file`."""
        if role in _NOT_OCCLUDED:
            return disparity_decoder(encodings.disparity).decode(data, path)
        if role == _OBJECTS:
            return decode_grey(data, path)
        if role == _CALIBRATION:
            return decode_calibration(data, path)
        return super().decode_file(role, data, path, encodings)

    def assemble(self, key: Key, values: Mapping[str, Any], encodings: Encodings) -> StoredFrame:
        """Make a frame of what the files say, with the masks that follow from them.

        Raises:
            ReadError: where the disparities of points that both views see are not among those of all points.
        """
        masks = {
            f"visibility_{view}": visibility_of(values[f"disparity_{view}"], values[role], view, Path(key.scene))
            for role, view in _NOT_OCCLUDED.items()
            if role in values and f"disparity_{view}" in values
        }
        return super().assemble(key, {**values, **masks}, encodings)

    def lists(self, keys: Sequence[Key], encodings: Encodings) -> dict[str, bytes]:
        """Return a list of the pairs: left image, right image and left disparity, as paths below the split's folder."""
        if not keys:
            return {}
        text = pair_lines(self.files(key, encodings) for key in keys)
        return {f"filenames/KITTI_2015_{SHORT_NAMES[keys[0].split]}.txt": text}

    def links(self, keys: Sequence[Key]) -> dict[str, str]:
        """Return the link under which torchvision looks for the pairs."""
        del keys
        return {"Kitti2015/training": "../training"}

    def advice(self, pairs: int, config: Config, split: SplitName = "train") -> list[str]:
        """Tell of too few pairs, of sizes that loaders cannot crop or pad to theirs, and of other splits too."""
        sentences = super().advice(pairs, config, split)
        width, height = config.camera.width_px, config.camera.height_px
        if pairs < _FEWEST:
            sentences.append(
                f"KITTI 2015 has {_FEWEST} pairs, here are {pairs}: HSM, the evaluation kit and the lists that "
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
    if disparity.shape != not_occluded.shape:
        raise ReadError(path, f"disp_occ of the {view} view has shape {disparity.shape}, disp_noc {not_occluded.shape}")
    seen = np.isfinite(not_occluded)
    wrong = int((seen & (disparity != not_occluded)).sum())
    if wrong:
        raise ReadError(path, f"{wrong} disparities in disp_noc of the {view} view are not those in disp_occ")
    width = disparity.shape[1]
    column = np.arange(width) + (-disparity if view == "left" else disparity).astype(np.float64)
    outside = (column < -0.5) | (column >= width - 0.5)
    hidden = np.where(outside, OUTSIDE, OCCLUDED)
    return np.where(seen, VISIBLE, np.where(np.isfinite(disparity), hidden, OUTSIDE)).astype(np.uint8)


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


def _not_occluded(frame: Frame, view: View) -> NDArray[np.float32] | None:
    disparity = frame.disparity_left if view == "left" else frame.disparity_right
    visibility = frame.visibility_left if view == "left" else frame.visibility_right
    if disparity is None or visibility is None:
        return None
    return np.where(visibility == VISIBLE, disparity, np.float32(np.inf))


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
}

LAYOUT = Kitti()
