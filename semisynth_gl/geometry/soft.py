"""Soft and round things: free-form lumps, figures, animals, cushions, hanging cloth and lying cloth.

Solid ones are surfaces of distance fields: balls and limbs that flow into each other, cut out as a mesh. Fields use
only operations that every processor rounds alike (no powers or exponentials), so that a model has the same vertices on
all machines.
"""

from collections.abc import Callable, Sequence
from functools import reduce

import numpy as np
from numpy.typing import ArrayLike

from semisynth_gl.geometry.mesh import Floats, Mesh, Parts, halved, lengths
from semisynth_gl.geometry.surfaces import grid_surface
from semisynth_gl.geometry.unwrap import project_uv

Field = Callable[[Floats], Floats]
"""Function from points, (N, 3), to signed distances from a surface, (N,), in model units, negative inside."""

# The four cells around an edge of the grid, in turn: whether each lies behind the edge along the other two axes.
_AROUND = ((0, 0), (1, 0), (1, 1), (0, 1))
# Values nearer to zero than this, in cells, are moved away from it, since triangles would shrink to nothing.
_CLEARANCE = 0.05
_FIRST, _LAST = slice(None, -1), slice(1, None)


def blob(rng: np.random.Generator) -> Parts:
    """A free-form lump: merged balls of many sizes."""
    count = int(rng.integers(4, 8))
    at, parts = np.zeros(3), list[Field]()
    points, radii = [], rng.uniform(0.22, 0.5, count)
    for radius in radii:
        parts.append(_limb(at, at, radius))
        points.append(at)
        towards = rng.normal(size=3)
        at = points[int(rng.integers(len(points)))] + towards / lengths(towards) * radius * rng.uniform(0.9, 1.5)
    yield _cut(_blended(parts, 0.14), np.array(points), radii + 0.06, 24)


def figure(rng: np.random.Generator) -> Parts:
    """A person who stands, walks or waves."""
    tall = rng.uniform(0.9, 1.1)
    hip, neck = np.array([0, 0, 0.85 * tall]), np.array([0, rng.uniform(-0.04, 0.08), 1.42 * tall])
    bones = [(hip, 0.15, neck - (0, 0, 0.08), 0.17), (neck, 0.07, neck + (0, 0, 0.12), 0.07)]
    head = neck + (0, 0.01, 0.2)
    bones.append((head, 0.115, head + (0, 0, 0.05), 0.1))
    stride = rng.uniform(-0.3, 0.3)
    for side in (-1, 1):
        joint = hip + (side * 0.1, 0, 0)
        foot = joint + (side * 0.03, side * stride, -0.78 * tall)
        knee = (joint + foot) / 2 + (0, -abs(stride) * 0.3, 0)
        bones += [(joint, 0.095, knee, 0.07), (knee, 0.07, foot, 0.055), (foot, 0.055, foot + (0, -0.14, -0.01), 0.045)]
        shoulder = neck + (side * 0.2, 0, -0.07)
        swing, spread = rng.uniform(-0.6, 0.9), rng.uniform(0.1, 0.9)
        upper = np.array([side * spread, -swing, -1.0])
        elbow = shoulder + upper / lengths(upper) * 0.29 * tall
        lower = np.array([side * rng.uniform(-0.2, 0.5), -swing - rng.uniform(0, 0.9), rng.uniform(-1, 0.8)])
        bones += [(shoulder, 0.065, elbow, 0.05), (elbow, 0.05, elbow + lower / lengths(lower) * 0.28 * tall, 0.045)]
    yield _body(bones, 0.07, 44)


