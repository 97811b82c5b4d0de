"""WebDataset: shards are tars, whose files with one key, such as ``00000012``, are a pair; see docs/layouts.md.

Images, disparities and flow in another encoding than the default end in its name. As Hugging Face demands, the JSON has
the same keys with values of the same types in every pair; its key ``provenance`` has the whole provenance as text.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from semisynth_gl.codecs.json_object import JSON_OBJECT
from semisynth_gl.frame.channels import View
from semisynth_gl.inputs.errors import ReadError
from semisynth_gl.layouts.key import Key
from semisynth_gl.layouts.layout import Layout, scene_stems
from semisynth_gl.layouts.roles import ROLES, Role, Sample

_SIZES = ("width_px", "height_px")
_LENGTHS = ("focal_px", "baseline_m", "cx_left_px", "cx_right_px", "cy_px", "doffs_px")


class WebDataset(Layout):
    """WebDataset: its own package, Hugging Face datasets, and whatever reads tars."""

    packed = True

    def stems(self, key: Key) -> dict[str, str]:
        """Return the names of a pair's files inside the tar; loaders take the text before the first dot as the key."""
        now, flow = scene_stems({"image": "{view}", "disparity": "disp{n}", "visibility": "mask{n}"})
        names = {role: f".{name}" for role, name in (now | flow).items()} | {"provenance": ""}
        return {role: f"{key.index:08d}{name}" for role, name in names.items()}

    def role(self, name: str) -> Role:
        """Return a role; the provenance's file has an object around it, with the same keys in every pair."""
        return _FACTS if name == "provenance" else super().role(name)


def _facts(sample: Sample) -> dict[str, Any]:
    """Return the facts that every pair has, and the provenance as text: loaders lose keys that only some pairs have."""
    provenance, camera = sample.provenance, sample.frame.camera
    numbers: dict[str, Any] = {name: int(getattr(camera, name)) for name in _SIZES}
    numbers |= {name: float(getattr(camera, name)) for name in _LENGTHS}
    # Either all pairs of a dataset have these or none: a rectified twin states a deviation of zero.
    recorded = provenance.get("camera", {})
    numbers |= {key: recorded[key] for key in ("fy_over_fx", "deviation") if key in recorded}
    beyond = provenance.get(View.disparity.beyond_key, {})
    return {
        "pair": int(provenance["pair"]),
        "split": sample.key.split,
        **{name: str(provenance[name]) for name in ("config", "config_sha256", "version", "renderer", "backend")},
        **{name: int(provenance[name]) for name in ("seed", "sequence", "frame")},
        **({"view": int(provenance["view"])} if "view" in provenance else {}),
        "near_m": float(provenance["near_m"]),
        "camera": numbers,
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
