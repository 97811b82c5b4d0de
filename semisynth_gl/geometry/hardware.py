"""Things from the workshop: gears, springs, chains, wheels, umbrellas, cables, knots."""

import numpy as np

from semisynth_gl.geometry.mesh import Parts, cross, least_aligned_axis, merged, unit
from semisynth_gl.geometry.parts import arc, circle, from_polar, lift, placed, rod, spline, wire
from semisynth_gl.geometry.rotations import about_x, about_y, about_z, even_turns
from semisynth_gl.geometry.surfaces import box, extruded, grid_surface, lathe


def gear(rng: np.random.Generator) -> Parts:
    """A toothed ring, or a toothed ring with spokes and a hub."""
    teeth, root, thick = int(rng.integers(8, 28)), rng.uniform(0.75, 0.88), rng.uniform(0.1, 0.4)
    pitch = 2 * np.pi / teeth
    corners = (np.array([0.1, 0.4, 0.55, 0.85]) * pitch + np.arange(teeth)[:, None] * pitch).ravel()
    radius = np.tile([root, 1, 1, root], teeth)
    directions = from_polar(1, corners)
    if rng.random() < 0.5:
        yield extruded(directions * radius[:, None], thick, directions * rng.uniform(0.15, 0.6))
        return
    inner, hub = rng.uniform(0.75, 0.88) * root, rng.uniform(0.2, 0.3)
    yield extruded(directions * radius[:, None], thick, directions * inner)
    yield placed(extruded(circle(hub, 32), 1.4 * thick, circle(0.5 * hub, 32)), (0, 0, -0.2 * thick))
    for turn in even_turns(int(rng.integers(3, 7))):
        spoke = box((inner - hub + 0.06, rng.uniform(0.08, 0.14), 0.6 * thick), ((inner + hub) / 2, 0, thick / 2))
        yield placed(spoke, rotation=turn)


def torus_knot(rng: np.random.Generator) -> Parts:
    """A closed tube that winds around a torus as a knot."""
    p, q = ((2, 3), (3, 2), (2, 5), (3, 4), (3, 5), (5, 2))[int(rng.integers(6))]
    minor = rng.uniform(0.3, 0.45)
    t = np.linspace(0, 2 * np.pi, 48 * max(p, q), endpoint=False)
    path = np.column_stack([from_polar(1 + minor * np.cos(q * t), p * t), minor * np.sin(q * t)])
    yield wire(path, rng.uniform(0.05, 0.09), 12, closed=True)


def spring(rng: np.random.Generator) -> Parts:
    """A coil of wire: a cylindrical or conical helix."""
    turns, radius, pitch = rng.uniform(4, 11), rng.uniform(0.3, 0.6), rng.uniform(0.12, 0.25)
    t = np.linspace(0, turns, int(24 * turns))
    wide = radius * (1 + rng.choice([0.0, rng.uniform(-0.6, 0.6)]) * t / turns)
    path = np.column_stack([from_polar(wide, 2 * np.pi * t), pitch * t])
    yield wire(path, rng.uniform(0.02, 0.045), 10)


def chain(rng: np.random.Generator) -> Parts:
    """Linked rings along an arc."""
    links, bar = int(rng.integers(5, 13)), rng.uniform(0.03, 0.045)
    bow, straight = rng.uniform(0.2, 0.25), rng.uniform(0.15, 0.4)
    ends = ((-0.5, 0.5, straight / 2), (0.5, 1.5, -straight / 2))
    oval = np.concatenate([arc(bow, start * np.pi, stop * np.pi, 11) + (x, 0) for start, stop, x in ends])
    link = wire(lift(oval, "xy"), bar, 10, closed=True)
    reach, sag = straight + 2 * bow - 2 * bar, rng.uniform(-0.35, 0.35)
    at = np.zeros(3)
    for i in range(links):
        tilt = about_y(sag * (i - links / 2))
        rotation = tilt @ about_x((i % 2) * np.pi / 2 + 0.3)
        yield placed(link, at + tilt @ (reach / 2, 0, 0), rotation=rotation)
        at = at + tilt @ (reach, 0, 0)