def animal(rng: np.random.Generator) -> Parts:
    """A four-legged animal: short or long in its legs, neck, tail and ears."""
    long, leg, thick = rng.uniform(0.55, 0.95), rng.uniform(0.25, 0.7), rng.uniform(0.14, 0.22)
    rear, front = np.array([0, 0.5 * long, leg + thick]), np.array([0, -0.5 * long, leg + thick * 1.1])
    bones = [(rear, thick, front, thick * rng.uniform(0.9, 1.2))]
    raised = np.array([0, -1, rng.uniform(0.1, 1.6)])
    head = front + raised / lengths(raised) * rng.uniform(0.25, 0.6)
    muzzle = head + (0, -rng.uniform(0.12, 0.25), -rng.uniform(0.0, 0.1))
    bones += [(front, thick * 0.7, head, thick * 0.5), (head, thick * 0.62, muzzle, thick * 0.38)]
    tail = rear + (0, 0.15 + rng.uniform(0, 0.3), rng.uniform(-0.3, 0.35))
    bones.append((rear + (0, thick * 0.7, thick * 0.4), thick * 0.35, tail, 0.045))
    ear = rng.uniform(0.1, 0.25)
    for side in (-1, 1):
        root = head + (side * thick * 0.4, 0.02, thick * 0.4)
        bones.append((root, 0.055, root + (side * 0.3 * ear, 0.05, ear), 0.045))
        for body, step in ((rear, rng.uniform(-0.15, 0.15)), (front, rng.uniform(-0.15, 0.15))):
            joint = body + (side * thick * 0.6, 0, -thick * 0.3)
            foot = np.array([joint[0], joint[1] + side * step, thick * 0.35])
            bones.append((joint, thick * 0.48, foot, thick * 0.34))
    yield _body(bones, 0.08, 38)


def cushion(rng: np.random.Generator) -> Parts:
    """A stuffed cushion or sack with rounded corners, dented."""
    half = np.array([1.0, rng.uniform(0.6, 1.0), rng.uniform(0.2, 0.45)])
    dents = rng.uniform(-0.7, 0.7, (3, 3)) * half
    depth = rng.uniform(0.05, 0.16, 3)

    def field(points: Floats) -> Floats:
        x, y, z = (points / half).T
        square = x * x + y * y
        # a pillow of x^4 + y^4, whose thickness falls towards its seams
        hull = x * x * x * x + y * y * y * y + z * z * (1 + 0.35 * square) - 1
        squares = [((points - dent) * (points - dent)).sum(axis=1) for dent in dents]
        dented = sum(height * np.maximum(1 - far / 0.16, 0) for far, height in zip(squares, depth, strict=True))
        return np.asarray((hull + dented) * half[2] / 2)

    yield _surface_of(field, -half * 1.15, half * 1.15, 24)


def curtain(rng: np.random.Generator) -> Parts:
    """Hanging cloth in folds, which widen downwards."""
    width, height = rng.uniform(0.8, 1.6), rng.uniform(1.2, 2.2)
    folds, deep = int(rng.integers(4, 11)), rng.uniform(0.02, 0.06)
    columns, rows = 10 * folds, 6
    share = np.linspace(0, 1, columns + 1)
    along = share * 2 * np.pi * folds + 0.8 * np.sin(2 * np.pi * share + rng.uniform(0, 6))
    down = np.linspace(0, 1, rows + 1)[:, None]
    depth = deep * np.sin(along) * (0.75 + 0.25 * down)
    sway = 0.01 * np.sin(3 * along + 2 * down)
    x = width * (share - 0.5 + 0.0 * down)
    z = height * (1 - down) + 0 * share
    yield grid_surface(np.stack([x, depth + sway * deep, z], axis=2)[::-1])


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


def _body(bones: list[tuple[Floats, float, Floats, float]], softness: float, cells: int) -> Mesh:
    field = _blended([_limb(start, stop, radius, end) for start, radius, stop, end in bones], softness)
    points = np.array([end for start, _, stop, _ in bones for end in (start, stop)])
    radii = np.array([radius for _, first, _, last in bones for radius in (first, last)])
    return _cut(field, points, radii + 0.03, cells)


def _cut(field: Field, points: Floats, reach: Floats, cells: int) -> Mesh:
    """Make a mesh of a field within the box around its balls, given by their centres, (N, 3), and radii, (N,)."""
    low, high = (points - reach[:, None]).min(axis=0), (points + reach[:, None]).max(axis=0)
    margin = 2 * (high - low).max() / cells
    return _surface_of(field, low - margin, high + margin, cells)


