"""The datasets that compare_sets.py compares.

A row is ``rig.yaml`` with some keys overridden, or a calibrated or packaged config at the rig's size.
"""

import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from semisynth_gl.config import Config, load_config

RIG = Path(__file__).with_name("rig.yaml")


@dataclass(frozen=True, slots=True)
class TrainingSet:
    """A row of the table.

    Attributes:
        what: its difference from the row ``clutter``.
        overrides: values of keys of ``rig.yaml``.
        of_place: whether it needs photographs of the place.
        trials: `calibrate --trials`, if `calibrate` makes the config for the rig and its disparities; else None.
        packaged: name of the packaged config whose scenes it has, scaled to the rig's width.
        own_rig: whether that config keeps its cameras, disparities and textures.
        pairs_of: name of the row whose pairs are used; empty to render new pairs.
        augment: train.py's option --augment.
    """

    what: str
    overrides: Mapping[str, Any] = field(default_factory=dict)
    of_place: bool = False
    trials: int | None = None
    packaged: str = ""
    own_rig: bool = False
    pairs_of: str = ""
    augment: str = "semisynth"


_ROOM = {"background": {"cuboid": 0, "room": 1}, "particles": {"layers": [{"disparity_px": [8, 70], "count": [2, 10]}]}}
_LARGE = {
    "structures": {"ground": 0.5, "panels": [1, 4], "panel_disparity_px": [6, 30], "panel_size_px": [70, 280]},
    "particles": {"density": "sparse", "size_px": [60, 200]},
}
SETS: Mapping[str, TrainingSet] = {
    "clutter": TrainingSet("floating models in a box"),
    "procedural": TrainingSet("painted patterns instead of photographs", {"textures.source": "procedural"}),
    "mix": TrainingSet(
        "rooms, clutter and few large models, a third each",
        {"scenes": [{"recipe": "room", **_ROOM}, {"recipe": "clutter"}, {"recipe": "large", **_LARGE}]},
    ),
    "packaged": TrainingSet("the scenes of the packaged config `middlebury`", packaged="middlebury"),
    "room": TrainingSet("furnished rooms", _ROOM),
    "calibrated": TrainingSet("what `calibrate` writes from the photographs", of_place=True, trials=6),
    "untried": TrainingSet("what `calibrate --trials 0` writes", of_place=True, trials=0),
    "zero-shot": TrainingSet(
        "the packaged config `zero-shot`: other rigs, other pictures", packaged="zero-shot", own_rig=True
    ),
    "large": TrainingSet("few large models, panels and grounds", _LARGE),
    "antialiased": TrainingSet("colours of 4 samples a pixel", {"antialias": "ssaa2"}),
    "imperfect": TrainingSet(
        "blurred lenses and noise of each eye", {"imperfections": {"blur_px": [0, 0.8], "noise": [0, 3]}}
    ),
    "unchanged": TrainingSet("`mix`, only crops", pairs_of="mix", augment="psmnet"),
    "raft-stereo": TrainingSet("`mix`, augmented as RAFT-Stereo does", pairs_of="mix", augment="raft-stereo"),
}


def config_of(name: str, images: tuple[str, ...], scratch: Path) -> Config:
    """Make the config of a row.

    Args:
        name: a key of `SETS`.
        images: photographs of the place; without them, the textures of `rig.yaml` are used.
        scratch: folder for files of `calibrate`.

    Raises:
        InputError: if the photographs cannot be used.
    """
    name = SETS[name].pairs_of or name
    row, base = SETS[name], load_config(RIG)
    textures: dict[str, Any] = {"textures.source": "images", "textures.images": list(images)} if images else {}
    if row.trials is None and not row.packaged:
        return load_config(RIG, {**textures, **row.overrides, "name": name})
    scratch.mkdir(parents=True, exist_ok=True)
    written = scratch / f"{name}.yaml"
    if row.packaged:
        scale = base.camera.width_px / load_config(row.packaged).camera.width_px
        written.write_text(f"extends: {row.packaged}\nname: {name}\nscale: {scale}\n", encoding="utf-8")
    elif not written.exists():
        size, reach = f"{base.camera.width_px}x{base.camera.height_px}", (base.disparity.min_px, base.disparity.max_px)
        command = [sys.executable, "-m", "semisynth_gl", "calibrate", "--other-camera", "--size", size]
        command += ["--focal-px", "960", "--baseline-m", "0.27", "--range-px", *map(str, reach)]
        command += ["--trials", str(row.trials), "--out", str(written)]
        subprocess.run([*command, *(word for each in images for word in ("--images", each))], check=True)
    values = base.model_dump(mode="json")
    if row.own_rig:
        return load_config(written, {key: values[key] for key in ("truth", "outputs")})
    # All rows show the disparities of the rig.
    return load_config(written, textures | {key: values[key] for key in ("camera", "disparity", "truth", "outputs")})
