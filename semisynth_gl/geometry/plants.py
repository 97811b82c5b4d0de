"""Plants: potted plants, trees, cacti, grass, flowers."""

import numpy as np
from numpy.typing import ArrayLike

from semisynth_gl.geometry.mesh import Floats, Mesh, Parts, cross, merged, unit
from semisynth_gl.geometry.parts import arc, ball, circle, hollow, placed, rod, spline, wire
from semisynth_gl.geometry.rotations import about_y, about_z, rotation_about, z_onto
from semisynth_gl.geometry.surfaces import grid_surface, lathe, sweep

GOLDEN_TURN_RAD = np.pi * (3 - np.sqrt(5))
"""Angle between successive leaves on the stem of many plants, rad."""


def _leaf(length: float, width: float, droop_rad: float, rows: int = 9) -> Mesh:
    """Return a leaf without thickness. It begins at the origin along +x and bends down by ``droop_rad`` in all."""
    share = np.linspace(0, 1, rows)
    outline = width / 2 * np.sin(np.pi * share**0.7) ** 0.8
    outline[0], outline[-1] = 0.02 * width, 0
    heading = -droop_rad * (share[:-1] + share[1:]) / 2
    step = length / (rows - 1)
    x, z = (np.concatenate([[0], np.cumsum(step * turn(heading))]) for turn in (np.cos, np.sin))
    across = np.array([1, 0, -1])  # from +y to -y, so that the upper side is the front
    points = np.stack(np.broadcast_arrays(x[:, None], across * outline[:, None], z[:, None]), axis=2)
    uv = np.stack(np.broadcast_arrays(-across * outline[:, None], -share[:, None] * length), axis=2)
    return grid_surface(points, uv)


def _stem(path: Floats, radius: float, tip: float, sides: int = 6) -> Mesh:
    """Return a stem along a curve, (P, 3), whose radius decreases from ``radius`` to ``tip``."""
    return sweep(circle(radius, sides), path, scales=np.linspace(1, tip / radius, len(path)))


def _facing(azimuth_rad: float, rise_rad: float) -> Floats:
    """Return the rotation, (3, 3), that raises the x axis by ``rise_rad`` and then turns about z by ``azimuth_rad``."""
    return about_z(azimuth_rad) @ about_y(-rise_rad)


def potted_plant(rng: np.random.Generator) -> Parts:
    """A pot with stems that bend outwards and have leaves."""
    radius, height = rng.uniform(0.2, 0.3), rng.uniform(0.25, 0.45)
    pot = np.array([(0.7 * radius, 0), (radius, height)])
    rim = np.array([(0.97, 0.82), (1.15, 0.82), (1.15, 0.98), (0.97, 0.98)]) * (radius, height)
    soil = [(0, 0.7 * height), (0.88 * radius, 0.7 * height), (0.88 * radius, 0.78 * height), (0, 0.8 * height)]
    yield from (lathe(hollow(pot, 0.02), 36), lathe(rim, 36, closed=True), lathe(soil, 24))
    long, wide = rng.uniform(0.25, 0.5), rng.uniform(0.08, 0.2)
    for stem in range(int(rng.integers(4, 9))):
        azimuth, tall, spread = stem * GOLDEN_TURN_RAD, rng.uniform(0.5, 1.1), rng.uniform(0.1, 0.45)
        away = np.array([np.cos(azimuth), np.sin(azimuth), 0])
        foot = 0.4 * radius * away + (0, 0, 0.72 * height)
        path = spline([foot, foot + 0.25 * spread * away + (0, 0, 0.55 * tall), foot + spread * away + (0, 0, tall)], 5)
        yield _stem(path, 0.016, 0.006)
        for leaf in range(3, len(path), 2):
            turn = _facing(azimuth + leaf * GOLDEN_TURN_RAD, rng.uniform(0, 0.7))
            size = rng.uniform(0.7, 1)
            yield placed(_leaf(size * long, size * wide, rng.uniform(0.4, 1.4)), path[leaf], rotation=turn)


