"""Pilot scenes: a dataset's static scenes, without particles.

Each process that renders a dataset needs them before its first pair, and furnishing a room takes longer than rendering
it. So the cache keeps them.
"""

import hashlib
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from semisynth_gl.cache import Entry, cached
from semisynth_gl.config import Config
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.scene import Floats
from semisynth_gl.scene.arrangement import Catalogue
from semisynth_gl.scene.structures import sample_static_scene
from semisynth_gl.seeds.seeds import Purpose, generator

_PILOTS = 32
_KEYS = (Purpose.CAMERA, Purpose.BACKGROUND, Purpose.STRUCTURES, Purpose.SWAY, Purpose.RIG, Purpose.SKY)
# The sections that `sample_static_scene` reads.
_SECTIONS = {"camera", "rig", "disparity", "background", "room", "street", "structures"}


class Pilot(NamedTuple):
    """A pilot scene."""

    camera: StereoCamera
    bare_px: Floats  # (R,) disparities on a coarse grid over the left view, without particles


def sample_pilots(config: Config, seed: int, catalogue: Catalogue) -> list[Pilot]:
    """Sample the 32 pilot scenes of a recipe, or load them from the cache; errors are `sample_static_scene`'s."""

    def key() -> dict[str, Any]:
        models = hashlib.sha256()
        for name, numbers in catalogue.by_name.items():
            models.update(f"{name!r} {numbers.tolist()}\n".encode())
        for mesh in catalogue.models:
            for array in (mesh.positions, mesh.uv, mesh.triangles):
                models.update(f"{array.shape}\n".encode() + array.tobytes())
        return {
            "sections": config.model_dump(mode="json", include=_SECTIONS),
            "seed": seed,
            "models": models.hexdigest(),
        }

    def sample(number: int) -> Pilot:
        generators = {use: generator(seed, Purpose.PILOTS, number, key) for key, use in enumerate(_KEYS)}
        static = sample_static_scene(config, catalogue, generators.__getitem__)
        return Pilot(static.rig.camera, static.bare_px)

    return cached("pilots", key, build=lambda: [*map(sample, range(_PILOTS))], pack=_packed, unpack=_unpacked)


def _packed(pilots: Sequence[Pilot]) -> Entry:
    cameras = [pilot.camera.values() for pilot in pilots]
    return Entry({"cameras": cameras}, {"bare_px": np.array([pilot.bare_px for pilot in pilots])})


def _unpacked(entry: Entry) -> list[Pilot]:
    both = zip(entry.values["cameras"], entry.arrays["bare_px"], strict=True)
    return [Pilot(StereoCamera.from_values(values), bare_px) for values, bare_px in both]
