"""Soft and round things: free-form lumps, figures, animals, cushions, hanging cloth and lying cloth.

All but cloth and curtains are surfaces of distance fields. Fields use only operations that all processors round alike
(no powers or exponentials), so that a model has the same vertices on all machines.
"""

from collections.abc import Callable, Sequence
from functools import reduce

import numpy as np

from semisynth_gl.geometry.mesh import Floats, Mesh, Parts, lengths, split_quads
from semisynth_gl.geometry.surfaces import grid_surface
from semisynth_gl.geometry.unwrap import project_uv

Field = Callable[[Floats], Floats]
"""Function from points, (N, 3), to signed distances from a surface, (N,), in model units, negative inside."""

Limb = tuple[Floats, float, Floats, float]
"""A round-ended rod, whose radius changes linearly: its start, (3,), the radius there, its end, the radius there."""

# Index offsets of the four corners of a grid square, in order around it. The four cells around an edge have them too.
_AROUND = ((0, 0), (1, 0), (1, 1), (0, 1))
# The ends of the edges along an axis of the grid: all nodes but the last, and all nodes but the first.
_ENDS = (slice(None, -1), slice(1, None))
# Minimum magnitude of a field's values at the nodes, in cells: values nearer to 0 would give degenerate triangles.
_CLEARANCE = 0.05


def blob(rng: np.random.Generator) -> Parts:
    """A free-form lump: merged balls of many sizes."""
    at, balls = np.zeros(3), list[Limb]()
    for radius in rng.uniform(0.22, 0.5, int(rng.integers(4, 8))):
        balls.append((at, radius, at, radius))
        towards = rng.normal(size=3)
        beside, *_ = balls[int(rng.integers(len(balls)))]
        at = beside + towards / lengths(towards) * radius * rng.uniform(0.9, 1.5)
    yield _body(balls, 0.14, 24, margin=0.06)


def figure(rng: np.random.Generator) -> Parts:
    """A person who stands, walks or waves."""
    tall = rng.uniform(0.9, 1.1)
    hip, neck = np.array([0, 0, 0.85 * tall]), np.array([0, rng.uniform(-0.04, 0.08), 1.42 * tall])
    limbs = [(hip, 0.15, neck - (0, 0, 0.08), 0.17), (neck, 0.07, neck + (0, 0, 0.12), 0.07)]
    head = neck + (0, 0.01, 0.2)
    limbs.append((head, 0.115, head + (0, 0, 0.05), 0.1))
    stride = rng.uniform(-0.3, 0.3)
    for side in (-1, 1):
        joint = hip + (side * 0.1, 0, 0)
        foot = joint + (side * 0.03, side * stride, -0.78 * tall)
        knee = (joint + foot) / 2 + (0, -abs(stride) * 0.3, 0)
        limbs += [(joint, 0.095, knee, 0.07), (knee, 0.07, foot, 0.055), (foot, 0.055, foot + (0, -0.14, -0.01), 0.045)]
        shoulder = neck + (side * 0.2, 0, -0.07)
        swing, spread = rng.uniform(-0.6, 0.9), rng.uniform(0.1, 0.9)
        upper = np.array([side * spread, -swing, -1.0])
        elbow = shoulder + upper / lengths(upper) * 0.29 * tall
        lower = np.array([side * rng.uniform(-0.2, 0.5), -swing - rng.uniform(0, 0.9), rng.uniform(-1, 0.8)])
        limbs += [(shoulder, 0.065, elbow, 0.05), (elbow, 0.05, elbow + lower / lengths(lower) * 0.28 * tall, 0.045)]
    yield _body(limbs, 0.07, 44)


