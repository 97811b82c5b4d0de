"""Pilot scenes: a dataset's scenes without particles, with only camera, background and structures.

Each process that renders a dataset needs them before its first pair, and furnishing a room takes longer than rendering
it. So the cache keeps them.
"""

import hashlib
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from semisynth_gl.cache import Entry, cached, package_versions
from semisynth_gl.config.model import Config
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.scene import Floats
from semisynth_gl.scene.arrangement import Catalogue
from semisynth_gl.scene.structures import sample_static_scene
from semisynth_gl.seeds.seeds import Purpose, generator

_PILOTS = 32
_KEYS = (Purpose.CAMERA, Purpose.BACKGROUND, Purpose.STRUCTURES, Purpose.SWAY, Purpose.RIG, Purpose.SKY)
# The sections that `sample_static_scene` reads.
_SECTIONS = {"camera", "rig", "disparity", "background", "room", "street", "structures"}
VERSION = 1
"""To be raised by each change of the code that changes pilot scenes; see `semisynth_gl.cache`."""


class Pilot(NamedTuple):
    """A pilot scene."""

    camera: StereoCamera
    bare_px: Floats  # (R,) finite disparities on a coarse grid over the left view, without particles


def sample_pilots(config: Config, seed: int, catalogue: Catalogue) -> list[Pilot]:
    """Sample the 32 pilot scenes of a recipe, or load them from the cache.

    Raises:
        InputError: where a disparity of the config lies beyond infinity, or a far plane would have to be endless.
    """

    def key() -> dict[str, Any]:
        return {
            "sections": config.model_dump(mode="json", include=_SECTIONS),
            "seed": seed,
            "models": _digest(catalogue),
            "versions": package_versions("numpy", "pyrr"),
        }

    def build() -> list[Pilot]:
        return [_sample_pilot(config, seed, number, catalogue) for number in range(_PILOTS)]

    return cached("pilots", VERSION, key, build=build, pack=_packed, unpack=_unpacked)


def _sample_pilot(config: Config, seed: int, number: int, catalogue: Catalogue) -> Pilot:
    generators = {use: generator(seed, Purpose.PILOTS, number, key) for key, use in enumerate(_KEYS)}
    static = sample_static_scene(config, catalogue, generators.__getitem__)
    return Pilot(static.camera, static.bare_px)


def _digest(catalogue: Catalogue) -> str:
    """Return the SHA-256 of the names by which static instances are picked, and of the models."""
    digest = hashlib.sha256()
    for name, numbers in catalogue.by_name.items():
        digest.update(f"{name!r} {numbers.tolist()}\n".encode())
    for mesh in catalogue.models:
        for array in (mesh.positions, mesh.uv, mesh.triangles):
            digest.update(f"{array.shape}\n".encode() + array.tobytes())
    return digest.hexdigest()


def _packed(pilots: Sequence[Pilot]) -> Entry:
    values = {"cameras": [pilot.camera.values() for pilot in pilots], "rays": [len(pilot.bare_px) for pilot in pilots]}
    return Entry(values, {"bare_px": np.concatenate([pilot.bare_px for pilot in pilots])})


def _unpacked(entry: Entry) -> list[Pilot]:
    parts = np.split(entry.arrays["bare_px"], np.cumsum(entry.values["rays"])[:-1])
    cameras = (StereoCamera.from_values(values) for values in entry.values["cameras"])
    return [Pilot(camera, bare_px) for camera, bare_px in zip(cameras, parts, strict=True)]
