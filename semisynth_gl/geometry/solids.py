"""Simple models: solids of geometry, in varying proportions."""

from typing import Final

import numpy as np

from semisynth_gl.geometry.mesh import Parts
from semisynth_gl.geometry.parts import arc, ball, circle
from semisynth_gl.geometry.surfaces import box, extruded, lathe

SMOOTH_SEGMENTS: Final = 48
"""Number of sides of the polygon that replaces a circle: at a diameter of 300 px, it is off by a third of a pixel."""


def cube(_rng: np.random.Generator) -> Parts:
    """A cube; all are the same."""
    yield box((1, 1, 1))


def cuboid(rng: np.random.Generator) -> Parts:
    """A box, up to four times as long as wide."""
    yield box(rng.uniform(0.5, 2, 3))


def sphere(_rng: np.random.Generator) -> Parts:
    """A sphere; all are the same."""
    yield ball(1, SMOOTH_SEGMENTS, SMOOTH_SEGMENTS // 2 + 1)


def cone(rng: np.random.Generator) -> Parts:
    """A cone, or more rarely a frustum."""
    top = rng.uniform(0.2, 0.7) if rng.random() < 0.3 else 0.0
    height = rng.uniform(1, 3.5)
    lid = [(top, height)] if top else []
    yield lathe([(0, 0), (1, 0), *lid, (0, height)], SMOOTH_SEGMENTS)


def cylinder(rng: np.random.Generator) -> Parts:
    """A cylinder, from a flat tin to a long tube."""
    height = float(np.exp(rng.uniform(np.log(0.5), np.log(6))))
    yield lathe([(0, 0), (1, 0), (1, height), (0, height)], SMOOTH_SEGMENTS)


def capsule(rng: np.random.Generator) -> Parts:
    """A cylinder between two half spheres."""
    half = rng.uniform(0.3, 2)
    quarter = arc(1, 0, np.pi / 2, SMOOTH_SEGMENTS // 4 + 1) + (0, half)
    quarter[-1, 0] = 0
    yield lathe(np.concatenate([quarter[::-1] * (1, -1), quarter]), SMOOTH_SEGMENTS)


def torus(rng: np.random.Generator) -> Parts:
    """A ring, from a thin hoop to a thick one."""
    tube = circle(rng.uniform(0.1, 0.6), SMOOTH_SEGMENTS // 2)
    yield lathe(tube + (1, 0), SMOOTH_SEGMENTS, closed=True)


def pyramid(rng: np.random.Generator) -> Parts:
    """A pyramid over a regular polygon of three to six sides."""
    yield lathe([(0, 0), (1, 0), (0, rng.uniform(0.7, 2.5))], int(rng.integers(3, 7)))


def prism(rng: np.random.Generator) -> Parts:
    """A prism over a polygon of three to eight sides, regular or elongated."""
    outline = circle(1, int(rng.integers(3, 9)), rng.uniform(0, 2 * np.pi)) * (1, rng.uniform(0.6, 1))
    yield extruded(outline, rng.uniform(0.5, 3))
