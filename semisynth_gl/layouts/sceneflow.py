"""The folders of SceneFlow's FlyingThings3D; docs/layouts.md draws the tree.

Training pairs are under TRAIN and test pairs under TEST of one tree; validation pairs are under TEST of another tree.
Pair 0 is in A, pair 1 in B, pair 2 in C, pair 3 in A again. A folder holds up to 1000 frames, from 0000 on: loaders
sort or list frames, and do not use their numbers.

Loaders of flow take successive images in a folder for successive frames. So in a dataset with an output of flow, each
folder is a sequence: sequence 0 is A/0000, sequence 1 is B/0000, and frame k of a sequence is 000k.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import ClassVar

from semisynth_gl.codecs import Encodings
from semisynth_gl.codecs.pfm import FlowPfm
from semisynth_gl.layouts.key import Key
from semisynth_gl.layouts.layout import SHORT_SPLITS, Layout, pair_lines, view_stems
from semisynth_gl.seeds.splits import SplitName

ROOT = "SceneFlow/FlyingThings3D"

_IMAGES = "frames_cleanpass"
_FINAL = "frames_finalpass"
_LETTERS = "ABC"
_FRAMES = 1000
_PARTS: Mapping[SplitName, str] = {"train": "TRAIN", "validation": "TEST", "test": "TEST"}
# Paths of files by channel: the tree, the pair's folder for *, and the rest, with the frame's number for **.
_NAMES: Mapping[str, str] = {
    "image": _IMAGES + "/*/{view}/**",
    "flow": "optical_flow/*/into_future/{view}/OpticalFlowIntoFuture_**_{L}",
    "flow_visibility": "optical_flow_visibility/*/into_future/{view}/**",
    "flow_backward": "optical_flow/*/into_past/{view}/OpticalFlowIntoPast_**_{L}",
    "flow_backward_visibility": "optical_flow_visibility/*/into_past/{view}/**",
    "disparity_change": "disparity_change/*/into_future/{view}/**",
}


class SceneFlow(Layout):
    """FlyingThings3D: RAFT-Stereo, IGEV, torchvision, PSMNet, HSM; by lists CasStereo, GwcNet, OpenStereo, AANet."""

    lacks = frozenset({"correspondence"})
    encodings = Encodings(flow=FlowPfm())
    most_frames = 10_000
    copied: ClassVar = {f"{ROOT}/{_IMAGES}/": f"{ROOT}/{_FINAL}/"}

    def stems(self, key: Key) -> dict[str, str]:
        """Return a pair's files, which have the same name in many folders."""
        folder, frame = _place(key)
        names = view_stems(_NAMES, "{channel}/*/{view}/**") | {"provenance": "pairs/*/**"}
        return {role: f"{ROOT}/{name.replace('**', frame).replace('*', folder)}" for role, name in names.items()}

    def lists(self, keys: Sequence[Key], encodings: Encodings) -> dict[str, bytes]:
        """Return lists of the pairs: left image, right image and left disparity, as paths below the split's folder."""
        text = pair_lines(self.files(key, encodings) for key in keys)
        name = SHORT_SPLITS[keys[0].split]
        return {f"filenames/sceneflow_{name}.txt": text, f"filenames/SceneFlow_finalpass_{name}.txt": text}

    def links(self, keys: Sequence[Key]) -> dict[str, str]:
        """Return the links under which PSMNet looks for disparities, and RAFT-Stereo and IGEV for more images."""
        del keys
        return {f"{ROOT}/frames_disparity": "disparity", f"{ROOT}/{_FINAL}": _IMAGES}

    def folders(self) -> tuple[str, ...]:
        """Return the folders that PSMNet and HSM list, even where they are empty."""
        used = [f"{{}}/{part}/{letter}" for part in ("TRAIN", "TEST") for letter in _LETTERS]
        driving = [
            f"driving_{{}}/{length}/{scene}/{speed}/left"
            for length in ("35mm_focallength", "15mm_focallength")
            for scene in ("scene_backwards", "scene_forwards")
            for speed in ("fast", "slow")
        ]
        names = (*used, "monkaa_{}", *driving)
        return tuple(f"{ROOT}/{name.format(tree)}" for tree in (_IMAGES, "disparity") for name in names)

    def folder(self, split: SplitName, splits: Collection[SplitName]) -> str:
        """Return a split's folder: "" for train and test, which share one tree."""
        return super().folder(split, splits) if split == "validation" else ""


def _place(key: Key) -> tuple[str, str]:
    """Return a pair's folder inside each tree, and its frame's number with four digits."""
    number, letter = divmod(key.sequence, len(_LETTERS))
    folder, frame = divmod(number, _FRAMES) if key.sequence_length is None else (number, key.frame)
    return f"{_PARTS[key.split]}/{_LETTERS[letter]}/{folder:04d}", f"{frame:04d}"


LAYOUT = SceneFlow()
