"""Structures: stairs, ladders, fences, pipes, scaffolds, bridges."""

from itertools import pairwise

import numpy as np

from semisynth_gl.geometry.mesh import Parts, merged, unit
from semisynth_gl.geometry.parts import arc, circle, from_polar, placed, rectangle, rod, rounded, wire
from semisynth_gl.geometry.rotations import about_x, about_z
from semisynth_gl.geometry.surfaces import box, extruded, lathe, sweep


def stairs(rng: np.random.Generator) -> Parts:
    """A straight flight of open stairs: treads on two beams, with up to two railings."""
    steps, rise = int(rng.integers(7, 13)), rng.uniform(0.15, 0.2)
    run, width = rng.uniform(0.2, 0.32), rng.uniform(0.6, 1.2)
    yield from [box((width, run * 1.1, 0.04), (0, i * run, (i + 1) * rise)) for i in range(steps)]
    beam = np.array([[0, -0.4 * run, 0.5 * rise], [0, (steps - 0.6) * run, (steps - 0.5) * rise]])
    # The section's first axis becomes x, across the flight.
    yield from [sweep(rectangle(0.04, 0.16), beam + (side * 0.42 * width, 0, -0.03)) for side in (-1, 1)]
    for side in {0: (), 1: (-1,), 2: (-1, 1)}[int(rng.integers(3))]:
        x = side * (width / 2 - 0.04)
        yield from [rod((x, i * run, (i + 1) * rise), (x, i * run, (i + 1) * rise + 0.8), 0.012) for i in range(steps)]
        low, high = ((x, i * run, (i + 1) * rise + 0.8) for i in (-0.5, steps - 0.5))
        yield rod(low, high, 0.028)


def spiral_stairs(rng: np.random.Generator) -> Parts:
    """Treads around a column, with balusters and a handrail."""
    steps, turn = int(rng.integers(10, 22)), rng.uniform(0.3, 0.5)
    rise, radius = rng.uniform(0.14, 0.2), rng.uniform(0.7, 1)
    turn *= rng.choice([-1, 1])
    yield rod((0, 0, 0), (0, 0, (steps + 4) * rise), 0.06, sides=16)
    half = 0.55 * abs(turn)
    tread = np.concatenate([[(0.04, -0.05)], arc(radius, -half, half, 5), [(0.04, 0.05)]]) - (radius / 2, 0)
    for i in range(steps):
        rotation = about_z(i * turn)
        yield placed(extruded(tread, 0.03), rotation @ (radius / 2, 0, (i + 1) * rise), rotation=rotation)
        foot = rotation @ np.array([0.95 * radius, 0, (i + 1) * rise])
        yield rod(foot, foot + (0, 0, 0.75), 0.01, sides=6)
    t = np.linspace(0, steps - 1, 4 * steps)
    yield wire(np.column_stack([from_polar(0.95 * radius, t * turn), (t + 1) * rise + 0.75]), 0.022)


def ladder(rng: np.random.Generator) -> Parts:
    """A ladder that narrows upwards, or a stepladder with a second frame."""
    length, low, high = rng.uniform(1.5, 2.6), rng.uniform(0.4, 0.6), rng.uniform(0.25, 0.4)
    rungs, rail = int(rng.integers(5, 12)), rng.uniform(0.018, 0.03)
    front = [rod((side * low / 2, 0, 0), (side * high / 2, 0, length), rail) for side in (-1, 1)]
    for share in (np.arange(rungs) + 0.5) / rungs:
        half = (low + share * (high - low)) / 2
        front.append(rod((-half, 0, share * length), (half, 0, share * length), rng.uniform(0.6, 0.9) * rail))
    if rng.random() >= 0.5:
        yield from front
        return
    spread = rng.uniform(0.3, 0.6)
    top, reach = length * np.cos(spread / 2), length * np.sin(spread / 2)
    yield placed(merged("front", front), (0, -reach, 0), rotation=about_x(-spread / 2))
    yield box((high + 0.06, 0.12, 0.03), (0, 0, top))
    yield from [rod((side * low / 2, reach, 0), (side * high / 2, 0, top), 0.7 * rail) for side in (-1, 1)]
    yield rod((-0.45 * low, 0.7 * reach, 0.3 * top), (0.45 * low, 0.7 * reach, 0.3 * top), 0.5 * rail)


def fence(rng: np.random.Generator) -> Parts:
    """A fence between posts: pointed pickets, round bars, or wire mesh."""
    width, height = rng.uniform(1.4, 2.4), rng.uniform(0.8, 1.2)
    yield from [box((0.07, 0.07, height), (x * width / 2, 0, height / 2)) for x in (-1, 0, 1)]
    style = int(rng.integers(3))
    if style < 2:
        yield from [box((width, 0.03, 0.06), (0, 0.05, share * height)) for share in (0.2, 0.75)]
        for x in np.linspace(-0.5, 0.5, int(rng.integers(10, 24)))[1:-1] * width:
            if style == 0:
                half, tall, point = rng.uniform(0.025, 0.035), 0.95 * height, 0.06
                outline = [*rectangle(2 * half, tall)[:3], (0, tall / 2 + point), (-half, tall / 2)]
                picket = extruded(outline, 0.02)
                yield placed(picket, (x, 0.083, tall / 2 + 0.05), rotation=about_x(np.pi / 2))
            else:
                yield rod((x, 0.05, 0.05), (x, 0.05, rng.uniform(0.95, 1.05) * height), 0.012)
    else:
        spacing = rng.uniform(0.08, 0.15)
        xs, zs = np.arange(-width / 2, width / 2, spacing), np.arange(0.05, height, spacing)
        yield from [rod((x, 0.01, 0), (x, 0.01, height), 0.007, sides=6) for x in xs]
        yield from [rod((-width / 2, 0, z), (width / 2, 0, z), 0.007, sides=6) for z in zs]


