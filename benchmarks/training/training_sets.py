"""The datasets that the benchmark compares, each with the question that it answers.

A row is ``rig.yaml`` with some keys overridden, or a written or packaged config at the rig's size. Add a row to ask
another question.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from semisynth_gl.augmentation import PRESETS, Augmentation
from semisynth_gl.calibration.disparity_range import disparity_range
from semisynth_gl.calibration.draft import describe
from semisynth_gl.calibration.rig import Rig
from semisynth_gl.calibration.trial import fit
from semisynth_gl.calibration.write import write
from semisynth_gl.config import Config, load_config
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.judge.comparison import measure_place
from semisynth_gl.judge.measured_view import working_width
from semisynth_gl.listener import Listener
from semisynth_gl.textures.image_files import find_images

RIG = Path(__file__).with_name("rig.yaml")
COLOURS = PRESETS["semisynth"]
"""Of every row that does not say otherwise."""
# Lengths in px, of pairs that are shrunk to half their size.
_RAFT = replace(PRESETS["raft-stereo"], right_y_px=(-1, 1), rectangle_px=(25, 50))
_SCALED = replace(COLOURS, scale=_RAFT.scale, stretch=_RAFT.stretch)
_MOVED = replace(_SCALED, right_y_px=(-1, 1), occluded=0.5, rectangle_px=_RAFT.rectangle_px)
REAL = "real"
"""The row of the judged pairs themselves, a mark for the range: no pairs made for them teach more."""


@dataclass(frozen=True, slots=True)
class TrainingSet:
    """A row of the table.

    Attributes:
        what: it differs in from the row ``clutter``.
        overrides: of the keys of ``rig.yaml``.
        of_place: whether it needs photographs of the place.
        trials: of the `calibrate` that writes the config, for the same rig and disparities; None where it does not.
        share: of the pairs that the other sets have.
        packaged: name of the packaged config whose scenes it has, scaled to the rig's width.
        own_rig: whether that config keeps its own cameras, disparities and pictures.
        pairs_of: another row, whose pairs are used instead of new ones; empty for none.
        augmentation: changes of its crops.
    """

    what: str
    overrides: Mapping[str, Any] = field(default_factory=dict)
    of_place: bool = False
    trials: int | None = None
    share: float = 1.0
    packaged: str = ""
    own_rig: bool = False
    pairs_of: str = ""
    augmentation: Augmentation = COLOURS


_ROOM = {"background": {"cuboid": 0, "room": 1}, "particles": {"layers": [{"disparity_px": [8, 70], "count": [2, 10]}]}}
_CROWDED = _ROOM | {"particles": {"layers": [{"disparity_px": [20, 74], "count": [12, 40]}]}}
_LARGE = {
    "structures": {"ground": 0.5, "panels": [1, 4], "panel_disparity_px": [6, 30], "panel_size_px": [70, 280]},
    "particles": {"density": "sparse", "size_px": [60, 200]},
}
# In the order of the questions: what time does not allow is left out from the end.
SETS: Mapping[str, TrainingSet] = {
    "clutter": TrainingSet("floating models in a box"),
    "procedural": TrainingSet("drawn patterns instead of photographs", {"textures.source": "procedural"}),
    "mix": TrainingSet(
        "rooms, clutter and few large models, a third each",
        {"scenes": [{"recipe": "room", **_ROOM}, {"recipe": "clutter"}, {"recipe": "large", **_LARGE}]},
    ),
    "halves": TrainingSet(
        "clutter, and few large models with panels and grounds, half each",
        {"scenes": [{"recipe": "clutter"}, {"recipe": "large", **_LARGE}]},
    ),
    "crowded": TrainingSet(
        "the mix, with 12 to 40 floating models in the rooms",
        {"scenes": [{"recipe": "room", **_CROWDED}, {"recipe": "clutter"}, {"recipe": "large", **_LARGE}]},
    ),
    "packaged": TrainingSet("the scenes of the packaged config `middlebury`", packaged="middlebury"),
    "room": TrainingSet("furnished rooms", _ROOM),
    "calibrated": TrainingSet("what `calibrate` writes from the photographs", of_place=True, trials=6),
    "zero-shot": TrainingSet(
        "the packaged config `zero-shot`: other rigs, other pictures", packaged="zero-shot", own_rig=True
    ),
    "large": TrainingSet("few large models, panels and grounds", _LARGE),
    "photographs": TrainingSet("photographs of other things", {"textures.source": "photographs"}, of_place=True),
    "builtin": TrainingSet(
        "drawn pictures and photographs of other things", {"textures.source": "builtin"}, of_place=True
    ),
    "sparse": TrainingSet("a third as many models, larger", {"particles.density": "sparse"}),
    "dense": TrainingSet("three times as many models, smaller", {"particles.density": "dense"}),
    "antialiased": TrainingSet("colours of 4 samples a pixel", {"antialias": "ssaa2"}),
    "imperfect": TrainingSet(
        "blurred lenses and noise of each eye", {"imperfections": {"blur_px": [0, 0.8], "noise": [0, 3]}}
    ),
    "untried": TrainingSet("what `calibrate --trials 0` writes", of_place=True, trials=0),
    "few": TrainingSet("an eighth of the pairs", share=0.125),
    "unchanged": TrainingSet(
        "`calibrated`, crops alone", of_place=True, pairs_of="calibrated", augmentation=PRESETS["psmnet"]
    ),
    "raft-stereo": TrainingSet(
        "`calibrated`, augmented as RAFT-Stereo does", of_place=True, pairs_of="calibrated", augmentation=_RAFT
    ),
    "scaled": TrainingSet(
        "`calibrated`, colours, scale and stretch", of_place=True, pairs_of="calibrated", augmentation=_SCALED
    ),
    "moved": TrainingSet(
        "`calibrated`, colours, scale, stretch, the right image moved and hidden in part",
        of_place=True,
        pairs_of="calibrated",
        augmentation=_MOVED,
    ),
}


def config_of(name: str, images: tuple[str, ...], scratch: Path) -> Config:
    """Make the config of a row.

    Args:
        name: of `SETS`.
        images: photographs of the place; without, rows wear what `rig.yaml` says.
        scratch: folder for what `calibrate` writes.

    Raises:
        InputError: where the photographs cannot be used.
    """
    name = SETS[name].pairs_of or name
    row = SETS[name]
    base = load_config(RIG)
    worn: dict[str, Any] = {"textures.source": "images", "textures.images": list(images)} if images else {}
    if row.trials is None and not row.packaged:
        return load_config(RIG, {**worn, **row.overrides, "name": name})
    scratch.mkdir(parents=True, exist_ok=True)
    written = scratch / f"{name}.yaml"
    if row.packaged:
        scale = base.camera.width_px / load_config(row.packaged).camera.width_px
        written.write_text(f"extends: {row.packaged}\nname: {name}\nscale: {scale}\n", encoding="utf-8")
    else:
        written.write_text(_calibrated(name, row.trials, images, base), encoding="utf-8")
    values = base.model_dump(mode="json")
    if row.own_rig:
        return load_config(written, {key: values[key] for key in ("truth", "outputs")})
    # A calibration has maps to measure, or a guess: here all other rows are wanted to show the same.
    return load_config(written, worn | {key: values[key] for key in ("camera", "disparity", "truth", "outputs")})


def _calibrated(name: str, trials: int | None, images: tuple[str, ...], base: Config) -> str:
    """Return what `calibrate` writes for the rig and photographs, by so many trials."""
    camera, wanted = base.camera, base.disparity
    ranges = camera.focal_px, camera.baseline_m, camera.doffs_px
    rigs = [_rig(base, *(each.low for each in ranges)), _rig(base, *(each.high for each in ranges))]
    draft = describe(name, rigs, images, disparity_range(rigs, range_px=(wanted.min_px, wanted.max_px)))
    if trials:
        place = measure_place(find_images(images), (), working_width(draft.size.width_px))
        draft = fit(draft, place.side, trials, Listener())
    return write(draft)


def _rig(config: Config, focal_px: float, baseline_m: float, doffs_px: float) -> Rig:
    size = config.camera.width_px, config.camera.height_px
    return Rig(StereoCamera.centred(*size, focal_px, baseline_m, doffs_px), RIG.name)
