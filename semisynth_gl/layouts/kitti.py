"""The folders of KITTI 2015, with ``training`` only; docs/layouts.md draws the tree.

Masks have no file: they follow from disparities and flow, see `semisynth_gl.layouts.roles.mask_from_not_occluded`.
KITTI itself lacks the folders ``pairs``, of provenances, and ``filenames``, of lists for loaders that read lists.

In a dataset with an output of flow, the number in a name is the sequence's, and each frame has all files. Loaders look
for the first frame's calibration under the sequence's number without the frame's.
"""

from collections.abc import Mapping, Sequence

from semisynth_gl.codecs import Encodings
from semisynth_gl.codecs.png16 import KITTI_DISPARITY, FlowPng16
from semisynth_gl.layouts.key import Key
from semisynth_gl.layouts.layout import SHORT_SPLITS, Layout, pair_lines, view_stems

# Number of the first frame of a scene: KITTI numbers frames with two digits from here on.
_FIRST_FRAME = 10

# Folders that are not named by their channel, in the order in which a pair's files are listed.
_FOLDERS: Mapping[str, str] = {
    "left": "image_2",
    "right": "image_3",
    "disparity_left": "disp_occ_0",
    "not_occluded_left": "disp_noc_0",
    "disparity_right": "disp_occ_1",
    "not_occluded_right": "disp_noc_1",
    "objects": "obj_map",
    "instances_left": "instances_0",
    "instances_right": "instances_1",
    "depth_left": "depth_0",
    "depth_right": "depth_1",
    "flow_left": "flow_occ",
    "flow_not_occluded_left": "flow_noc",
    "flow_right": "flow_occ_right",
    "flow_not_occluded_right": "flow_noc_right",
    "flow_backward_left": "flow_backward_occ",
    "flow_backward_not_occluded_left": "flow_backward_noc",
    "flow_backward_right": "flow_backward_occ_right",
    "flow_backward_not_occluded_right": "flow_backward_noc_right",
}


class Kitti(Layout):
    """KITTI 2015: RAFT-Stereo, PSMNet, HSM, GwcNet, CasStereo, MobileStereoNet, AANet, OpenStereo, torchvision."""

    needs = frozenset({"visibility", "instances"})
    lacks = frozenset({"correspondence"})
    encodings = Encodings(disparity=KITTI_DISPARITY, flow=FlowPng16())
    most_frames = 100 - _FIRST_FRAME

    def stems(self, key: Key) -> dict[str, str]:
        """Return a pair's files, which have the same name in many folders."""
        number = f"{key.sequence:06d}"
        name = f"{number}_{_FIRST_FRAME + key.frame}"
        # Masks have no separate file.
        views = {role: stem for role, stem in view_stems({}, "{channel}_{n}").items() if "visibility" not in role}
        folders = {**_FOLDERS} | {role: folder for role, folder in views.items() if role not in _FOLDERS}
        return {role: f"training/{folder}/{name}" for role, folder in folders.items()} | {
            "calib_cam_to_cam": f"training/calib_cam_to_cam/{name if key.frame else number}",
            "provenance": f"pairs/{number if key.sequence_length is None else name}",
        }

    def lists(self, keys: Sequence[Key], encodings: Encodings) -> dict[str, bytes]:
        """Return a list of the pairs: left image, right image and left disparity, as paths below the split's folder."""
        text = pair_lines(self.files(key, encodings) for key in keys)
        return {f"filenames/KITTI_2015_{SHORT_SPLITS[keys[0].split]}.txt": text}

    def links(self, keys: Sequence[Key]) -> dict[str, str]:
        """Return the links under which torchvision looks for the pairs."""
        flow = {"KittiFlow/training": "../training"} if any(key.sequence_length for key in keys) else {}
        return {"Kitti2015/training": "../training"} | flow


LAYOUT = Kitti()