def pipe_run(rng: np.random.Generator) -> Parts:
    """Pipes with right-angled bends, and flanges at both ends."""
    radius = rng.uniform(0.04, 0.075)
    for lane in range(int(rng.integers(1, 4))):
        at = np.array([lane * 5 * radius, 0.0, 0.0])
        corners, last = [at], -1
        for _ in range(int(rng.integers(4, 8))):
            axis = int(rng.choice([a for a in range(3) if a != last]))
            step = np.zeros(3)
            step[axis] = rng.uniform(0.65, 1.1) * rng.choice([-1, 1])
            at, last = at + step, axis
            corners.append(at)
        path = rounded(corners, 0.3, 8)
        yield wire(path, radius, 14)
        for tip, towards in ((path[0], path[1]), (path[-1], path[-2])):
            along = unit(towards - tip)
            yield rod(tip - 0.02 * along, tip + 0.04 * along, 1.7 * radius, sides=16)


def scaffold(rng: np.random.Generator) -> Parts:
    """A grid of thin tubes with diagonals and a few planks."""
    counts, gaps = rng.integers((2, 2, 2), (5, 4, 5)), rng.uniform(0.5, 0.9, 3)
    x, y, z = (np.arange(count) * gap for count, gap in zip(counts, gaps, strict=True))
    tube, over = rng.uniform(0.014, 0.03), 0.06
    yield from [rod((a, b, -over), (a, b, z[-1] + over), tube) for a in x for b in y]
    yield from [rod((-over, b, c), (x[-1] + over, b, c), tube) for b in y for c in z]
    yield from [rod((a, -over, c), (a, y[-1] + over, c), tube) for a in x for c in z]
    for a, right in pairwise(x):
        for c, above in pairwise(z):
            ends = ((a, right), (right, a))[int(rng.integers(2))]
            yield rod((ends[0], 0, c), (ends[1], 0, above), 0.7 * tube)
            if rng.random() < 0.4:
                yield box((right - a, y[-1], 0.02), ((a + right) / 2, y[-1] / 2, above + tube + 0.012))


def truss_bridge(rng: np.random.Generator) -> Parts:
    """A deck between two trusses, with an upper chord that may arch."""
    bays, bay = int(rng.integers(4, 9)), rng.uniform(0.3, 0.45)
    width, height = rng.uniform(0.4, 0.7), rng.uniform(0.3, 0.55)
    rise, beam = rng.uniform(0, 0.4), rng.uniform(0.014, 0.026)
    node = np.arange(bays + 1)
    level = height + rise * np.sin(np.pi * node / bays)
    yield box((bays * bay, width, 0.03), (bays * bay / 2, 0, -0.01))
    for y in (-width / 2, width / 2):
        low = [np.array([i * bay, y, 0]) for i in node]
        high = [np.array([i * bay, y, level[i]]) for i in node]
        yield from [rod(low[0], low[-1], 1.4 * beam), rod(low[0], high[1], beam), rod(low[-1], high[-2], beam)]
        yield from [rod(low[i], high[i], 0.7 * beam) for i in node[1:-1]]
        for i in node[1:-2]:
            foot, head = (low[i], high[i + 1]) if i >= bays // 2 else (high[i], low[i + 1])
            yield from [rod(high[i], high[i + 1], beam), rod(foot, head, 0.7 * beam)]
    yield from [rod((i * bay, -width / 2, level[i]), (i * bay, width / 2, level[i]), 0.8 * beam) for i in node[1:-1]]


def rod_bundle(rng: np.random.Generator) -> Parts:
    """A bundle of crossing thin rods, held by one or two rings."""
    count, length, ring = int(rng.integers(25, 70)), rng.uniform(1.2, 2), rng.uniform(0.1, 0.25)
    for _ in range(count):
        middle, lean = rng.uniform(-1, 1, 2), rng.normal(0, 0.35, 2)
        middle *= 0.8 * ring / max(1.0, float(np.linalg.norm(middle)))
        low, high = (np.append(middle + side * lean / 2, side * length / 2 * rng.uniform(0.8, 1)) for side in (-1, 1))
        yield rod(low, high, rng.uniform(0.006, 0.018), sides=6)
    tube = circle(0.03, 10)
    heights = (0.0,) if rng.random() < 0.5 else (-0.2, 0.2)
    yield from [lathe(tube + (ring + 0.05, z), 36, closed=True) for z in heights]