def spoked_wheel(rng: np.random.Generator) -> Parts:
    """A bicycle wheel: tyre, hub and crossing spokes of wire."""
    spokes, tyre = 2 * int(rng.integers(8, 19)), rng.uniform(0.03, 0.08)
    hub, half, most_lead = rng.uniform(0.05, 0.1), rng.uniform(0.06, 0.12), rng.uniform(0, 0.8)
    bobbin = [(0.02, -half - 0.05), (hub, -half), (0.6 * hub, 0), (hub, half), (0.02, half + 0.05)]
    yield from (lathe(circle(tyre, 12) + (1, 0), 64, closed=True), lathe(bobbin, 24, closed=True))
    for i, turn in enumerate(even_turns(spokes)):
        side = 1 if i % 2 else -1
        lead = side * most_lead if i % 4 < 2 else -side * most_lead
        foot = turn @ about_z(lead) @ np.array([0.9 * hub, 0, 0.9 * side * half])
        yield rod(foot, turn @ (1 - 0.5 * tyre, 0, 0), 0.007, sides=6)


def umbrella(rng: np.random.Generator) -> Parts:
    """An open umbrella: canopy, ribs, struts, and a stick with a crook or a knob."""
    ribs, deep, stick = int(rng.integers(6, 11)), rng.uniform(0.25, 0.45), rng.uniform(1, 1.4)
    share = np.linspace(0.03, 1, 9)
    curve = np.stack([share, deep * (1 - share**1.8)], axis=1)
    yield lathe([(0, deep - 0.012), *(curve - (0, 0.012)), *curve[::-1], (0, deep)], ribs)
    rim = lift(curve - (0, 0.012), "xz")
    runner = deep - rng.uniform(0.45, 0.65)
    for turn in even_turns(ribs, -np.pi):
        yield wire((rim * (1.01, 1, 1)) @ turn.T, 0.009, 6)
        yield rod(turn @ (0, 0, runner), turn @ rim[4], 0.008, sides=6)
    yield rod((0, 0, deep + 0.12), (0, 0, deep - stick), 0.016, sides=10)
    if rng.random() < 0.6:
        crook = arc(0.11, 0, -np.pi, 12) + (-0.11, 0)
        yield wire(lift(crook + (0, deep) - (0, stick), "xz"), 0.025, 10)
    else:
        yield rod((0, 0, deep - stick - 0.03), (0, 0, deep - stick + 0.12), 0.04, 0.025, sides=16)
    yield lathe([(0, runner - 0.04), (0.035, runner - 0.04), (0.035, runner + 0.04), (0, runner + 0.04)], 12)


def bolt(rng: np.random.Generator) -> Parts:
    """A hexagon bolt with a nut; rings imitate the thread."""
    length, shank = rng.uniform(1, 2.2), rng.uniform(0.2, 0.3)
    pitch, depth = rng.uniform(0.05, 0.09), 0.1 * shank
    threaded = length * rng.uniform(0.5, 0.9)
    profile = [(0.0, 0.0), (shank - depth, 0.0)]
    for z in np.arange(0.02, threaded, pitch):
        profile += [(shank - depth, z), (shank, z + pitch / 2)]
    profile += [(shank, length), (0, length)]
    yield lathe(profile, 32)
    yield placed(extruded(circle(1.8 * shank, 6), rng.uniform(0.9, 1.4) * shank), (0, 0, length - 0.01))
    angle = np.arange(24) * 2 * np.pi / 24
    # A hexagon with as many points as the round hole.
    hexagon = from_polar(np.cos(np.pi / 6) / np.cos((angle % (np.pi / 3)) - np.pi / 6), angle)
    nut = extruded(hexagon * 1.8 * shank, 1.5 * shank, circle(shank, 24))
    yield placed(nut, (0, 0, rng.uniform(0.1, 0.6) * threaded), rotation=about_z(0.4))


