"""Objects in streets: cars, houses, signs, street lamps, benches, bicycles, bins. Each faces -y."""

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from semisynth_gl.geometry.mesh import Floats, Mesh, Parts
from semisynth_gl.geometry.parts import circle, lift, placed, rectangle, rod, spline, wire
from semisynth_gl.geometry.rotations import about_x, about_y
from semisynth_gl.geometry.surfaces import box, extruded, lathe


def _extruded_along_x(outline: ArrayLike, width: float) -> Mesh:
    """Extrude a side view, (P, 2) points in y and z, from x = -width / 2 to width / 2."""
    side = np.asarray(outline, np.float64)
    middle = (side.min(axis=0) + side.max(axis=0)) / 2
    # This rotation maps the axes x, y, z of the extrusion to y, z, x.
    turn = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])
    return placed(extruded(side - middle, width), (-width / 2, *middle), rotation=turn)


def _wheel(radius: float, width: float, at: ArrayLike) -> Mesh:
    half = [(0, 0.1 * width), (0.6 * radius, 0.2 * width), (0.68 * radius, 0), (radius, 0.1 * width)]
    profile = np.array([*half, *((r, width - z) for r, z in half[::-1])]) - (0, width / 2)
    return placed(lathe(profile, 20), at, rotation=about_y(np.pi / 2))


def car(rng: np.random.Generator) -> Parts:
    """A car, a van or a small lorry: body, cabin, wheels, mirrors, bumpers."""
    long, wide, radius = rng.uniform(3.6, 4.8), rng.uniform(1.65, 1.85), rng.uniform(0.29, 0.34)
    sill, belt, roof = 0.7 * radius, rng.uniform(0.8, 1.0), rng.uniform(1.4, 1.55)
    front, rear = -long / 2, long / 2
    bonnet, slope = rng.uniform(0.2, 0.32) * long, rng.uniform(0.05, 0.16) * long
    boot = (0.0, rng.uniform(0.06, 0.18))[int(rng.integers(2))] * long
    if rng.random() < 0.3:
        bonnet, boot, roof = 0.14 * long, 0.0, rng.uniform(1.9, 2.4)
    tail = spline([(rear, sill), (rear + 0.02, 0.65 * belt), (rear - 0.04, belt)], 3)
    nose = spline([(front + bonnet, belt), (front + 0.12, 0.82 * belt), (front - 0.02, 0.6 * belt), (front, sill)], 3)
    yield _extruded_along_x([*tail, *nose], wide)
    top = (front + bonnet + slope, rear - boot - 0.5 * slope)
    glass = [(rear - boot - 0.05, belt - 0.03), (top[1], roof), (top[0], roof), (front + bonnet, belt - 0.03)]
    yield _extruded_along_x(glass, 0.88 * wide)
    for x, y in product((-1, 1), (-1.05, 0.95)):
        yield _wheel(radius, 0.2, (x * (wide / 2 - 0.06), y * 0.31 * long, radius))
    yield from [box((0.24, 0.1, 0.14), (x * (wide / 2 + 0.06), front + bonnet + 0.25, belt - 0.05)) for x in (-1, 1)]
    yield from [box((0.9 * wide, 0.1, 0.16), (0, y, sill + 0.12)) for y in (front - 0.03, rear + 0.04)]
    if rng.random() < 0.25:
        first, last = top[0] + 0.1, top[1] - 0.1
        for side in (-0.3 * wide, 0.3 * wide):
            yield rod((side, first, roof + 0.02), (side, last, roof + 0.02), 0.04)
        bars = np.linspace(first, last, 5)[1:-1]
        yield from [rod((-0.38 * wide, y, roof + 0.07), (0.38 * wide, y, roof + 0.07), 0.03) for y in bars]


