"""The folder layout of Middlebury's evaluation set (MiddEval3).

``MiddEval3/trainingF/<scene>/`` with im0.png, im1.png, disp0GT.pfm, disp1GT.pfm, mask0nocc.png, mask1nocc.png,
calib.txt, pair.json and the outputs asked for, and ``MiddEval3/official_train.txt`` with the scenes' names. Loaders
take the names from trainingF. Images and disparities in another encoding end in its name.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from math import isfinite
from pathlib import PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.encodings import Encodings
from semisynth_gl.frame import OUTSIDE, Frame
from semisynth_gl.write.calib import encode_calib
from semisynth_gl.write.encodings import DISPARITY_ENCODERS, IMAGE_ENCODERS
from semisynth_gl.write.pfm import encode_pfm
from semisynth_gl.write.png import encode_png

ROOT = PurePosixPath("MiddEval3")
SCENES = ROOT / "trainingF"
SCENE_LIST = ROOT / "official_train.txt"
DEFAULT = Encodings()
BEYOND = "disparity_beyond"
"""Key of pair.json: how many pixels of each view have a disparity that the encoding cannot say."""


def scene_name(config_name: str, index: int) -> str:
    """Name of pair ``index``: sorted by name is sorted by index up to a million pairs."""
    return f"{config_name}-{index:06d}"


def encode_scene(
    frame: Frame,
    provenance: Mapping[str, Any],
    ndisp: int,
    encodings: Encodings = DEFAULT,
) -> dict[str, bytes]:
    """Encode a pair as the files of its scene folder, by name.

    mask0nocc is 255 where both views see the point, 128 where the right one has it hidden, and 0 where it lies outside
    the right image or nothing is known; mask1nocc is the same for the right view. Names with 0 are the left view's.
    What the frame lacks is not written. Disparities that the encoding cannot say become invalid, in the masks and in
    calib.txt too; pair.json then counts them under `BEYOND`, by view.

    Raises:
        InputError: where an encoding needs what is not installed.
    """
    image, disparity = IMAGE_ENCODERS[encodings.image], DISPARITY_ENCODERS[encodings.disparity]
    if isfinite(disparity.beyond_px):
        frame, beyond = _without(frame, disparity.beyond_px)
        provenance = {**provenance, BEYOND: beyond}
    (left, right), (disparity_left, disparity_right) = encodings.image_names, encodings.disparity_names
    optional: dict[str, bytes | None] = {
        disparity_right: _if_present(disparity.encode, frame.disparity_right),
        "mask0nocc.png": _if_present(encode_png, frame.visibility_left),
        "mask1nocc.png": _if_present(encode_png, frame.visibility_right),
        "inst0.png": _if_present(encode_png, frame.instances_left),
        "inst1.png": _if_present(encode_png, frame.instances_right),
        "depth0.pfm": _if_present(encode_pfm, frame.depth_left),
        "depth1.pfm": _if_present(encode_pfm, frame.depth_right),
    }
    return {
        left: image(frame.left),
        right: image(frame.right),
        disparity_left: disparity.encode(frame.disparity_left),
        **{name: data for name, data in optional.items() if data is not None},
        "calib.txt": encode_calib(frame, ndisp),
        "pair.json": (json.dumps(provenance, indent=1) + "\n").encode(),
    }


def share_beyond(frame: Frame, encodings: Encodings) -> float:
    """Return the share of a frame's pixels whose disparity the encoding cannot say, of the view that has more."""
    limit = DISPARITY_ENCODERS[encodings.disparity].beyond_px
    if not isfinite(limit):
        return 0.0
    views = [view for view in (frame.disparity_left, frame.disparity_right) if view is not None]
    return max(float(_beyond(view, limit).mean()) for view in views)


def _without(frame: Frame, limit_px: float) -> tuple[Frame, dict[str, int]]:
    """Make disparities from a limit on invalid; return how many there are in each view."""
    changed: dict[str, NDArray[Any]] = {}
    counts: dict[str, int] = {}
    for side in ("left", "right"):
        disparity, visibility = getattr(frame, f"disparity_{side}"), getattr(frame, f"visibility_{side}")
        if disparity is None:
            continue
        beyond = _beyond(disparity, limit_px)
        counts[side] = int(beyond.sum())
        if counts[side]:
            changed[f"disparity_{side}"] = np.where(beyond, np.float32(np.inf), disparity)
            if visibility is not None:
                changed[f"visibility_{side}"] = np.where(beyond, np.uint8(OUTSIDE), visibility)
    return replace(frame, **changed), counts  # type: ignore[arg-type]


def _beyond(disparity: NDArray[np.float32], limit_px: float) -> NDArray[np.bool_]:
    beyond: NDArray[np.bool_] = np.isfinite(disparity) & (disparity >= np.float32(limit_px))
    return beyond


def _if_present(encode: Callable[[NDArray[Any]], bytes], array: NDArray[Any] | None) -> bytes | None:
    return None if array is None else encode(array)


def encode_scene_list(names: Iterable[str]) -> bytes:
    """Encode official_train.txt."""
    return "".join(f"{name}\n" for name in names).encode()