def tree(rng: np.random.Generator) -> Parts:
    """A tree without leaves: branches that fork into thinner branches."""
    levels = int(rng.integers(4, 6))
    spread, shrink = rng.uniform(0.35, 0.7), rng.uniform(0.68, 0.8)
    tips = [(np.zeros(3), np.eye(3)[2], 0.6, 0.07)]
    for level in range(levels + 1):
        grown = []
        for foot, axis, length, radius in tips:
            end = foot + length * axis
            middle = (foot + end) / 2 + rng.normal(0, 0.04 * length, 3)
            path = spline([foot, middle, end], 3 if level < 3 else 1)
            yield _stem(path, radius, 0.7 * radius, 8 if level < 2 else 5)
            for fork in range(2 if rng.random() < 0.7 or level > 2 else 3):
                sideways = unit(cross(axis, rng.normal(size=3)))
                heading = rotation_about(axis, np.pi * fork) @ (np.cos(spread) * axis + np.sin(spread) * sideways)
                heading = unit(heading + (0, 0, 0.15))
                long = length * shrink * rng.uniform(0.85, 1.1)
                grown.append((end - 0.3 * radius * axis, heading, long, 0.7 * radius))
        tips = grown


def cactus(rng: np.random.Generator) -> Parts:
    """A cactus in a low pot: a column, and arms with round ends that bend upwards."""
    thick, tall = rng.uniform(0.09, 0.14), rng.uniform(0.8, 1.2)
    yield lathe(hollow(np.array([(0.18, 0), (0.26, 0.2), (0.28, 0.22)]), 0.02), 32)
    yield _round_ended([(0, 0, 0.05), (0, 0, tall / 2), (0, 0, tall)], thick)
    for arm in range(int(rng.integers(1, 5))):
        azimuth = arm * GOLDEN_TURN_RAD + rng.uniform(-0.5, 0.5)
        away = np.array([np.cos(azimuth), np.sin(azimuth), 0])
        level, reach, rise = rng.uniform(0.3, 0.65) * tall, rng.uniform(0.36, 0.5), rng.uniform(0.2, 0.5)
        bend = arc(reach - thick, -np.pi / 2, 0, 7) + (thick, reach)
        path = [away * r + (0, 0, level + z) for r, z in bend]
        yield _round_ended([(0, 0, level + thick), *path, path[-1] + (0, 0, rise)], 0.55 * thick)


def _round_ended(path: ArrayLike, radius: float) -> Mesh:
    """Return a round tube along a curve, (P, 3), that ends in a ball."""
    points = np.asarray(path, np.float64)
    end = placed(ball(radius, 20, 13), points[-1], rotation=z_onto(unit(points[-1] - points[-2])))
    return merged("tube", [wire(points, 0.99 * radius, 20), end])


def grass(rng: np.random.Generator) -> Parts:
    """A tuft of thin blades that bend outwards."""
    for blade in range(int(rng.integers(30, 70))):
        foot = 0.15 * np.sqrt(rng.random()) * np.array([np.cos(blade), np.sin(blade), 0])
        strand = _leaf(rng.uniform(0.6, 1.2), rng.uniform(0.015, 0.04), rng.uniform(0.2, 1.6), 7)
        yield placed(strand, foot, rotation=_facing(rng.uniform(0, 2 * np.pi), rng.uniform(1, 1.5)))


def flower(rng: np.random.Generator) -> Parts:
    """A few flowers on long stems: rings of petals around a disc."""
    petals, long = int(rng.integers(5, 14)), rng.uniform(0.16, 0.3)
    for stem in range(int(rng.integers(1, 5))):
        azimuth = stem * GOLDEN_TURN_RAD
        away = np.array([np.cos(azimuth), np.sin(azimuth), 0])
        tall = rng.uniform(0.8, 1.3)
        head = rng.uniform(0.1, 0.4) * away + (0, 0, tall)
        path = spline([np.zeros(3), 0.3 * head * (1, 1, 0) + (0, 0, 0.6 * tall), head], 6)
        yield _stem(path, 0.015, 0.009, 8)
        tilt = _facing(azimuth, 0) @ about_y(rng.uniform(0.2, 1))
        yield placed(lathe([(0, -0.02), (0.06, -0.01), (0.05, 0.02), (0, 0.035)], 20), head, rotation=tilt)
        for petal in range(petals):
            turn = tilt @ _facing(2 * np.pi * petal / petals, 0.25)
            yield placed(_leaf(long, 5.0 * long / petals, 0.5), head + turn @ (0.04, 0, 0), rotation=turn)
        for side in (0.3, 0.5):
            joint = (0.3 * side * head * (1, 1, 0)) + (0, 0, side * tall)
            yield placed(_leaf(0.3, 0.09, 1), joint, rotation=_facing(azimuth + 9 * side, 0.5))
    yield rod((0, 0, -0.02), (0, 0, 0.03), 0.06, sides=16)
