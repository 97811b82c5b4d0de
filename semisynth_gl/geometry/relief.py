"""The mean relief of models over all directions: the area that a model covers on the screen, and its heights.

It is measured from small height maps of each model from several sides.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.config.scene_sections import ParticlesSection
from semisynth_gl.geometry.mesh import Floats, Mesh
from semisynth_gl.inputs.errors import InputError

Numbers = NDArray[np.int64]

# Number of views that all models share; each model has _LEAST_VIEWS or more.
_VIEWS = 450
_LEAST_VIEWS = 3
_CELLS = 32
_QUANTILES = 16


@dataclass(frozen=True, slots=True, eq=False)
class MeanRelief:
    """A mean over models, directions and scales, in units of the bounding sphere's radius before stretching.

    Attributes:
        fill: projected area relative to the sphere's disc.
        heights: (16,) float64, rising: quantiles, over the projected area, of the height of the visible surface above
            the plane through the sphere's centre, from -1 to 1.
    """

    fill: float
    heights: Floats


def mean_relief(
    models: Sequence[Mesh], chances: Floats, section: ParticlesSection, rng: np.random.Generator
) -> MeanRelief:
    """Average over M models by their chances, (M,), sum 1, over random directions, and the stretch of ``section``.

    Raises InputError where the models are too thin to cover anything.
    """
    fill = 0.0
    heights, weights = [], []
    views = max(_LEAST_VIEWS, -(-_VIEWS // len(models)))
    for mesh, chance in zip(models, chances, strict=True):
        for scale in sample_scales(section, views, rng):
            axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
            relief = height_map(mesh, scale[:, None] * axes, _CELLS)
            relief = relief[np.isfinite(relief)]
            area = len(relief) * (2 / _CELLS) ** 2
            fill += chance / views * area / np.pi
            heights.append(relief)
            weights.append(np.full(len(relief), chance))
    if not fill > 0:
        raise InputError(
            "models: all that are drawn are too thin to be seen: name a folder with others in models.folders, or raise "
            "a weight of the section models"
        )
    height, weight = np.concatenate(heights), np.concatenate(weights)
    order = np.argsort(height, kind="stable")
    below = np.cumsum(weight[order])
    wanted = (np.arange(_QUANTILES) + 0.5) / _QUANTILES * below[-1]
    # Rounded, since machines may sum in different orders and digests of models are compared.
    return MeanRelief(round(float(fill), 9), np.round(height[order][np.searchsorted(below, wanted)], 9))


def sample_scales(section: ParticlesSection, count: int, rng: np.random.Generator) -> Floats:
    """Sample factors by which models are stretched along their axes, (count, 3); the largest factor of each is 1."""
    scales = section.stretch.sample_many(rng, 3 * count).reshape(count, 3)
    scales[:, 2] *= section.thinness.sample_log(rng, count)
    return np.asarray(scales / scales.max(axis=1, keepdims=True))


def height_map(mesh: Mesh, axes: Floats, cells: int) -> Floats:
    """Project a mesh orthographically and measure the height of its visible surface, without OpenGL.

    The columns of ``axes``, (3, 3), are the map's x and y and the direction towards the viewer, in the model's frame;
    its rows may be scaled to stretch the model along its own axes. The map, (cells, cells), spans the bounding sphere.
    It has the surface's height at the centre of each cell above the plane through the sphere's centre, in radii of the
    sphere; -inf where the model does not cover the cell's centre.
    """
    points = mesh.positions.astype(np.float64) / mesh.radius @ axes
    x, y = ((points[:, axis] + 1) / 2 * cells - 0.5 for axis in (0, 1))
    triangles = np.ascontiguousarray(mesh.triangles.T, np.int64)
    triangle, cell, u, v = covered_cells(x, y, triangles, cells, cells)
    first, second, third = points[triangles[:, triangle], 2]
    height = first + u * (second - first) + v * (third - first)
    seen = np.full(cells * cells, -np.inf)
    np.maximum.at(seen, cell, height)
    return seen.reshape(cells, cells)


def covered_cells(
    x: Floats, y: Floats, triangles: Numbers, columns: int, rows: int
) -> tuple[Numbers, Numbers, Floats, Floats]:
    """Find the cells of a coarse grid whose centres lie in triangles, for all triangles at once and without OpenGL.

    ``x`` and ``y``, (V,) each, are the vertices' columns and rows; the centre of the first cell is at (0, 0).
    ``triangles`` is (3, T) indices of vertices. Returns four arrays, (N,) each, with a value for each pair of a
    triangle and a cell that it covers: the triangle's number; the cell's number, row times ``columns`` plus column; and
    the place of the cell's centre along the edges from the first corner to the second and to the third corner, in
    lengths of these edges.
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