def animal(rng: np.random.Generator) -> Parts:
    """A four-legged animal with short or long legs, neck, tail and ears."""
    long, leg, thick = rng.uniform(0.55, 0.95), rng.uniform(0.25, 0.7), rng.uniform(0.14, 0.22)
    rear, front = np.array([0, 0.5 * long, leg + thick]), np.array([0, -0.5 * long, leg + thick * 1.1])
    limbs = [(rear, thick, front, thick * rng.uniform(0.9, 1.2))]
    raised = np.array([0, -1, rng.uniform(0.1, 1.6)])
    head = front + raised / lengths(raised) * rng.uniform(0.25, 0.6)
    muzzle = head + (0, -rng.uniform(0.12, 0.25), -rng.uniform(0.0, 0.1))
    limbs += [(front, thick * 0.7, head, thick * 0.5), (head, thick * 0.62, muzzle, thick * 0.38)]
    tail = rear + (0, 0.15 + rng.uniform(0, 0.3), rng.uniform(-0.3, 0.35))
    limbs.append((rear + (0, thick * 0.7, thick * 0.4), thick * 0.35, tail, 0.045))
    ear = rng.uniform(0.1, 0.25)
    for side in (-1, 1):
        root = head + (side * thick * 0.4, 0.02, thick * 0.4)
        limbs.append((root, 0.055, root + (side * 0.3 * ear, 0.05, ear), 0.045))
        for body, step in ((rear, rng.uniform(-0.15, 0.15)), (front, rng.uniform(-0.15, 0.15))):
            joint = body + (side * thick * 0.6, 0, -thick * 0.3)
            foot = np.array([joint[0], joint[1] + side * step, thick * 0.35])
            limbs.append((joint, thick * 0.48, foot, thick * 0.34))
    yield _body(limbs, 0.08, 38)


def cushion(rng: np.random.Generator) -> Parts:
    """A dented cushion or sack with rounded corners."""
    half = np.array([1.0, rng.uniform(0.6, 1.0), rng.uniform(0.2, 0.45)])
    dents = rng.uniform(-0.7, 0.7, (3, 3)) * half
    depth = rng.uniform(0.05, 0.16, 3)

    def field(points: Floats) -> Floats:
        x, y, z = (points / half).T
        square = x * x + y * y
        # A pillow of x^4 + y^4, which is thinner towards its seams.
        hull = x * x * x * x + y * y * y * y + z * z * (1 + 0.35 * square) - 1
        squares = [((points - dent) * (points - dent)).sum(axis=1) for dent in dents]
        dented = sum(height * np.maximum(1 - far / 0.16, 0) for far, height in zip(squares, depth, strict=True))
        return np.asarray((hull + dented) * half[2] / 2)

    yield _surface_nets(field, -half * 1.15, half * 1.15, 24)


def curtain(rng: np.random.Generator) -> Parts:
    """Hanging cloth in folds, which become deeper downwards."""
    width, height = rng.uniform(0.8, 1.6), rng.uniform(1.2, 2.2)
    folds, deep = int(rng.integers(4, 11)), rng.uniform(0.02, 0.06)
    columns, rows = 10 * folds, 6
    share = np.linspace(0, 1, columns + 1)
    along = share * 2 * np.pi * folds + 0.8 * np.sin(2 * np.pi * share + rng.uniform(0, 6))
    down = np.linspace(0, 1, rows + 1)[:, None]
    depth = deep * np.sin(along) * (0.75 + 0.25 * down)
    sway = 0.01 * np.sin(3 * along + 2 * down)
    points = np.broadcast_arrays(width * (share - 0.5), depth + sway * deep, height * (1 - down))
    yield grid_surface(np.stack(points, axis=2)[::-1])


def cloth(rng: np.random.Generator) -> Parts:
    """Lying cloth: a sheet with a few long creases and ripples."""
    width, length = rng.uniform(0.8, 1.2), rng.uniform(0.8, 1.6)
    size = 28
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, size + 1) * width, np.linspace(-0.5, 0.5, size + 1) * length)
    z = np.zeros_like(x)
    for wave in rng.uniform(0.2, 0.7, int(rng.integers(3, 7))):
        turn, phase = rng.uniform(0, 2 * np.pi, 2)
        steep = rng.uniform(0.08, 0.2)
        crest = np.sin(2 * np.pi * (x * np.cos(turn) + y * np.sin(turn)) / wave + phase)
        z += steep * wave / (2 * np.pi) * crest
    yield grid_surface(np.stack([x, y, z], axis=2))