def house(rng: np.random.Generator) -> Parts:
    """A house: walls, windows with frames and sills, a door with steps, a gabled or flat roof, a chimney."""
    storeys, storey = int(rng.integers(1, 5)), rng.uniform(2.6, 3.1)
    wide, deep = rng.uniform(6, 14), rng.uniform(6, 10)
    high = storeys * storey
    if rng.random() < 0.6:
        rise, over = rng.uniform(0.25, 0.55) * deep, 0.35
        gable = [(-deep / 2 - over, high), (deep / 2 + over, high), (0, high + rise)]
        yield _extruded_along_x(gable, wide + 2 * over)
        yield box((0.7, 0.7, rise), (rng.uniform(-0.35, 0.35) * wide, 0.2 * deep, high + 0.75 * rise))
        # The walls end inside the roof, below its slopes.
        top = high + 0.5 * rise * over / (deep / 2 + over)
    else:
        yield box((wide + 0.4, deep + 0.4, 0.3), (0, 0, high + 0.15))
        top = high + 0.15
    yield box((wide, deep, top), (0, 0, top / 2))
    columns = max(2, int(wide / rng.uniform(2, 3)))
    window = np.array([rng.uniform(0.8, 1.3), rng.uniform(1.1, 1.6)])
    door = int(rng.integers(columns))
    for row, column, side in product(range(storeys), range(columns), (-1, 1)):
        x = ((column + 0.5) / columns - 0.5) * 0.94 * wide
        if (row, column, side) == (0, door, -1):
            yield box((1.1, 0.4, 2.1), (x, -deep / 2, 1.35))
            yield from [box((1.5 + 0.2 * k, 0.4 + 0.8 * k, 0.5 - 0.16 * k), (x, -deep / 2, 0)) for k in (1, 2)]
        else:
            yield from _window(window, (x, side * deep / 2, (row + 0.55) * storey))


def _window(size: Floats, at: Sequence[float]) -> Parts:
    """Yield frame, bars and sill of a window of width and height ``size``, (2,), in a wall perpendicular to y."""
    wide, high = size
    rim = rectangle(2, 2) * size / 2
    # The extrusion along z becomes one along y. Half of it is in front of the wall's face.
    frame = placed(extruded(rim + 0.09 * np.sign(rim), 0.32, rim), (0, 0.16, 0), rotation=about_x(np.pi / 2))
    bars = [box((0.08, 0.22, high + 0.1)), box((wide + 0.1, 0.12, 0.08), (0, 0, 0.15 * high))]
    sill = box((wide + 0.4, 0.5, 0.1), (0, 0, -high / 2 - 0.09))
    yield from [placed(part, at) for part in (frame, *bars, sill)]


def road_sign(rng: np.random.Generator) -> Parts:
    """One or two signs on a post: round, triangular, octagonal or square."""
    post = rng.uniform(2.0, 2.8)
    yield rod((0, 0, 0.02), (0, 0, post), 0.035, sides=12)
    yield lathe([(0, 0), (0.12, 0), (0.12, 0.04), (0, 0.08)], 16)
    level = post
    for _ in range(int(rng.integers(1, 3))):
        size = rng.uniform(0.3, 0.42)
        corners = (36, 3, 8, 4)[int(rng.integers(4))]
        plate = extruded(circle(size, corners, np.pi / 2 if corners == 3 else np.pi / corners), 0.04)
        # The back of the plate is inside the post.
        yield placed(plate, (0, -0.01, level - size), rotation=about_x(np.pi / 2))
        level -= 2 * size + 0.06


def street_lamp(rng: np.random.Generator) -> Parts:
    """A tall lamp post with one arm or two."""
    high, reach = rng.uniform(4.5, 8), rng.uniform(0.8, 2)
    yield from (rod((0, 0, 0), (0, 0, 0.9), 0.11, sides=12), rod((0, 0, 0.85), (0, 0, high), 0.07, 0.05, 12))
    for side in (-1, 1)[: int(rng.integers(1, 3))]:
        arm = [(0.02 * side, 0, high - 0.3), (0.3 * side * reach, 0, high + 0.2), (side * reach, 0, high + 0.3)]
        yield wire(spline(arm, 5), 0.035)
        yield box((0.6, 0.22, 0.12), (side * (reach + 0.2), 0, high + 0.27))


