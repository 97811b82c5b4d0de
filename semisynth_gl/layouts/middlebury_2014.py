"""The folders of Middlebury's scenes of 2014; docs/layouts.md draws the tree.

Names with 0 belong to the left view. im1E and im1L are the right image one stop darker and one stop brighter.
"""

from collections.abc import Sequence

from semisynth_gl.codecs import Encodings
from semisynth_gl.layouts.key import Key
from semisynth_gl.layouts.layout import VERTICAL, Layout, scene_stems

SCENES = "2014"
TORCHVISION = "Middlebury2014/train"

_NOT_INCLUDED = (
    "Adirondack is not included. This file is here because torchvision refuses a folder without a name that begins as "
    "one of Middlebury's own scenes does.\n"
)


class Middlebury2014(Layout):
    """Middlebury 2014: RAFT-Stereo, OpenStereo, torchvision's Middlebury2014Stereo."""

    needs = frozenset({"visibility"})
    encodings = Encodings()

    def stems(self, key: Key) -> dict[str, str]:
        """Return the files of a scene's folder."""
        now, flow = scene_stems({"disparity": "disp{n}"})
        images = {"left": now["left"], "right": now["right"], "right_under": "im1E", "right_over": "im1L"}
        names = images | now | VERTICAL | {"calibration": "calib", "provenance": "pair"} | flow
        return {role: f"{SCENES}/{_scene(key)}/{name}" for role, name in names.items()}

    def lists(self, keys: Sequence[Key], encodings: Encodings) -> dict[str, bytes]:
        """Return the file without which torchvision refuses the folder."""
        del keys, encodings
        return {f"{TORCHVISION}/Adirondack-not-included.txt": _NOT_INCLUDED.encode()}

    def links(self, keys: Sequence[Key]) -> dict[str, str]:
        """Return a link for each scene where torchvision looks for it."""
        return {f"{TORCHVISION}/{_scene(key)}": f"../../{SCENES}/{_scene(key)}" for key in keys}


def _scene(key: Key) -> str:
    # torchvision selects scenes by this ending.
    return f"{key.name}-perfect"


LAYOUT = Middlebury2014()