def _body(limbs: Sequence[Limb], softness: float, cells: int, margin: float = 0.03) -> Mesh:
    """Make a mesh of limbs whose joints are rounded over a distance of ``softness``.

    The grid extends beyond the limbs by ``margin`` and two cells.
    """
    points = np.array([end for start, _, stop, _ in limbs for end in (start, stop)])
    reach = np.array([[radius] for _, first, _, last in limbs for radius in (first, last)]) + margin
    low, high = (points - reach).min(axis=0), (points + reach).max(axis=0)
    two_cells = 2 * (high - low).max() / cells

    def smooth_minimum(a: Floats, b: Floats) -> Floats:  # by Quilez
        overlap = np.maximum(softness - np.abs(a - b), 0) / softness
        return np.minimum(a, b) - overlap * overlap * softness / 4

    def field(points: Floats) -> Floats:
        return reduce(smooth_minimum, (_distances(points, limb) for limb in limbs))

    return _surface_nets(field, low - two_cells, high + two_cells, cells)


def _distances(points: Floats, limb: Limb) -> Floats:
    """Return the signed distances, (N,), of points from a limb; a limb between equal points is a ball."""
    start, start_radius, end, end_radius = limb
    along, away = end - start, points - start
    square = float((along * along).sum())
    share = np.clip((away * along).sum(axis=1) / square, 0, 1) if square > 0 else np.zeros(len(points))
    off = away - share[:, None] * along
    return np.asarray(lengths(off) - (start_radius + (end_radius - start_radius) * share))


def _surface_nets(field: Field, low: Floats, high: Floats, cells: int) -> Mesh:
    """Make a closed mesh of the surface where a field is 0, by surface nets: one vertex in each cell on the surface.

    The grid from ``low`` to ``high``, (3,) each, has ``cells`` along its longest side; at its border the field must be
    positive. UV is by `project_uv`, and triangles are anticlockwise seen from outside.
    """
    step = float((high - low).max()) / cells
    counts = np.ceil((high - low) / step).astype(np.int64) + 1
    nodes = np.stack(np.meshgrid(*(np.arange(count) for count in counts), indexing="ij"), axis=-1)
    values = field(low + nodes.reshape(-1, 3) * step).reshape(counts) / step
    values = _without_pinches(np.where(values < 0, np.minimum(values, -_CLEARANCE), np.maximum(values, _CLEARANCE)))
    inside = values < 0

    # A cell's vertex is the mean of the points where the surface crosses the cell's edges.
    sums, crossings = np.zeros((*(counts - 1), 3)), np.zeros(counts - 1)
    quads = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        first, last = (tuple(end if k == axis else slice(None) for k in range(3)) for end in _ENDS)
        crossed = np.argwhere(inside[first] != inside[last])
        begin, end = values[first][tuple(crossed.T)], values[last][tuple(crossed.T)]
        crossing = crossed.astype(np.float64)
        crossing[:, axis] += begin / (begin - end)
        cells_around = []
        for du, dv in _AROUND:
            cell = crossed.copy()
            cell[:, [u, v]] -= (1 - du, 1 - dv)
            np.add.at(sums, tuple(cell.T), crossing)
            np.add.at(crossings, tuple(cell.T), 1)
            cells_around.append(np.ravel_multi_index(tuple(cell.T), tuple(counts - 1)))
        quad = np.stack(cells_around, axis=1)
        quads.append(np.where((begin < 0)[:, None], quad, quad[:, ::-1]))
    used, corner = np.unique(np.concatenate(quads), return_inverse=True)
    positions = low + (sums.reshape(-1, 3)[used] / crossings.reshape(-1)[used, None]) * step
    return project_uv("implicit", positions, split_quads(corner.reshape(-1, 4)))


def _without_pinches(values: Floats) -> Floats:
    """Fill squares of the grid that have two opposite corners inside the surface and two outside.

    Otherwise four triangles would share one edge, and none of them would have a neighbour there.
    """
    filled = values.copy()
    while True:
        before = filled.copy()
        for first, second in ((0, 1), (1, 2), (2, 0)):
            squares = np.moveaxis(filled, (first, second), (0, 1))
            a, b, c, d = (squares[_ENDS[i], _ENDS[j]] for i, j in _AROUND)  # views
            for inner_1, inner_2, outer_1, outer_2 in ((a, c, b, d), (b, d, a, c)):
                pinched = (inner_1 < 0) & (inner_2 < 0) & (outer_1 >= 0) & (outer_2 >= 0)
                nearer = outer_1 <= outer_2
                outer_1[pinched & nearer] = -_CLEARANCE
                outer_2[pinched & ~nearer] = -_CLEARANCE
        if np.array_equal(filled, before):
            return filled