def bench(rng: np.random.Generator) -> Parts:
    """A park bench of planks on two frames."""
    long, seat, back = rng.uniform(1.3, 2.2), rng.uniform(0.4, 0.48), rng.uniform(0.35, 0.5)
    yield from [box((long, 0.085, 0.035), (0, y, seat)) for y in np.linspace(-0.22, 0.2, int(rng.integers(3, 6)))]
    lean = rng.uniform(0.1, 0.25)
    for share in np.linspace(0.25, 1, int(rng.integers(2, 5))):
        plank = placed(box((long, 0.03, 0.09)), rotation=about_x(-lean))
        yield placed(plank, (0, 0.24 + share * back * lean, seat + share * back))
    for x in (-0.4 * long, 0.4 * long):
        # All ends are inside planks or other rods.
        yield from [rod((x, y, 0), (x, y, seat - 0.005), 0.025) for y in (-0.21, 0.2)]
        yield rod((x, -0.21, seat - 0.025), (x, 0.2, seat - 0.025), 0.018)
        yield rod((x, 0.2, seat - 0.01), (x, 0.25 + back * lean, seat + back), 0.022)
        if rng.random() < 0.5:
            rest = [(x, -0.21, seat - 0.01), (x, -0.21, seat + 0.2), (x, 0.21 + 0.5 * lean * back, seat + 0.22)]
            yield wire(spline(rest, 4), 0.018)


def bicycle(rng: np.random.Generator) -> Parts:
    """A bicycle: wheels with spokes, frame, fork, handlebar, saddle."""
    radius, base, tube = rng.uniform(0.3, 0.36), rng.uniform(0.98, 1.1), 0.018
    rear, front = np.array([0, base / 2, radius]), np.array([0, -base / 2, radius])
    for hub in (rear, front):
        yield wire(lift(circle(radius - 0.02, 32), "yz") + hub, 0.02, 6, closed=True)
        yield rod(hub - (0.05, 0, 0), hub + (0.05, 0, 0), 0.025)
        for spoke in lift(circle(radius - 0.02, 12, rng.uniform(0, 1)), "yz"):
            yield rod(hub + 0.04 * spoke, hub + spoke, 0.004, sides=4)
    crank, seat, head = np.array([0, 0.08, 0.28]), np.array([0, 0.24, 0.75]), np.array([0, -0.33, 0.8])
    seat[2] += rng.uniform(0, 0.15)
    frame = [(crank, seat, 1.0), (seat - (0, 0, 0.05), head, 1.05), (crank, head - (0, 0, 0.1), 1.2)]
    frame += [(rear, crank, 0.8), (rear, seat - (0, 0, 0.08), 0.7)]
    yield from [rod(a, b, thick * tube) for a, b, thick in frame]
    yield from [rod(front + (x, 0, 0), head + (0.4 * x, 0, -0.12), 0.013) for x in (-0.045, 0.045)]
    yield rod(head - (0, 0, 0.14), head + (0, -0.045, 0.12), 0.9 * tube)
    yield box((0.14, 0.26, 0.06), seat + (0, 0.03, 0.02))
    bar = spline([(-0.28, -0.22, 0.98), (-0.15, -0.36, 0.96), (0.15, -0.36, 0.96), (0.28, -0.22, 0.98)], 4)
    yield wire(bar - (0, 0, 0.04), 0.014)


def bin(rng: np.random.Generator) -> Parts:  # noqa: A001 - the kind's name is the thing's
    """A wheeled bin with an open or shut lid."""
    wide, deep, high = rng.uniform(0.45, 0.6), rng.uniform(0.5, 0.75), rng.uniform(0.85, 1.1)
    side = [(-0.42 * deep, 0.08), (0.42 * deep, 0.08), (0.5 * deep, high), (-0.5 * deep, high)]
    yield _extruded_along_x(side, wide)
    # The hinge is inside the bin, so a shut lid overlaps the bin there.
    lid = placed(box((wide + 0.06, deep + 0.1, 0.05)), (0, -deep / 2, 0.01))
    opened = about_x(-rng.uniform(0.9, 1.9) if rng.random() < 0.3 else -0.02)
    yield placed(lid, (0, deep / 2, high), rotation=opened)
    yield from [_wheel(0.11, 0.06, (x * (wide / 2 + 0.02), 0.4 * deep, 0.11)) for x in (-1, 1)]
    handle = np.array([wide / 2, deep / 2 + 0.06, high - 0.12])
    yield from [rod((x * 0.7 * handle[0], 0.45 * deep, handle[2]), handle * (x * 0.7, 1, 1), 0.016) for x in (-1, 1)]
    yield rod(handle * (-1, 1, 1), handle, 0.022)
