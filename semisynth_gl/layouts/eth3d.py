"""The folders of ETH3D's two-view benchmark.

``two_view_training/<scene>/`` with im0.png, im1.png and calib.txt, and ``two_view_training_gt/<scene>/`` with
disp0GT.pfm, mask0nocc.png, and what ETH3D has not: disp1GT.pfm, mask1nocc.png, pair.json and the outputs asked for.
Names with 0 are the left view's. Both folders hold the same scenes, since loaders pair them by sorting. ``ETH3D/``
leads to both, for torchvision.
"""

from collections.abc import Sequence

from semisynth_gl.encodings import Encodings
from semisynth_gl.layouts.layout import Key, Layout
from semisynth_gl.layouts.middlebury import flow_files

SCENES = "two_view_training"
TRUTH = "two_view_training_gt"


class Eth3d(Layout):
    """ETH3D two-view: RAFT-Stereo, OpenStereo, torchvision's ETH3DStereo."""

    needs = frozenset({"visibility"})
    encodings = Encodings()

    def files(self, key: Key, encodings: Encodings) -> dict[str, str]:
        """Return the files of a scene's two folders."""
        names = _FILES | {role: (TRUTH, name) for role, name in flow_files(encodings).items()}
        return {role: f"{folder}/{key.scene}/{name}" for role, (folder, name) in names.items()}

    def links(self, keys: Sequence[Key]) -> dict[str, str]:
        """Return the links under which torchvision looks for the scenes."""
        del keys
        return {f"ETH3D/{folder}": f"../{folder}" for folder in (SCENES, TRUTH)}


_FILES: dict[str, tuple[str, str]] = {
    "left": (SCENES, "im0.png"),
    "right": (SCENES, "im1.png"),
    "calibration": (SCENES, "calib.txt"),
    "disparity_left": (TRUTH, "disp0GT.pfm"),
    "disparity_right": (TRUTH, "disp1GT.pfm"),
    "visibility_left": (TRUTH, "mask0nocc.png"),
    "visibility_right": (TRUTH, "mask1nocc.png"),
    "instances_left": (TRUTH, "inst0.png"),
    "instances_right": (TRUTH, "inst1.png"),
    "depth_left": (TRUTH, "depth0.pfm"),
    "depth_right": (TRUTH, "depth1.pfm"),
    "provenance": (TRUTH, "pair.json"),
}

LAYOUT = Eth3d()
