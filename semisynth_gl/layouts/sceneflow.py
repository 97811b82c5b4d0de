"""The folders of SceneFlow's FlyingThings3D.

Below ``SceneFlow/FlyingThings3D/``, for the pair that is frame FFFF of folder NNNN of letter A, B or C:

- ``frames_cleanpass/TRAIN/A/NNNN/left/FFFF.png`` and ``right/FFFF.png``, the images
- ``disparity/TRAIN/A/NNNN/left/FFFF.pfm`` and ``right/FFFF.pfm``; ``frames_disparity`` leads to the same folder
- what SceneFlow has not, below folders of the same form: ``visibility``, ``instances`` and ``depth``, and the
  provenance as ``pairs/TRAIN/A/NNNN/FFFF.json``
- ``optical_flow/TRAIN/A/NNNN/into_future/left/OpticalFlowIntoFuture_FFFF_L.pfm`` and
  ``right/OpticalFlowIntoFuture_FFFF_R.pfm``, flow to the next frame; ``into_past/left/OpticalFlowIntoPast_FFFF_L.pfm``
  and so on, to the previous one; ``disparity_change/TRAIN/A/NNNN/into_future/left/FFFF.pfm``; and, which SceneFlow has
  not, ``optical_flow_visibility/TRAIN/A/NNNN/into_future/left/FFFF.png``
- the folders of Monkaa and Driving, empty, since PSMNet lists them

``filenames/`` has lists of the pairs for loaders that read such. Pairs to train on are under TRAIN and those to test on
under TEST of one tree; those to validate with are under TEST of a tree of their own. Pair 0 is in A, pair 1 in B, pair
2 in C, pair 3 in A again. A folder holds up to 1000 frames, from 0000 on: loaders sort or list them, whatever their
numbers.

Loaders of flow take the images that follow each other in a folder for successive frames. So in a dataset with such an
output a folder is a sequence: sequence 0 is A/0000, sequence 1 is B/0000, and frame k of it is 000k.
"""

from collections.abc import Collection, Mapping, Sequence

from semisynth_gl.config import Config
from semisynth_gl.encodings import Encodings
from semisynth_gl.frame import FLOW_OUTPUTS
from semisynth_gl.layouts.layout import SHORT_NAMES, Key, Layout, pair_lines
from semisynth_gl.splits import SplitName

ROOT = "SceneFlow/FlyingThings3D"

_IMAGES = "frames_cleanpass"
_FLOW = "optical_flow"
_FLOW_MASKS = "optical_flow_visibility"
_LETTERS = "ABC"
_FRAMES = 1000
_PARTS: Mapping[SplitName, str] = {"train": "TRAIN", "validation": "TEST", "test": "TEST"}


