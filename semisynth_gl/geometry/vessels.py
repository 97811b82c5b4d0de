"""Vessels: bottles, vases, mugs, glasses, bowls, baskets, cages."""

import numpy as np

from semisynth_gl.geometry.mesh import Parts
from semisynth_gl.geometry.parts import arc, circle, hollow, lift, placed, rod, spline, wire
from semisynth_gl.geometry.rotations import about_x, even_turns
from semisynth_gl.geometry.surfaces import lathe


def bottle(rng: np.random.Generator) -> Parts:
    """A bottle, open or with a cap."""
    body, neck = rng.uniform(0.2, 0.34), rng.uniform(0.05, 0.1)
    shoulder, slope = rng.uniform(0.45, 0.8), rng.uniform(0.08, 0.35)
    top = shoulder + slope + rng.uniform(0.1, 0.3)
    t = np.linspace(0, np.pi, 12)
    rise = np.stack([neck + (body - neck) * (1 + np.cos(t)) / 2, shoulder + slope * t / np.pi], axis=1)
    outside = np.concatenate([[(0.92 * body, 0), (body, 0.03)], rise, [(neck, top)]])
    ring = [(0.9 * neck, top - 0.05), (1.2 * neck, top - 0.05), (1.2 * neck, top - 0.01), (0.9 * neck, top - 0.01)]
    yield lathe(ring, 24, closed=True)
    if rng.random() < 0.5:
        cap = [(0, top - 0.02), (1.35 * neck, top - 0.02), (1.35 * neck, top + 0.06), (0, top + 0.06)]
        yield from (lathe([(0, 0), *outside, (0, top)], 40), lathe(cap, 24))
    else:
        yield lathe(hollow(outside, 0.018), 40)


def vase(rng: np.random.Generator) -> Parts:
    """An open vase with a belly, a waist and a lip of random sizes."""
    height = rng.uniform(0.8, 1.6)
    radii = rng.uniform((0.2, 0.3, 0.12, 0.16), (0.35, 0.5, 0.3, 0.42))
    heights = np.array([0, rng.uniform(0.25, 0.5), rng.uniform(0.7, 0.85), 1]) * height
    outside = spline(np.column_stack([radii, heights]), 8)
    yield lathe(hollow(outside, 0.025), 44)


def mug(rng: np.random.Generator) -> Parts:
    """A mug with a handle."""
    radius, height, wall = rng.uniform(0.3, 0.45), rng.uniform(0.6, 1.1), rng.uniform(0.025, 0.05)
    foot = radius * rng.uniform(0.75, 1)
    outside = np.array([(foot, 0), (radius, 0.08), (radius, 0.5 * height), (radius * rng.uniform(0.95, 1.1), height)])
    yield lathe(hollow(outside, wall), 44)
    tall = 0.3 * height
    bow = arc(1, -np.pi / 2, np.pi / 2, 25) * (tall * rng.uniform(0.8, 1.15), tall) + (radius - 0.6 * wall, height / 2)
    yield wire(lift(bow, "xz"), rng.uniform(0.03, 0.045), 12)


def goblet(rng: np.random.Generator) -> Parts:
    """A wine glass with a thin foot, stem and bowl."""
    foot, stem, bowl = rng.uniform(0.22, 0.32), rng.uniform(0.018, 0.035), rng.uniform(0.25, 0.4)
    leg, tall = rng.uniform(0.3, 0.6), rng.uniform(0.35, 0.7)
    lip = bowl * rng.uniform(0.65, 1.15)
    cup = spline([(stem, leg), (0.7 * bowl, leg + 0.12 * tall), (bowl, leg + 0.45 * tall), (lip, leg + tall)], 7)
    wall = 0.014
    inner = cup[::-1] - (wall, 0)
    inner = inner[inner[:, 0] > 0.02]
    profile = np.concatenate([[(0, 0), (foot, 0), (foot, 0.012), (stem, 0.06)], cup, inner, [(0, inner[-1, 1])]])
    yield lathe(profile, 40)