def fan(rng: np.random.Generator) -> Parts:
    """A fan on a stand: twisted blades in a guard of wire rings and spokes."""
    blades, guard, tall = int(rng.integers(3, 7)), rng.uniform(0.02, 0.05), rng.uniform(0.6, 1.2)
    twist = rng.uniform(0.4, 0.9)
    r = np.linspace(0.08, 0.42, 8)
    pitch = twist * (1 - 0.4 * r / 0.42)
    half = 0.35 * r * np.array([[1.0], [0.0], [-1.0]])
    along = np.broadcast_to(r, half.shape)
    sheet = np.stack([along, half * np.cos(pitch), half * np.sin(pitch)], axis=2)
    blade = grid_surface(sheet, np.stack([along, half], axis=2))
    parts = [placed(blade, rotation=turn) for turn in even_turns(blades)]
    parts.append(lathe([(0, -0.2), (0.1, -0.16), (0.1, 0.02), (0.05, 0.06), (0, 0.06)], 24))
    for side in (-1, 1):
        front = side * 0.12
        for radius in np.linspace(0.15, 0.5, int(rng.integers(4, 8))):
            z = front * (1 - 0.5 * (radius / 0.5) ** 2)
            parts.append(lathe(circle(0.006, 6) + (radius, z), 36, closed=True))
        turns = even_turns(int(rng.integers(8, 17)))
        parts += [rod(turn @ (0.1, 0, front * 0.98), turn @ (0.5, 0, front / 2), 0.005, sides=6) for turn in turns]
    parts.append(lathe(circle(guard / 2, 8) + (0.5, 0), 48, closed=True))
    tilt = about_x(np.pi / 2 + rng.uniform(-0.3, 0.3))
    yield placed(merged("head", parts), (0, -0.1, tall), rotation=tilt)
    yield rod((0, 0.05, 0), (0, 0.05, tall), 0.025, sides=12)
    yield rod((0, 0.06, tall), (0, -0.02, tall), 0.05, sides=12)
    yield placed(lathe([(0, 0), (0.28, 0), (0.28, 0.02), (0.04, 0.06), (0, 0.06)], 36), (0, 0.05, 0))


def cable(rng: np.random.Generator) -> Parts:
    """A cable along a random curve, with a two-pin plug at its end."""
    knots = np.cumsum(rng.normal(0, (0.06, 0.22, 0.22), (int(rng.integers(7, 13)), 3)) + (0.35, 0, 0), axis=0)
    path = spline(knots, 10)
    thick = rng.uniform(0.02, 0.035)
    heading = unit(path[-1] - path[-2])
    tip = path[-1] + 0.2 * heading
    sideways = cross(heading, least_aligned_axis(heading))
    sideways *= 0.04 / np.linalg.norm(sideways)
    yield from (wire(path, thick, 10), rod(path[-1] - 0.03 * heading, tip, 0.04, 0.08, sides=16))
    for foot in (tip - sideways, tip + sideways):
        yield rod(foot - 0.02 * heading, foot + 0.12 * heading, 0.012)


def flat_coil(rng: np.random.Generator) -> Parts:
    """A wire wound into a flat oblong spiral, like the heating element of a stove."""
    rounds, gap, long = int(rng.integers(2, 6)), rng.uniform(0.16, 0.24), rng.uniform(0.6, 1.4)
    curve = [np.array([[-long / 2, 0.5 * gap]])]
    for i in range(rounds):
        right, left = (0.5 + i) * gap, (1 + i) * gap
        curve.append(arc(right, np.pi / 2, -np.pi / 2, 10) + (long / 2, 0))
        curve.append(arc(left, -np.pi / 2, -1.5 * np.pi, 10) + (-long / 2, 0.5 * gap))
    yield wire(lift(np.concatenate(curve), "xy"), rng.uniform(0.025, 0.04), 10)


def grating(rng: np.random.Generator) -> Parts:
    """Slanted louvres in a frame, as on a vent."""
    width, height, depth = rng.uniform(0.7, 1.2), rng.uniform(0.7, 1.2), rng.uniform(0.05, 0.12)
    yield from [box((0.06, depth, height), (side * width / 2, 0, 0)) for side in (-1, 1)]
    yield from [box((width - 0.06, 0.98 * depth, 0.06), (0, 0, side * (height / 2 - 0.03))) for side in (-1, 1)]
    slant = about_x(rng.uniform(-0.9, 0.9))
    count = int(rng.integers(6, 15))
    for z in (np.arange(count) + 0.5) / count * (height - 0.12) - height / 2 + 0.06:
        yield placed(box((width - 0.05, 0.9 * depth, 0.008)), (0, 0, z), rotation=slant)


def hook_rail(rng: np.random.Generator) -> Parts:
    """A board with a row of hooks of bent wire."""
    width = rng.uniform(0.9, 1.6)
    yield box((width, 0.04, rng.uniform(0.12, 0.25)), (0, 0, 0))
    long, drop = rng.uniform(0.1, 0.2), rng.uniform(0.15, 0.3)
    for x in np.linspace(-0.5, 0.5, int(rng.integers(3, 9)) + 2)[1:-1] * width:
        tip = [(-1.1 * long, -drop), (-1.7 * long, -1.1 * drop), (-2.1 * long, -0.5 * drop)]
        curve = spline([(0, 0), (-long, -0.02), *tip], 6)
        yield wire(lift(curve, "yz") + (x, 0, 0), 0.014)
