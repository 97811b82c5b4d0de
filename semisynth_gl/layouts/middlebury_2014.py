"""The folders of Middlebury's scenes of 2014.

``2014/<scene>-perfect/`` with im0.png, im1.png, im1E.png, im1L.png, disp0.pfm, disp1.pfm, mask0nocc.png,
mask1nocc.png, calib.txt, pair.json and the outputs asked for. Names with 0 are the left view's. im1E and im1L are the
right image a stop darker and a stop brighter. ``Middlebury2014/train/`` leads to the same scenes, for torchvision.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.encodings import Encodings
from semisynth_gl.layouts.layout import Key, Layout, Sample
from semisynth_gl.layouts.middlebury import flow_files
from semisynth_gl.read.png import decode_rgb
from semisynth_gl.write.png import encode_png

SCENES = "2014"
TORCHVISION = "Middlebury2014/train"

_NOT_INCLUDED = (
    "Adirondack is not included. This file is here because torchvision refuses a folder without a name that begins as "
    "one of Middlebury's own scenes does.\n"
)
_STOPS: Mapping[str, int] = {"right_under": -1, "right_over": 1}


class Middlebury2014(Layout):
    """Middlebury 2014: RAFT-Stereo, OpenStereo, torchvision's Middlebury2014Stereo."""

    needs = frozenset({"visibility"})
    encodings = Encodings()
    right_truth_for = "torchvision's Middlebury2014Stereo and OpenStereo"

    def files(self, key: Key, encodings: Encodings) -> dict[str, str]:
        """Return the files of a scene's folder."""
        names = _FILES | flow_files(encodings)
        return {role: f"{SCENES}/{_scene(key)}/{name}" for role, name in names.items()}

    def encode_file(self, role: str, sample: Sample) -> bytes | None:
        """Return what a role's file holds; the right image at other exposures too."""
        if role in _STOPS:
            return encode_png(expose(sample.frame.right, _STOPS[role]))
        return super().encode_file(role, sample)

    def decode_file(self, role: str, data: bytes, path: Path, encodings: Encodings) -> Any:  # noqa: ANN401 - by role
        """Return what a role's file says; see `Layout.decode_file`."""
        return decode_rgb(data, path) if role in _STOPS else super().decode_file(role, data, path, encodings)

    def lists(self, keys: Sequence[Key], encodings: Encodings) -> dict[str, bytes]:
        """Return the file without which torchvision refuses the folder."""
        del keys, encodings
        return {f"{TORCHVISION}/Adirondack-not-included.txt": _NOT_INCLUDED.encode()}

    def links(self, keys: Sequence[Key]) -> dict[str, str]:
        """Return a link for each scene where torchvision looks for it."""
        return {f"{TORCHVISION}/{_scene(key)}": f"../../{SCENES}/{_scene(key)}" for key in keys}


def expose(image: NDArray[np.uint8], stops: float) -> NDArray[np.uint8]:
    """Multiply 8-bit values, of any shape, by 2 to the power of stops, as `semisynth_gl.pairs.imperfections` does."""
    levels = np.rint(np.clip(np.arange(256, dtype=np.float32) * np.float32(2.0**stops), 0, 255)).astype(np.uint8)
    exposed: NDArray[np.uint8] = levels[image]
    return exposed


def _scene(key: Key) -> str:
    # torchvision takes scenes by this ending.
    return f"{key.scene}-perfect"


_FILES: dict[str, str] = {
    "left": "im0.png",
    "right": "im1.png",
    "right_under": "im1E.png",
    "right_over": "im1L.png",
    "disparity_left": "disp0.pfm",
    "disparity_right": "disp1.pfm",
    "visibility_left": "mask0nocc.png",
    "visibility_right": "mask1nocc.png",
    "instances_left": "inst0.png",
    "instances_right": "inst1.png",
    "depth_left": "depth0.pfm",
    "depth_right": "depth1.pfm",
    "calibration": "calib.txt",
    "provenance": "pair.json",
}

LAYOUT = Middlebury2014()
