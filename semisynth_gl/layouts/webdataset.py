"""WebDataset: shards are tars, and a pair is the files of one key in them, such as ``00000012``; see docs/layouts.md.

Images, disparities and flow in another encoding end in its name. The JSON has the same keys with values of the same
types in every pair, as Hugging Face demands; ``provenance`` in it is all of the provenance, as text.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from semisynth_gl.codecs.json_object import JSON_OBJECT
from semisynth_gl.frame.frame import View
from semisynth_gl.inputs.errors import ReadError
from semisynth_gl.layouts.key import Key
from semisynth_gl.layouts.layout import Layout, scene_stems
from semisynth_gl.layouts.roles import ROLES, Role, Sample

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

    def stems(self, key: Key) -> dict[str, str]:
        """Return the names of a pair's files inside the tar; no dot in the key, which ends at the first one."""
        now, flow = scene_stems({"image": "{view}", "disparity": "disp{n}", "visibility": "mask{n}"})
        names = {role: f".{name}" for role, name in (now | flow).items()} | {"provenance": ""}
        return {role: f"{key.index:08d}{name}" for role, name in names.items()}

    def role(self, name: str) -> Role:
        """Return a role; the provenance stands inside an object of the same keys for every pair."""
        return _FACTS if name == "provenance" else super().role(name)


def _facts(sample: Sample) -> dict[str, Any]:
    """Return what every pair has, and the provenance as text: a key that only some pairs had would get lost."""
    provenance, camera = sample.provenance, sample.frame.camera
    # Of all pairs of a dataset or of none: a rectified twin says that it does not deviate.
    deviation = {key: value for key, value in provenance.get("camera", {}).items() if key == "deviation"}
    beyond = provenance.get(View.disparity.beyond_key, {})
    return {
        "pair": int(provenance["pair"]),
        "split": sample.key.split,
        **{name: str(provenance[name]) for name in ("config", "config_sha256", "version", "renderer", "backend")},
        **{name: int(provenance[name]) for name in ("seed", "sequence", "frame")},
        **({"view": int(provenance["view"])} if "view" in provenance else {}),
        "near_m": float(provenance["near_m"]),
        "camera": {name: kind(getattr(camera, name)) for name, kind in _CAMERA.items()} | deviation,
        "ndisp": int(sample.ndisp),
        "redrawn": len(provenance.get("redrawn", ())),
        "beyond_left": int(beyond.get("left", 0)),
        "beyond_right": int(beyond.get("right", 0)),
        "provenance": json.dumps(provenance),
    }


def _provenance(facts: Mapping[str, Any], path: Path) -> dict[str, Any]:
    text = facts.get("provenance")
    if not isinstance(text, str):
        raise ReadError(path, f"expected the provenance as text, got {type(text).__name__}")
    return JSON_OBJECT.decode(text.encode(), path)


_FACTS = replace(ROLES["provenance"], value=_facts, unwrap=_provenance)

LAYOUT = WebDataset()
