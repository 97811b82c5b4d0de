"""Things from the workshop: gears, springs, chains, wheels, umbrellas, cables, knots."""

# ruff: noqa: RUF005  an array plus a tuple is a sum, not a concatenation

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.geometry.build import arc, around, circle, placed, rod, smooth, turned, wire
from semisynth_gl.geometry.mesh import Mesh, merged, normalised
from semisynth_gl.geometry.surfaces import box, extruded, grid_surface, lathe, sweep
from semisynth_gl.geometry.vectors import cross


def gear(rng: np.random.Generator) -> Mesh:
    """A toothed ring, or such a ring on spokes about a hub."""
    teeth, root, thick = int(rng.integers(8, 28)), rng.uniform(0.75, 0.88), rng.uniform(0.1, 0.4)
    pitch = 2 * np.pi / teeth
    corners = (np.array([0.1, 0.4, 0.55, 0.85]) * pitch + np.arange(teeth)[:, None] * pitch).ravel()
    radius = np.tile([root, 1, 1, root], teeth)
    unit = np.stack([np.cos(corners), np.sin(corners)], axis=1)
    if rng.random() < 0.5:
        return normalised(merged("gear", [extruded(unit * radius[:, None], thick, unit * rng.uniform(0.15, 0.6))]))
    inner, hub = rng.uniform(0.75, 0.88) * root, rng.uniform(0.2, 0.3)
    parts = [extruded(unit * radius[:, None], thick, unit * inner)]
    parts.append(placed(extruded(circle(hub, 32), 1.4 * thick, circle(0.5 * hub, 32)), (0, 0, -0.2 * thick)))
    for turn in around(int(rng.integers(3, 7))):
        spoke = box((inner - hub + 0.06, rng.uniform(0.08, 0.14), 0.6 * thick), ((inner + hub) / 2, 0, thick / 2))
        parts.append(placed(spoke, rotation=turn))
    return normalised(merged("gear", parts))


def torus_knot(rng: np.random.Generator) -> Mesh:
    """A closed tube that winds around a torus and cannot be undone."""
    p, q = ((2, 3), (3, 2), (2, 5), (3, 4), (3, 5), (5, 2))[int(rng.integers(6))]
    minor = rng.uniform(0.3, 0.45)
    t = np.linspace(0, 2 * np.pi, 48 * max(p, q), endpoint=False)
    ring = 1 + minor * np.cos(q * t)
    path = np.stack([ring * np.cos(p * t), ring * np.sin(p * t), minor * np.sin(q * t)], axis=1)
    return normalised(merged("torus_knot", [wire(path, rng.uniform(0.05, 0.09), 12, closed=True)]))


def spring(rng: np.random.Generator) -> Mesh:
    """A coil of wire: a straight helix, or one that widens like a cone."""
    turns, radius, pitch = rng.uniform(4, 11), rng.uniform(0.3, 0.6), rng.uniform(0.12, 0.25)
    t = np.linspace(0, turns, int(24 * turns))
    wide = radius * (1 + rng.choice([0.0, rng.uniform(-0.6, 0.6)]) * t / turns)
    path = np.stack([wide * np.cos(2 * np.pi * t), wide * np.sin(2 * np.pi * t), pitch * t], axis=1)
    return normalised(merged("spring", [wire(path, rng.uniform(0.02, 0.045), 10)]))


def chain(rng: np.random.Generator) -> Mesh:
    """Links that hang in each other along an arc."""
    links, bar = int(rng.integers(5, 13)), rng.uniform(0.03, 0.045)
    bow, straight = rng.uniform(0.2, 0.25), rng.uniform(0.15, 0.4)
    half = np.concatenate(
        [
            arc(bow, -np.pi / 2, np.pi / 2, 11) + (straight / 2, 0),
            arc(bow, np.pi / 2, 1.5 * np.pi, 11) - (straight / 2, 0),
        ]
    )
    link = wire(np.column_stack([half, np.zeros(len(half))]), bar, 10, closed=True)
    reach, sag = straight + 2 * bow - 2 * bar, rng.uniform(-0.35, 0.35)
    at, parts = np.zeros(3), []
    for i in range(links):
        tilt = turned((0, 1, 0), sag * (i - links / 2))
        parts.append(
            placed(link, at + tilt @ (reach / 2, 0, 0), rotation=tilt @ turned((1, 0, 0), (i % 2) * np.pi / 2 + 0.3))
        )
        at = at + tilt @ (reach, 0, 0)
    return normalised(merged("chain", parts))


