"""Which cells of a coarse grid triangles cover, for all triangles at once and without OpenGL."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Numbers = NDArray[np.int64]


def covered_cells(corners: Floats, columns: int, rows: int) -> tuple[Numbers, Numbers, Floats, Floats]:
    """Find the cells whose centres lie in triangles.

    Args:
        corners: (T, 3, 2) float64, column and row of each corner; the centre of the first cell is (0, 0).
        columns: cells in a row of the grid.
        rows: rows of the grid.

    Returns:
        A value for each pair of a triangle and a cell that it covers: the triangle, the cell (row times ``columns``
        plus column), and how far the cell's centre lies from the first corner towards the second and the third one, in
        lengths of these edges.
    """
    # Reductions over axes so short take numpy longer than all else here.
    first, second, third = corners[:, 0], corners[:, 1], corners[:, 2]
    low = np.ceil(np.minimum(np.minimum(first, second), third)).clip(0, (columns, rows)).astype(np.int64)
    high = np.floor(np.maximum(np.maximum(first, second), third)).clip(-1, (columns - 1, rows - 1)).astype(np.int64)
    size = (high - low + 1).clip(0)
    count = size[:, 0] * size[:, 1]
    # A row for each cell of each triangle's bounding box.
    triangle = np.repeat(np.arange(len(count)), count)
    at = np.arange(len(triangle)) - np.repeat(np.cumsum(count) - count, count)
    x = low[triangle, 0] + at % size[triangle, 0]
    y = low[triangle, 1] + at // size[triangle, 0]
    edge_1, edge_2 = second - first, third - first
    area = edge_1[:, 0] * edge_2[:, 1] - edge_1[:, 1] * edge_2[:, 0]
    dx, dy = x - first[triangle, 0], y - first[triangle, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (dx * edge_2[triangle, 1] - dy * edge_2[triangle, 0]) / area[triangle]
        v = (dy * edge_1[triangle, 0] - dx * edge_1[triangle, 1]) / area[triangle]
        inside = (u >= 0) & (v >= 0) & (u + v <= 1)
    return triangle[inside], (y * columns + x)[inside], u[inside], v[inside]
