"""The folders of Middlebury's evaluation set (MiddEval3); docs/layouts.md draws the tree.

Names with 0 belong to the left view. Images, disparities and flow in another encoding than the default end in its name.
"""

from collections.abc import Sequence

from semisynth_gl.codecs import Encodings
from semisynth_gl.layouts.key import Key
from semisynth_gl.layouts.layout import VERTICAL, Layout, scene_stems

SCENES = "MiddEval3/trainingF"
_OTHER_SIZES = ("trainingH", "trainingQ")
SCENE_LIST = "MiddEval3/official_train.txt"


class Middlebury(Layout):
    """MiddEval3: RAFT-Stereo, IGEV, HSM, torchvision's CarlaStereo, the evaluation kit."""

    three_channels = True  # for RAFT-Stereo's demo and HSM's submission

    def stems(self, key: Key) -> dict[str, str]:
        """Return the files of a scene's folder."""
        now, flow = scene_stems({"disparity": "disp{n}GT"})
        names = now | VERTICAL | flow | {"calibration": "calib", "provenance": "pair"}
        return {role: f"{SCENES}/{key.name}/{name}" for role, name in names.items()}

    def lists(self, keys: Sequence[Key], encodings: Encodings) -> dict[str, bytes]:
        """Return official_train.txt, which has a line for each scene's name."""
        del encodings
        return {SCENE_LIST: "".join(f"{key.name}\n" for key in keys).encode()}

    def links(self, keys: Sequence[Key]) -> dict[str, str]:
        """Return the links to the scenes: torchvision's CarlaStereo, and MiddEval3's other sizes.

        Loaders of half or quarter size list the scenes in one folder and may read them in another.
        """
        del keys
        sizes = {f"MiddEval3/{size}": "trainingF" for size in _OTHER_SIZES}
        return {"carla-highres/trainingF": f"../{SCENES}"} | sizes


LAYOUT = Middlebury()
