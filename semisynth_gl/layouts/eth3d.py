"""The folders of ETH3D's two-view benchmark; docs/layouts.md draws the tree.

Names with 0 belong to the left view. Both folders hold the same scenes, since loaders sort the folders and pair them by
position. ``ETH3D/`` has links to both, for torchvision.
"""

from collections.abc import Sequence

from semisynth_gl.codecs import Encodings
from semisynth_gl.layouts.key import Key
from semisynth_gl.layouts.layout import Layout, scene_stems

SCENES = "two_view_training"
TRUTH = "two_view_training_gt"


class Eth3d(Layout):
    """ETH3D two-view: RAFT-Stereo, OpenStereo, torchvision's ETH3DStereo."""

    needs = frozenset({"visibility"})
    lacks = frozenset({"correspondence"})
    encodings = Encodings()
    three_channels = True  # for RAFT-Stereo's demo; ETH3D's own grey images have three channels too

    def stems(self, key: Key) -> dict[str, str]:
        """Return the files of a scene's two folders."""
        now, flow = scene_stems({"disparity": "disp{n}GT"})
        images = {"left": now["left"], "right": now["right"], "calibration": "calib"}
        names = images | now | {"provenance": "pair"} | flow
        return {role: f"{SCENES if role in images else TRUTH}/{key.name}/{name}" for role, name in names.items()}

    def links(self, keys: Sequence[Key]) -> dict[str, str]:
        """Return the links under which torchvision looks for the scenes."""
        del keys
        return {f"ETH3D/{folder}": f"../{folder}" for folder in (SCENES, TRUTH)}


LAYOUT = Eth3d()