def bowl_stack(rng: np.random.Generator) -> Parts:
    """Bowls stacked in each other, slightly off centre."""
    floor, radius = 0.0, rng.uniform(0.5, 0.7)
    for _ in range(int(rng.integers(2, 6))):
        depth = radius * rng.uniform(0.45, 0.7)
        curve = np.column_stack([np.linspace(0.35, 1, 10), np.linspace(0, 1, 10) ** 2.2]) * (radius, depth)
        wobble, tilt = (*rng.uniform(-0.015, 0.015, 2), floor), about_x(rng.uniform(-0.06, 0.06))
        yield placed(lathe(hollow(curve, 0.02), 36), wobble, rotation=tilt)
        floor += rng.uniform(0.08, 0.2)
        radius *= rng.uniform(0.85, 1)


def jug(rng: np.random.Generator) -> Parts:
    """A jug with a tall handle and a long spout, like a watering can."""
    radius, height = rng.uniform(0.3, 0.4), rng.uniform(0.5, 0.8)
    top = radius * rng.uniform(0.5, 0.8)
    outside = spline([(0.9 * radius, 0), (radius, 0.3 * height), (0.9 * radius, 0.7 * height), (top, height)], 6)
    yield lathe(hollow(outside, 0.025), 40)
    reach, rise, arch = rng.uniform(0.4, 0.8), rng.uniform(0.8, 1.2), rng.uniform(0.25, 0.5)
    spout = [(0.8 * radius, 0.2 * height), (radius + 0.4 * reach, 0.5 * height), (radius + reach, rise * height)]
    yield wire(lift(spline(spout, 7), "xz"), 0.04, 12)
    handle = [(-0.9 * radius, 0.3 * height), (-radius - 0.6 * arch, 0.7 * height), (-0.9 * radius, height + arch)]
    handle += [(0.0, height + arch), (top - 0.02, height - 0.02)]
    yield wire(lift(spline(handle, 7), "xz"), 0.03, 10)


def basket(rng: np.random.Generator) -> Parts:
    """A basket of upright rods and hoops with gaps between them, and in 7 of 10 cases with a handle."""
    low, high, height = rng.uniform(0.3, 0.45), rng.uniform(0.45, 0.6), rng.uniform(0.35, 0.6)
    yield lathe([(0, 0), (low + 0.02, 0), (low + 0.02, 0.03), (0, 0.03)], 32)
    turns = even_turns(int(rng.integers(12, 25)))
    yield from [rod(turn @ (low, 0, 0.01), turn @ (high, 0, height), 0.011, sides=6) for turn in turns]
    for share in np.linspace(0.15, 1, int(rng.integers(3, 6))):
        hoop = circle(0.012 if share < 1 else 0.022, 8)
        yield lathe(hoop + (low + share * (high - low), share * height), 36, closed=True)
    if rng.random() < 0.7:
        over = arc(high, 0, np.pi, 20) * (1, rng.uniform(0.7, 1.2))
        yield wire(lift(over + (0, height), "xz"), 0.02)


def cage(rng: np.random.Generator) -> Parts:
    """A bird cage: thin bars that meet below a ring, and a perch inside."""
    radius, height, dome = rng.uniform(0.35, 0.55), rng.uniform(0.5, 0.9), rng.uniform(0.25, 0.5)
    yield lathe([(0, 0), (radius + 0.03, 0), (radius + 0.03, 0.05), (0, 0.05)], 36)
    over = arc(1, 0, 0.46 * np.pi, 9) * (radius, dome) + (0, height)
    bar = np.concatenate([[(radius, 0.03)], over])
    yield from [wire(lift(bar, "xz") @ turn.T, 0.009, 6) for turn in even_turns(int(rng.integers(12, 28)))]
    levels, tube = np.linspace(0, height, int(rng.integers(2, 5)))[1:], circle(0.014, 8)
    yield from [lathe(tube + (radius, z), 36, closed=True) for z in levels]
    top = height + dome
    yield lathe([(0, top - 0.01), (0.09, top - 0.01), (0.05, top + 0.05), (0, top + 0.05)], 16)
    ring = lift(circle(0.07, 16), "xy") @ about_x(np.pi / 2).T
    yield wire(ring + (0, 0, top + 0.1), 0.012, 8, closed=True)
    perch = rng.uniform(0.25, 0.6) * height
    yield rod((-radius, 0, perch), (radius, 0, perch), 0.018)