def spoked_wheel(rng: np.random.Generator) -> Mesh:
    """A bicycle's wheel: tyre, hub and crossing spokes of wire."""
    spokes, tyre, hub, half = (
        2 * int(rng.integers(8, 19)),
        rng.uniform(0.03, 0.08),
        rng.uniform(0.05, 0.1),
        rng.uniform(0.06, 0.12),
    )
    parts = [lathe(circle(tyre, 12) + (1, 0), 64, closed=True)]
    parts.append(
        lathe([(0.02, -half - 0.05), (hub, -half), (0.6 * hub, 0), (hub, half), (0.02, half + 0.05)], 24, closed=True)
    )
    cross = rng.uniform(0, 0.8)
    for i, turn in enumerate(around(spokes)):
        side = 1 if i % 2 else -1
        lead = side * cross if i % 4 < 2 else -side * cross
        foot = turn @ turned((0, 0, 1), lead) @ np.array([0.9 * hub, 0, 0.9 * side * half])
        parts.append(rod(foot, turn @ (1 - 0.5 * tyre, 0, 0), 0.007, sides=6))
    return normalised(merged("spoked_wheel", parts))


def umbrella(rng: np.random.Generator) -> Mesh:
    """An open umbrella: a canopy of gores, ribs, struts and a stick with a crook or a knob."""
    ribs, deep, stick = int(rng.integers(6, 11)), rng.uniform(0.25, 0.45), rng.uniform(1, 1.4)
    share = np.linspace(0.03, 1, 9)
    curve = np.stack([share, deep * (1 - share**1.8)], axis=1)
    parts = [lathe([(0, deep - 0.012), *(curve - (0, 0.012)), *curve[::-1], (0, deep)], ribs)]
    rim = np.column_stack([curve[:, 0], np.zeros(len(curve)), curve[:, 1] - 0.012])
    runner = deep - rng.uniform(0.45, 0.65)
    for turn in around(ribs, -np.pi):
        parts.append(wire((rim * (1.01, 1, 1)) @ turn.T, 0.009, 6))
        parts.append(rod(turn @ (0, 0, runner), turn @ rim[4], 0.008, sides=6))
    parts.append(rod((0, 0, deep + 0.12), (0, 0, deep - stick), 0.016, sides=10))
    if rng.random() < 0.6:
        crook = arc(0.11, 0, -np.pi, 12) + (-0.11, 0)
        parts.append(wire(np.column_stack([crook[:, 0], np.zeros(12), crook[:, 1] + deep - stick]), 0.025, 10))
    else:
        parts.append(rod((0, 0, deep - stick - 0.03), (0, 0, deep - stick + 0.12), 0.04, 0.025, sides=16))
    parts.append(lathe([(0, runner - 0.04), (0.035, runner - 0.04), (0.035, runner + 0.04), (0, runner + 0.04)], 12))
    return normalised(merged("umbrella", parts))


def bolt(rng: np.random.Generator) -> Mesh:
    """A hexagon bolt with rings for a thread, and the nut on it."""
    length, shank = rng.uniform(1, 2.2), rng.uniform(0.2, 0.3)
    pitch, depth = rng.uniform(0.05, 0.09), 0.1 * shank
    threaded = length * rng.uniform(0.5, 0.9)
    profile = [(0.0, 0.0), (shank - depth, 0.0)]
    for z in np.arange(0.02, threaded, pitch):
        profile += [(shank - depth, z), (shank, z + pitch / 2)]
    profile += [(shank, length), (0, length)]
    head = placed(extruded(circle(1.8 * shank, 6), rng.uniform(0.9, 1.4) * shank), (0, 0, length - 0.01))
    inner = circle(shank, 24)
    outer = _on_hexagon(24) * 1.8 * shank
    nut = placed(
        extruded(outer, 1.5 * shank, inner), (0, 0, rng.uniform(0.1, 0.6) * threaded), rotation=turned((0, 0, 1), 0.4)
    )
    return normalised(merged("bolt", [lathe(profile, 32), head, nut]))


