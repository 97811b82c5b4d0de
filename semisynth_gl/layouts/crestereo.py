"""The folders of CREStereo's dataset.

``CREStereo/{shapenet,reflective,tree,hole}/NNNNNN_left.jpg``, ``NNNNNN_right.jpg`` and the disparities
``NNNNNN_left.disp.png`` and ``NNNNNN_right.disp.png``, 16-bit, 1/32 px, 0 where there is none. Beside them, what
CREStereo has not: ``NNNNNN_left.mask.png``, ``NNNNNN_left.inst.png``, ``NNNNNN_left.depth.pfm``,
``NNNNNN_left.flow.flo`` and ``NNNNNN_left.flow_mask.png``, ``NNNNNN_left.flow_backward.flo`` and
``NNNNNN_left.flow_backward_mask.png``, ``NNNNNN_left.disparity_change.pfm``, the same of the right view, and
``NNNNNN.json``. Pair 0 is in shapenet, pair 1 in reflective and so on; torchvision wants all four filled.
"""

from collections.abc import Mapping

from semisynth_gl.config import Config
from semisynth_gl.encodings import Encodings
from semisynth_gl.layouts.layout import Key, Layout
from semisynth_gl.splits import SplitName

_FOLDERS = ("shapenet", "reflective", "tree", "hole")


class CreStereo(Layout):
    """CREStereo: its own loader, torchvision's CREStereo."""

    encodings = Encodings("jpg", "png16-32")
    exact_images = False
    right_truth_for = "CREStereo and torchvision's loader for it"

    def files(self, key: Key, encodings: Encodings) -> dict[str, str]:
        """Return a pair's files, side by side."""
        del encodings
        begin = f"CREStereo/{_FOLDERS[key.index % len(_FOLDERS)]}/{key.index:06d}"
        return {role: f"{begin}{ending}" for role, ending in _ENDINGS.items()}

    def advice(self, pairs: int, config: Config, split: SplitName = "train") -> list[str]:
        """Tell of too few pairs too."""
        sentences = super().advice(pairs, config, split)
        if pairs < len(_FOLDERS):
            sentences.append(
                f"torchvision wants a pair in each of {', '.join(_FOLDERS)}: make {len(_FOLDERS)} or more."
            )
        return sentences


_ENDINGS: Mapping[str, str] = {
    "left": "_left.jpg",
    "right": "_right.jpg",
    "disparity_left": "_left.disp.png",
    "disparity_right": "_right.disp.png",
    "visibility_left": "_left.mask.png",
    "visibility_right": "_right.mask.png",
    "instances_left": "_left.inst.png",
    "instances_right": "_right.inst.png",
    "depth_left": "_left.depth.pfm",
    "depth_right": "_right.depth.pfm",
    "flow_left": "_left.flow.flo",
    "flow_right": "_right.flow.flo",
    "flow_visibility_left": "_left.flow_mask.png",
    "flow_visibility_right": "_right.flow_mask.png",
    "flow_backward_left": "_left.flow_backward.flo",
    "flow_backward_right": "_right.flow_backward.flo",
    "flow_backward_visibility_left": "_left.flow_backward_mask.png",
    "flow_backward_visibility_right": "_right.flow_backward_mask.png",
    "disparity_change_left": "_left.disparity_change.pfm",
    "disparity_change_right": "_right.disparity_change.pfm",
    "provenance": ".json",
}

LAYOUT = CreStereo()