def _limb(start: ArrayLike, stop: ArrayLike, radius: float, end_radius: float | None = None) -> Field:
    """Return the field of a round-ended rod between two points, (3,) each; of a ball where the points coincide.

    The radius changes evenly from ``radius`` at the start to ``end_radius``, by default the same, at the stop.
    """
    first = np.asarray(start, np.float64)
    along = np.asarray(stop, np.float64) - first
    square = float((along * along).sum())
    taper = 0.0 if end_radius is None else end_radius - radius

    def field(points: Floats) -> Floats:
        away = points - first
        share = np.clip((away * along).sum(axis=1) / square, 0, 1) if square > 0 else np.zeros(len(points))
        off = away - share[:, None] * along
        return np.asarray(np.sqrt((off * off).sum(axis=1)) - (radius + taper * share))

    return field


def _blended(fields: Sequence[Field], softness: float) -> Field:
    """Return the union of fields, with creases rounded over a distance of ``softness`` (Quilez's polynomial)."""

    def smaller(a: Floats, b: Floats) -> Floats:
        overlap = np.maximum(softness - np.abs(a - b), 0) / softness
        return np.minimum(a, b) - overlap * overlap * softness / 4

    return lambda points: reduce(smaller, (field(points) for field in fields))


def _surface_of(field: Field, low: ArrayLike, high: ArrayLike, cells: int) -> Mesh:
    """Make a mesh of the surface where a field is zero, by surface nets: one vertex for each cell that it passes.

    The box from ``low`` to ``high``, (3,) each, has ``cells`` along its longest side; at its border the field must be
    positive. The mesh is closed, with UV by `project_uv` and triangles that are anticlockwise seen from outside.
    """
    origin = np.asarray(low, np.float64)
    extent = np.asarray(high, np.float64) - origin
    step = float(extent.max()) / cells
    counts = np.ceil(extent / step).astype(np.int64) + 1
    nodes = np.stack(np.meshgrid(*(np.arange(count) for count in counts), indexing="ij"), axis=-1)
    values = field(origin + nodes.reshape(-1, 3) * step).reshape(counts) / step
    values = _without_pinches(np.where(values < 0, np.minimum(values, -_CLEARANCE), np.maximum(values, _CLEARANCE)))
    inside = values < 0

    sums, crossings = np.zeros((*(counts - 1), 3)), np.zeros(counts - 1)
    quads = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        first, last = (tuple(side if k == axis else slice(None) for k in range(3)) for side in (_FIRST, _LAST))
        crossed = np.argwhere(inside[first] != inside[last])
        begin, end = (values[side][tuple(crossed.T)] for side in (first, last))
        place = crossed.astype(np.float64)
        place[:, axis] += begin / (begin - end)
        cells_around = []
        for du, dv in _AROUND:
            cell = crossed.copy()
            cell[:, u] -= 1 - du
            cell[:, v] -= 1 - dv
            np.add.at(sums, tuple(cell.T), place)
            np.add.at(crossings, tuple(cell.T), 1)
            cells_around.append(np.ravel_multi_index(tuple(cell.T), tuple(counts - 1)))
        quad = np.stack(cells_around, axis=1)
        quads.append(np.where((begin < 0)[:, None], quad, quad[:, ::-1]))
    used, corner = np.unique(np.concatenate(quads), return_inverse=True)
    positions = origin + (sums.reshape(-1, 3)[used] / crossings.reshape(-1)[used, None]) * step
    return project_uv("implicit", positions, halved(corner.reshape(-1, 4)))


def _without_pinches(values: Floats) -> Floats:
    """Fill squares of the grid that have two opposite corners inside the surface and two outside.

    Four triangles would meet at one edge there, so that none would have a single neighbour across it.
    """
    filled = values.copy()
    while True:
        before = filled.copy()
        for first, second in ((0, 1), (1, 2), (2, 0)):
            squares = np.moveaxis(filled, (first, second), (0, 1))
            a, b, c, d = (squares[(_FIRST, _LAST)[i], (_FIRST, _LAST)[j]] for i, j in _AROUND)  # views
            for one, other, beside, opposite in ((a, c, b, d), (b, d, a, c)):
                pinched = (one < 0) & (other < 0) & (beside >= 0) & (opposite >= 0)
                nearer = beside <= opposite
                beside[pinched & nearer] = -_CLEARANCE
                opposite[pinched & ~nearer] = -_CLEARANCE
        if np.array_equal(filled, before):
            return filled
