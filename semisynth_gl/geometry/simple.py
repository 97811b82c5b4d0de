"""Simple models: the solids of a geometry book, in varying proportions."""

# ruff: noqa: RUF005  an array plus a tuple is a sum, not a concatenation

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import numpy as np

from semisynth_gl.geometry.build import Builder, arc, circle
from semisynth_gl.geometry.mesh import Mesh, merged, normalised
from semisynth_gl.geometry.surfaces import box, extruded, lathe

SMOOTH_SEGMENTS: Final = 48
"""Sides of the polygon that stands for a circle: at 300 pixels across it is off by a third of a pixel."""


def cube(_rng: np.random.Generator) -> Mesh:
    """A cube; the only kind that never varies."""
    return _finished("cube", box((1, 1, 1)))


def cuboid(rng: np.random.Generator) -> Mesh:
    """A box, up to four times as long as wide."""
    return _finished("cuboid", box(rng.uniform(0.5, 2, 3)))


def sphere(_rng: np.random.Generator) -> Mesh:
    """A sphere; it never varies."""
    profile = arc(1, -np.pi / 2, np.pi / 2, SMOOTH_SEGMENTS // 2 + 1)
    profile[[0, -1], 0] = 0
    return _finished("sphere", lathe(profile, SMOOTH_SEGMENTS))


def cone(rng: np.random.Generator) -> Mesh:
    """A cone, or now and then a frustum."""
    top = rng.uniform(0.2, 0.7) if rng.random() < 0.3 else 0.0
    profile = [(0, 0), (1, 0), (top, rng.uniform(1, 3.5)), (0, 0)]
    profile[3] = (0, profile[2][1])
    return _finished("cone", lathe(profile if top else profile[:3], SMOOTH_SEGMENTS))


def cylinder(rng: np.random.Generator) -> Mesh:
    """A cylinder, from a flat tin to a long tube."""
    height = float(np.exp(rng.uniform(np.log(0.5), np.log(6))))
    return _finished("cylinder", lathe([(0, 0), (1, 0), (1, height), (0, height)], SMOOTH_SEGMENTS))


def capsule(rng: np.random.Generator) -> Mesh:
    """A cylinder between two half spheres."""
    half = rng.uniform(0.3, 2)
    quarter = arc(1, 0, np.pi / 2, SMOOTH_SEGMENTS // 4 + 1) + (0, half)
    quarter[-1, 0] = 0
    return _finished("capsule", lathe(np.concatenate([quarter[::-1] * (1, -1), quarter]), SMOOTH_SEGMENTS))


def torus(rng: np.random.Generator) -> Mesh:
    """A ring, from a thin hoop to a thick one."""
    tube = circle(rng.uniform(0.1, 0.6), SMOOTH_SEGMENTS // 2)
    return _finished("torus", lathe(tube + (1, 0), SMOOTH_SEGMENTS, closed=True))


def pyramid(rng: np.random.Generator) -> Mesh:
    """A pyramid over a regular polygon of three to six sides."""
    return _finished("pyramid", lathe([(0, 0), (1, 0), (0, rng.uniform(0.7, 2.5))], int(rng.integers(3, 7))))


def prism(rng: np.random.Generator) -> Mesh:
    """A prism over a polygon of three to eight sides, regular or drawn out."""
    outline = circle(1, int(rng.integers(3, 9)), rng.uniform(0, 2 * np.pi)) * (1, rng.uniform(0.6, 1))
    return _finished("prism", extruded(outline, rng.uniform(0.5, 3)))


def _finished(name: str, *parts: Mesh) -> Mesh:
    return normalised(merged(name, parts))


SIMPLE_KINDS: Final[Mapping[str, Builder]] = MappingProxyType(
    {
        "cube": cube,
        "cuboid": cuboid,
        "sphere": sphere,
        "cone": cone,
        "cylinder": cylinder,
        "capsule": capsule,
        "torus": torus,
        "pyramid": pyramid,
        "prism": prism,
    }
)
"""Builders of simple models, by the name their meshes carry."""
