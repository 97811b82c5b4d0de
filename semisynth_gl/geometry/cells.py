"""Finds the cells of a coarse grid that triangles cover, for all triangles at once and without OpenGL."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Numbers = NDArray[np.int64]


def covered_cells(
    x: Floats, y: Floats, triangles: Numbers, columns: int, rows: int
) -> tuple[Numbers, Numbers, Floats, Floats]:
    """Find the cells whose centres lie in triangles.

    Args:
        x: (V,) columns of the vertices, in cells; the centre of the first cell is at (0, 0).
        y: (V,) rows of the vertices, in cells.
        triangles: (3, T) indices of vertices.
        columns: number of columns of the grid.
        rows: number of rows of the grid.

    Returns:
        Four arrays, (N,) each, with a value for each pair of a triangle and a cell that it covers: the triangle's
        number; the cell's number, row times ``columns`` plus column; and the place of the cell's centre along the edges
        from the first corner to the second and to the third corner, in lengths of these edges.
    """
    # Most triangles are smaller than a cell and hold no centre: each step leaves fewer.
    some_x, low_x, high_x = _spanned(x[triangles], columns)
    some_y, low_y, high_y = _spanned(y[triangles[:, some_x]], rows)
    chosen, low_x, high_x = some_x[some_y], low_x[some_y], high_x[some_y]
    (first_x, second_x, third_x), (first_y, second_y, third_y) = (axis[triangles[:, chosen]] for axis in (x, y))
    width = high_x - low_x + 1
    count = width * (high_y - low_y + 1)
    # A row for each cell of each triangle's bounding box.
    of = np.repeat(np.arange(len(count)), count)
    at_y, at_x = np.divmod(np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count), width[of])
    cell_x, cell_y = low_x[of] + at_x, low_y[of] + at_y
    edge_1_x, edge_1_y = second_x - first_x, second_y - first_y
    edge_2_x, edge_2_y = third_x - first_x, third_y - first_y
    area = (edge_1_x * edge_2_y - edge_1_y * edge_2_x)[of]
    dx, dy = cell_x - first_x[of], cell_y - first_y[of]
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (dx * edge_2_y[of] - dy * edge_2_x[of]) / area
        v = (dy * edge_1_x[of] - dx * edge_1_y[of]) / area
        inside = np.flatnonzero((u >= 0) & (v >= 0) & (u + v <= 1))
    return chosen[of[inside]], (cell_y * columns + cell_x)[inside], u[inside], v[inside]


def _spanned(corners: Floats, cells: int) -> tuple[Numbers, Numbers, Numbers]:
    """Return which triangles, of (3, T) corners, span a cell's centre along one axis, and the first and last cell."""
    first, second, third = corners
    low = np.ceil(np.minimum(np.minimum(first, second), third)).clip(0, cells)
    high = np.floor(np.maximum(np.maximum(first, second), third)).clip(-1, cells - 1)
    some = np.flatnonzero(low <= high)
    return some, low[some].astype(np.int64), high[some].astype(np.int64)