class SceneFlow(Layout):
    """FlyingThings3D: RAFT-Stereo, torchvision, PSMNet, HSM; by lists CasStereo, GwcNet, MobileStereoNet, AANet."""

    encodings = Encodings(flow="pfm")
    most_frames = 10_000
    right_truth_for = "torchvision's SceneFlowStereo and HSM"

    def files(self, key: Key, encodings: Encodings) -> dict[str, str]:
        """Return a pair's files, of the same name in many folders."""
        del encodings
        place, frame = _place(key)
        return {
            role: f"{ROOT}/{tree}/{place}/{folder}/{begin}{frame}{end}"
            for role, (tree, folder, begin, end) in _TREES.items()
        } | {"provenance": f"{ROOT}/pairs/{place}/{frame}.json"}

    def lists(self, keys: Sequence[Key], encodings: Encodings) -> dict[str, bytes]:
        """Return lists of the pairs: left image, right image and left disparity, as paths below the split's folder."""
        if not keys:
            return {}
        text = pair_lines(self.files(key, encodings) for key in keys)
        name = SHORT_NAMES[keys[0].split]
        return {f"filenames/sceneflow_{name}.txt": text, f"filenames/SceneFlow_finalpass_{name}.txt": text}

    def links(self, keys: Sequence[Key]) -> dict[str, str]:
        """Return the link under which PSMNet looks for disparities."""
        del keys
        return {f"{ROOT}/frames_disparity": "disparity"}

    def folders(self) -> tuple[str, ...]:
        """Return the folders that PSMNet and HSM list though they may be empty."""
        driving = [
            f"{length}/{scene}/{speed}/left"
            for length in ("35mm_focallength", "15mm_focallength")
            for scene in ("scene_backwards", "scene_forwards")
            for speed in ("fast", "slow")
        ]
        return (
            *(f"{ROOT}/{tree}/{part}/{each}" for tree in (_IMAGES, "disparity") for part in _USED for each in _LETTERS),
            *(f"{ROOT}/monkaa_{tree}" for tree in (_IMAGES, "disparity")),
            *(f"{ROOT}/driving_{tree}/{each}" for tree in (_IMAGES, "disparity") for each in driving),
        )

    def advice(self, pairs: int, config: Config, split: SplitName = "train") -> list[str]:
        """Tell of sequences that loaders of flow find no two frames in too."""
        sentences = super().advice(pairs, config, split)
        if FLOW_OUTPUTS.intersection(config.outputs) and config.sequence.length == 1:
            sentences.append(
                "RAFT and torchvision pair flow with two images of a sequence, and here each has one alone: set "
                "sequence.length to 2 or more."
            )
        return sentences

    def folder(self, split: SplitName, splits: Collection[SplitName]) -> str:
        """Return the folder of a split: train and test share one tree."""
        return super().folder(split, splits) if split == "validation" else ""


def _place(key: Key) -> tuple[str, str]:
    """Return the folder of a pair inside each tree, and its frame's number."""
    number, letter = divmod(key.sequence, len(_LETTERS))
    folder, frame = divmod(number, _FRAMES) if key.sequence_length is None else (number, key.frame)
    return f"{_PARTS[key.split]}/{_LETTERS[letter]}/{folder:04d}", f"{frame:04d}"


_USED = ("TRAIN", "TEST")
# The tree, the folder below the pair's, and what stands around the frame's number.
_TREES: Mapping[str, tuple[str, str, str, str]] = {
    "left": (_IMAGES, "left", "", ".png"),
    "right": (_IMAGES, "right", "", ".png"),
    "disparity_left": ("disparity", "left", "", ".pfm"),
    "disparity_right": ("disparity", "right", "", ".pfm"),
    "visibility_left": ("visibility", "left", "", ".png"),
    "visibility_right": ("visibility", "right", "", ".png"),
    "instances_left": ("instances", "left", "", ".png"),
    "instances_right": ("instances", "right", "", ".png"),
    "depth_left": ("depth", "left", "", ".pfm"),
    "depth_right": ("depth", "right", "", ".pfm"),
    "flow_left": (_FLOW, "into_future/left", "OpticalFlowIntoFuture_", "_L.pfm"),
    "flow_right": (_FLOW, "into_future/right", "OpticalFlowIntoFuture_", "_R.pfm"),
    "flow_visibility_left": (_FLOW_MASKS, "into_future/left", "", ".png"),
    "flow_visibility_right": (_FLOW_MASKS, "into_future/right", "", ".png"),
    "flow_backward_left": (_FLOW, "into_past/left", "OpticalFlowIntoPast_", "_L.pfm"),
    "flow_backward_right": (_FLOW, "into_past/right", "OpticalFlowIntoPast_", "_R.pfm"),
    "flow_backward_visibility_left": (_FLOW_MASKS, "into_past/left", "", ".png"),
    "flow_backward_visibility_right": (_FLOW_MASKS, "into_past/right", "", ".png"),
    "disparity_change_left": ("disparity_change", "into_future/left", "", ".pfm"),
    "disparity_change_right": ("disparity_change", "into_future/right", "", ".pfm"),
}

LAYOUT = SceneFlow()
