"""Smooth closed surfaces from distance fields: balls and limbs that flow into each other, cut out as a mesh.

Fields use only operations that every processor rounds alike (no powers or exponentials), so that a model has the same
vertices on all machines.
"""

from collections.abc import Callable, Sequence
from functools import reduce

import numpy as np
from numpy.typing import ArrayLike

from semisynth_gl.geometry.mesh import Floats, Mesh, halved
from semisynth_gl.geometry.unwrap import project_uv

Field = Callable[[Floats], Floats]
"""Function from points, (N, 3), to signed distances from a surface, (N,), in model units, negative inside."""

# The four cells around an edge of the grid, in turn: whether each lies behind the edge along the other two axes.
_AROUND = ((0, 0), (1, 0), (1, 1), (0, 1))
# Values nearer to zero than this, in cells, are moved away from it, since triangles would shrink to nothing.
_CLEARANCE = 0.05
_FIRST, _LAST = slice(None, -1), slice(1, None)


def limb(start: ArrayLike, stop: ArrayLike, radius: float, end_radius: float | None = None) -> Field:
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


def blended(fields: Sequence[Field], softness: float) -> Field:
    """Return the union of fields, with creases rounded over a distance of ``softness`` (Quilez's polynomial)."""

    def smaller(a: Floats, b: Floats) -> Floats:
        overlap = np.maximum(softness - np.abs(a - b), 0) / softness
        return np.minimum(a, b) - overlap * overlap * softness / 4

    return lambda points: reduce(smaller, (field(points) for field in fields))


def surface_of(field: Field, low: ArrayLike, high: ArrayLike, cells: int) -> Mesh:
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
