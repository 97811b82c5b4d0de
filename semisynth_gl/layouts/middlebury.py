"""The folders of Middlebury's evaluation set (MiddEval3), full size.

``MiddEval3/trainingF/<scene>/`` with im0.png, im1.png, disp0GT.pfm, disp1GT.pfm, mask0nocc.png, mask1nocc.png,
calib.txt, pair.json and the outputs asked for, and ``MiddEval3/official_train.txt`` with the scenes' names. Images,
disparities and flow in another encoding end in its name. Names with 0 are the left view's. ``carla-highres/trainingF``
leads to the same scenes.
"""

from collections.abc import Sequence

from semisynth_gl.config import Config
from semisynth_gl.encodings import Encodings
from semisynth_gl.layouts.layout import Key, Layout
from semisynth_gl.splits import SplitName

SCENES = "MiddEval3/trainingF"
SCENE_LIST = "MiddEval3/official_train.txt"

# Half and quarter size are exact then.
_SIZE_STEP = 4


class Middlebury(Layout):
    """MiddEval3: RAFT-Stereo, HSM, torchvision's CarlaStereo, the evaluation kit."""

    right_truth_for = "HSM and torchvision's CarlaStereo"

    def files(self, key: Key, encodings: Encodings) -> dict[str, str]:
        """Return the files of a scene's folder."""
        folder = f"{SCENES}/{key.scene}"
        return {role: f"{folder}/{name}" for role, name in scene_files(encodings).items()}

    def lists(self, keys: Sequence[Key], encodings: Encodings) -> dict[str, bytes]:
        """Return official_train.txt: the scenes' names, a line each."""
        del encodings
        return {SCENE_LIST: "".join(f"{key.scene}\n" for key in keys).encode()}

    def links(self, keys: Sequence[Key]) -> dict[str, str]:
        """Return the link under which torchvision's CarlaStereo looks for the scenes."""
        del keys
        return {"carla-highres/trainingF": f"../{SCENES}"}

    def advice(self, pairs: int, config: Config, split: SplitName = "train") -> list[str]:
        """Tell of sizes that cannot be halved twice too."""
        size = config.camera.width_px, config.camera.height_px
        sentences = super().advice(pairs, config, split)
        if any(length % _SIZE_STEP for length in size):
            sentences.append(
                f"Sizes in MiddEval3 are multiples of {_SIZE_STEP}, so that its H and Q are exactly half and quarter, "
                f"but images are {size[0]} x {size[1]}: change camera.width_px or camera.height_px."
            )
        return sentences


def scene_files(encodings: Encodings) -> dict[str, str]:
    """Return the names of files inside a scene's folder, by role."""
    (left, right), (disparity_left, disparity_right) = encodings.image_names, encodings.disparity_names
    return {
        "left": left,
        "right": right,
        "disparity_left": disparity_left,
        "disparity_right": disparity_right,
        "visibility_left": "mask0nocc.png",
        "visibility_right": "mask1nocc.png",
        "instances_left": "inst0.png",
        "instances_right": "inst1.png",
        "depth_left": "depth0.pfm",
        "depth_right": "depth1.pfm",
        **flow_files(encodings),
        "calibration": "calib.txt",
        "provenance": "pair.json",
    }


def flow_files(encodings: Encodings) -> dict[str, str]:
    """Return the names of files of flow in any layout that calls the left view 0 and the right one 1, by role."""
    return {
        f"{role}_{side}": name
        for side, view in (("left", 0), ("right", 1))
        for role, name in {
            "flow": f"flow{view}{encodings.flow_suffix}",
            "flow_visibility": f"flow_mask{view}.png",
            "flow_backward": f"flow_backward{view}{encodings.flow_suffix}",
            "flow_backward_visibility": f"flow_backward_mask{view}.png",
            "disparity_change": f"disparity_change{view}.pfm",
        }.items()
    }


LAYOUT = Middlebury()