def _on_hexagon(count: int) -> NDArray[np.float64]:
    """Points of a regular hexagon of circumradius 1 at even angles; ``count`` is a multiple of six."""
    angle = np.arange(count) * 2 * np.pi / count
    reach = np.cos(np.pi / 6) / np.cos((angle % (np.pi / 3)) - np.pi / 6)
    points: NDArray[np.float64] = reach[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return points


def fan(rng: np.random.Generator) -> Mesh:
    """A fan on its stand: twisted blades behind a guard of wire rings and spokes."""
    blades, guard, tall = int(rng.integers(3, 7)), rng.uniform(0.02, 0.05), rng.uniform(0.6, 1.2)
    twist = rng.uniform(0.4, 0.9)
    r = np.linspace(0.08, 0.42, 8)
    parts = []
    pitch = twist * (1 - 0.4 * r / 0.42)
    half = 0.35 * r[:, None] * np.array([-1.0, 0.0, 1.0])
    sheet = np.stack(
        [np.broadcast_to(r[:, None], half.shape), half * np.cos(pitch)[:, None], half * np.sin(pitch)[:, None]], axis=2
    )
    uv = np.stack([np.broadcast_to(r[:, None], half.shape), half], axis=2)
    blade = grid_surface(sheet.transpose(1, 0, 2)[::-1], uv.transpose(1, 0, 2)[::-1])
    parts += [placed(blade, rotation=turn) for turn in around(blades)]
    parts.append(lathe([(0, -0.2), (0.1, -0.16), (0.1, 0.02), (0.05, 0.06), (0, 0.06)], 24))
    for side in (-1, 1):
        front = side * 0.12
        for radius in np.linspace(0.15, 0.5, int(rng.integers(4, 8))):
            z = front * (1 - 0.5 * (radius / 0.5) ** 2)
            parts.append(lathe(circle(0.006, 6) + (radius, z), 36, closed=True))
        for turn in around(int(rng.integers(8, 17))):
            parts.append(rod(turn @ (0.1, 0, front * 0.98), turn @ (0.5, 0, front / 2), 0.005, sides=6))
    parts.append(lathe(circle(guard / 2, 8) + (0.5, 0), 48, closed=True))
    head = placed(
        merged("head", parts), rotation=turned((1, 0, 0), np.pi / 2 + rng.uniform(-0.3, 0.3)), at=(0, -0.1, tall)
    )
    stand = [
        rod((0, 0.05, 0), (0, 0.05, tall), 0.025, sides=12),
        rod((0, 0.06, tall), (0, -0.02, tall), 0.05, sides=12),
    ]
    base = lathe([(0, 0), (0.28, 0), (0.28, 0.02), (0.04, 0.06), (0, 0.06)], 36)
    return normalised(merged("fan", [head, *stand, placed(base, (0, 0.05, 0))]))


def cable(rng: np.random.Generator) -> Mesh:
    """A flex that wanders through space, with a plug of two pins at its end."""
    knots = np.cumsum(rng.normal(0, (0.06, 0.22, 0.22), (int(rng.integers(7, 13)), 3)) + (0.35, 0, 0), axis=0)
    path = smooth(knots, 10)
    thick = rng.uniform(0.02, 0.035)
    heading = path[-1] - path[-2]
    heading /= np.linalg.norm(heading)
    tip = path[-1] + 0.2 * heading
    sideways = cross(heading, np.eye(3)[np.argmin(np.abs(heading))])
    sideways *= 0.04 / np.linalg.norm(sideways)
    pins = [
        rod(tip + side * sideways - 0.02 * heading, tip + side * sideways + 0.12 * heading, 0.012) for side in (-1, 1)
    ]
    return normalised(
        merged("cable", [wire(path, thick, 10), rod(path[-1] - 0.03 * heading, tip, 0.04, 0.08, sides=16), *pins])
    )


def flat_coil(rng: np.random.Generator) -> Mesh:
    """One long wire wound to a flat oblong spiral, as a stove's element is."""
    rounds, gap, long = int(rng.integers(2, 6)), rng.uniform(0.16, 0.24), rng.uniform(0.6, 1.4)
    curve = [np.array([[-long / 2, 0.5 * gap]])]
    for i in range(rounds):
        right, left = (0.5 + i) * gap, (1 + i) * gap
        curve.append(arc(right, np.pi / 2, -np.pi / 2, 10) + (long / 2, 0))
        curve.append(arc(left, -np.pi / 2, -1.5 * np.pi, 10) + (-long / 2, 0.5 * gap))
    flat = np.concatenate(curve)
    return normalised(
        merged("flat_coil", [wire(np.column_stack([flat, np.zeros(len(flat))]), rng.uniform(0.025, 0.04), 10)])
    )


def grating(rng: np.random.Generator) -> Mesh:
    """Slanted louvres in a frame, as in front of a vent."""
    width, height, depth = rng.uniform(0.7, 1.2), rng.uniform(0.7, 1.2), rng.uniform(0.05, 0.12)
    parts = [box((0.06, depth, height), (side * width / 2, 0, 0)) for side in (-1, 1)]
    parts += [box((width - 0.06, 0.98 * depth, 0.06), (0, 0, side * (height / 2 - 0.03))) for side in (-1, 1)]
    slant = turned((1, 0, 0), rng.uniform(-0.9, 0.9))
    count = int(rng.integers(6, 15))
    for z in (np.arange(count) + 0.5) / count * (height - 0.12) - height / 2 + 0.06:
        parts.append(placed(box((width - 0.05, 0.9 * depth, 0.008)), (0, 0, z), rotation=slant))
    return normalised(merged("grating", parts))


def hook_rail(rng: np.random.Generator) -> Mesh:
    """A board with hooks of bent wire in a row."""
    width = rng.uniform(0.9, 1.6)
    parts = [box((width, 0.04, rng.uniform(0.12, 0.25)), (0, 0, 0))]
    long, drop = rng.uniform(0.1, 0.2), rng.uniform(0.15, 0.3)
    for x in np.linspace(-0.5, 0.5, int(rng.integers(3, 9)) + 2)[1:-1] * width:
        curve = smooth(
            [(0, 0), (-long, -0.02), (-1.1 * long, -drop), (-1.7 * long, -1.1 * drop), (-2.1 * long, -0.5 * drop)], 6
        )
        parts.append(sweep(circle(0.014, 8), np.column_stack([np.full(len(curve), x), curve])))
    return normalised(merged("hook_rail", parts))
