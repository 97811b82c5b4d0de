"""The folder layout of Middlebury's evaluation set (MiddEval3).

``MiddEval3/trainingF/<scene>/`` with im0.png, im1.png, disp0GT.pfm, disp1GT.pfm, mask0nocc.png, mask1nocc.png,
calib.txt, pair.json and the outputs asked for, and ``MiddEval3/official_train.txt`` with the scenes' names. Loaders
take the names from trainingF.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import PurePosixPath
from typing import Any

from numpy.typing import NDArray

from semisynth_gl.frame import Frame
from semisynth_gl.write.calib import encode_calib
from semisynth_gl.write.pfm import encode_pfm
from semisynth_gl.write.png import encode_png

ROOT = PurePosixPath("MiddEval3")
SCENES = ROOT / "trainingF"
SCENE_LIST = ROOT / "official_train.txt"


def scene_name(config_name: str, index: int) -> str:
    """Name of pair ``index``: sorted by name is sorted by index up to a million pairs."""
    return f"{config_name}-{index:06d}"


def encode_scene(frame: Frame, provenance: Mapping[str, Any], ndisp: int) -> dict[str, bytes]:
    """Encode a pair as the files of its scene folder, by name.

    mask0nocc is 255 where both views see the point, 128 where the right one has it hidden, and 0 where it lies outside
    the right image or nothing is known; mask1nocc is the same for the right view. Names with 0 are the left view's.
    What the frame lacks is not written.
    """
    optional: dict[str, bytes | None] = {
        "disp1GT.pfm": _if_present(encode_pfm, frame.disparity_right),
        "mask0nocc.png": _if_present(encode_png, frame.visibility_left),
        "mask1nocc.png": _if_present(encode_png, frame.visibility_right),
        "inst0.png": _if_present(encode_png, frame.instances_left),
        "inst1.png": _if_present(encode_png, frame.instances_right),
        "depth0.pfm": _if_present(encode_pfm, frame.depth_left),
        "depth1.pfm": _if_present(encode_pfm, frame.depth_right),
    }
    return {
        "im0.png": encode_png(frame.left),
        "im1.png": encode_png(frame.right),
        "disp0GT.pfm": encode_pfm(frame.disparity_left),
        **{name: data for name, data in optional.items() if data is not None},
        "calib.txt": encode_calib(frame, ndisp),
        "pair.json": (json.dumps(provenance, indent=1) + "\n").encode(),
    }


def _if_present(encode: Callable[[NDArray[Any]], bytes], array: NDArray[Any] | None) -> bytes | None:
    return None if array is None else encode(array)


def encode_scene_list(names: Iterable[str]) -> bytes:
    """Encode official_train.txt."""
    return "".join(f"{name}\n" for name in names).encode()
