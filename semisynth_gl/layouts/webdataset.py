"""WebDataset: shards are tars, and a pair is the files of one key that stand together in them.

Pair 12 is ``00000012.left.png``, ``.right.png``, ``.disp0.pfm``, ``.disp1.pfm``, the outputs asked for (``.mask0.png``,
``.inst0.png``, ``.depth0.pfm``, ``.flow0.flo``, ``.flow_mask0.png``, ``.flow_backward0.flo``,
``.flow_backward_mask0.png``, ``.disparity_change0.pfm``, and the right view's with 1) and ``.json``. Images,
disparities and flow in another encoding end in its name. The JSON has the same keys with values of the same types in
every pair, as Hugging Face demands; ``provenance`` in it is all of the provenance, as text.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from semisynth_gl.encodings import Encodings
from semisynth_gl.layouts.layout import BEYOND, Key, Layout, Sample, encode_json
from semisynth_gl.layouts.middlebury import flow_files
from semisynth_gl.read.error import ReadError
from semisynth_gl.read.json import decode_json

_CAMERA: Mapping[str, type[int] | type[float]] = {
    "width_px": int,
    "height_px": int,
    "focal_px": float,
    "baseline_m": float,
    "cx_left_px": float,
    "cx_right_px": float,
    "cy_px": float,
    "doffs_px": float,
}


class WebDataset(Layout):
    """WebDataset: its own package, Hugging Face datasets, and whatever reads tars."""

    packed = True

    def files(self, key: Key, encodings: Encodings) -> dict[str, str]:
        """Return the names of a pair's files inside the tar; no dot in the key, which ends at the first one."""
        endings = {
            "left": f"left{encodings.image_suffix}",
            "right": f"right{encodings.image_suffix}",
            "disparity_left": f"disp0{encodings.disparity_suffix}",
            "disparity_right": f"disp1{encodings.disparity_suffix}",
            "visibility_left": "mask0.png",
            "visibility_right": "mask1.png",
            "instances_left": "inst0.png",
            "instances_right": "inst1.png",
            "depth_left": "depth0.pfm",
            "depth_right": "depth1.pfm",
            **flow_files(encodings),
            "provenance": "json",
        }
        return {role: f"{key.index:08d}.{ending}" for role, ending in endings.items()}

    def encode_file(self, role: str, sample: Sample) -> bytes | None:
        """Return what a role's file holds; None where the frame lacks it."""
        return encode_json(_facts(sample)) if role == "provenance" else super().encode_file(role, sample)

    def decode_file(self, role: str, data: bytes, path: Path, encodings: Encodings) -> Any:  # noqa: ANN401 - by role
        """Return what a role's file says; of the JSON, the provenance.

        Raises:
            ReadError: where it is cut off, or not what its role says.
        """
        if role != "provenance":
            return super().decode_file(role, data, path, encodings)
        text = decode_json(data, path).get("provenance")
        if not isinstance(text, str):
            raise ReadError(path, f"expected the provenance as text, got {type(text).__name__}")
        return decode_json(text.encode(), path)


def _facts(sample: Sample) -> dict[str, Any]:
    """Return what every pair has, and the provenance as text: a key that only some pairs had would get lost."""
    made, camera = sample.provenance, sample.frame.camera
    beyond = made.get(BEYOND, {})
    return {
        "pair": int(made["pair"]),
        "split": sample.key.split,
        **{name: str(made[name]) for name in ("config", "config_sha256", "version", "renderer", "backend")},
        **{name: int(made[name]) for name in ("seed", "sequence", "frame")},
        "near_m": float(made["near_m"]),
        "camera": {name: kind(getattr(camera, name)) for name, kind in _CAMERA.items()},
        "ndisp": int(sample.ndisp),
        "redrawn": len(made.get("redrawn", ())),
        "beyond_left": int(beyond.get("left", 0)),
        "beyond_right": int(beyond.get("right", 0)),
        "provenance": json.dumps(made),
    }


LAYOUT = WebDataset()
