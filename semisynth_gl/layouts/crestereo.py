"""The folders of CREStereo's dataset; docs/layouts.md draws the tree.

Pair 0 is in shapenet, pair 1 in reflective and so on; torchvision needs pairs in all four. CREStereo's own dataset has
only images and disparities.
"""

from collections.abc import Mapping, Sequence

from semisynth_gl.codecs import Encodings
from semisynth_gl.codecs.jpeg import Jpeg
from semisynth_gl.codecs.png16 import CRESTEREO_DISPARITY
from semisynth_gl.layouts.key import Key
from semisynth_gl.layouts.layout import Layout, view_stems

_FOLDERS = ("shapenet", "reflective", "tree", "hole")
_NAMES: Mapping[str, str] = {
    "image": "_{view}",
    "disparity": "_{view}.disp",
    "visibility": "_{view}.mask",
    "instances": "_{view}.inst",
    "flow_visibility": "_{view}.flow_mask",
    "flow_backward_visibility": "_{view}.flow_backward_mask",
}


class CreStereo(Layout):
    """CREStereo: its own loader, torchvision's CREStereo, WAFT-Stereo."""

    encodings = Encodings(image=Jpeg(), disparity=CRESTEREO_DISPARITY)
    lacks = frozenset({"correspondence"})

    def stems(self, key: Key) -> dict[str, str]:
        """Return the names of a pair's files, side by side in one of four folders."""
        begin = f"CREStereo/{_FOLDERS[key.index % len(_FOLDERS)]}/{key.index:06d}"
        names = view_stems(_NAMES, "_{view}.{channel}") | {"provenance": ""}
        return {role: f"{begin}{name}" for role, name in names.items()}

    def links(self, keys: Sequence[Key]) -> dict[str, str]:
        """Return the links under which WAFT-Stereo looks for the pairs, a folder deeper than torchvision.

        They are outside ``CREStereo``, which CREStereo's own loader walks.
        """
        folders = (_FOLDERS[number] for number in sorted({key.index % len(_FOLDERS) for key in keys}))
        return {f"WAFT-Stereo/CREStereo/{folder}/0": f"../../../CREStereo/{folder}" for folder in folders}


LAYOUT = CreStereo()
