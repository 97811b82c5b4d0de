"""The mean relief of models over all directions: the area that they cover on the screen, and their heights.

It is measured in small height maps of each model from several directions.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.config.scene_sections import ParticlesSection
from semisynth_gl.geometry.mesh import Floats, Mesh
from semisynth_gl.inputs.errors import InputError

Ints = NDArray[np.int64]

# Number of directions for all models together, and minimum for each model.
_VIEWS, _LEAST_VIEWS = 450, 3
_CELLS, _QUANTILES = 32, 16


@dataclass(frozen=True, slots=True, eq=False)
class MeanModelRelief:
    """A mean over models, directions and scales. The unit is the radius of the bounding sphere before stretching.

    Attributes:
        fill: projected area over the area of the sphere's disc.
        heights: (16,) float64, increasing quantiles of the visible surface's height above the plane through the
            sphere's centre, -1 to 1, over the projected area.
    """

    fill: float
    heights: Floats


def mean_relief(
    models: Sequence[Mesh], chances: Floats, section: ParticlesSection, rng: np.random.Generator
) -> MeanModelRelief:
    """Average over M models with chances (M,), sum 1, over random directions, and over the scales of ``section``.

    Raises InputError if the models are too thin to cover anything.
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
            "models: all sampled models are too thin to be seen: add a folder of models to models.folders, or raise a "
            "weight of the section models"
        )
    height, weight = np.concatenate(heights), np.concatenate(weights)
    order = np.argsort(height, kind="stable")
    below = np.cumsum(weight[order])
    wanted = (np.arange(_QUANTILES) + 0.5) / _QUANTILES * below[-1]
    # Rounded, since sums differ between machines, but digests of models must not.
    return MeanModelRelief(round(float(fill), 9), np.round(height[order][np.searchsorted(below, wanted)], 9))


def sample_scales(section: ParticlesSection, count: int, rng: np.random.Generator) -> Floats:
    """Sample scales of models along their axes, (count, 3); the largest scale of each model is 1."""
    scales = section.stretch.sample_many(rng, 3 * count).reshape(count, 3)
    scales[:, 2] *= section.thinness.sample_log(rng, count)
    return np.asarray(scales / scales.max(axis=1, keepdims=True))


def height_map(mesh: Mesh, axes: Floats, cells: int) -> Floats:
    """Project a mesh orthographically and measure the height of its visible surface, without OpenGL.

    The columns of ``axes``, (3, 3), are the map's x and y and the direction towards the viewer, in the model's frame.
    Scaled rows stretch the model along its axes. The map, (cells, cells), spans the bounding sphere. It has the
    surface's height at each cell's centre above the plane through the sphere's centre, in radii of the sphere, and -inf
    where the model does not cover the cell's centre.
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


def covered_cells(x: Floats, y: Floats, triangles: Ints, columns: int, rows: int) -> tuple[Ints, Ints, Floats, Floats]:
    """Find the cells of a coarse grid whose centres lie in triangles, for all triangles at once and without OpenGL.

    ``x`` and ``y``, (V,) each, are the vertices' columns and rows; the centre of the first cell is at (0, 0).
    ``triangles`` is (3, T) indices of vertices. Returns four arrays, (N,) each, with a value for each pair of a
    triangle and a cell that it covers: the triangle's number; the cell's number, row times ``columns`` plus column; and
    the barycentric coordinates of the cell's centre for the second and the third corner.
    """
    # Most triangles contain no centre, since they are smaller than a cell: first drop those that miss all columns.
    some_x, low_x, high_x = _spanned_cells(x[triangles], columns)
    some_y, low_y, high_y = _spanned_cells(y[triangles[:, some_x]], rows)
    chosen, low_x, high_x = some_x[some_y], low_x[some_y], high_x[some_y]
    (first_x, second_x, third_x), (first_y, second_y, third_y) = (axis[triangles[:, chosen]] for axis in (x, y))
    width = high_x - low_x + 1
    count = width * (high_y - low_y + 1)
    # ``of`` is the triangle of each cell of each triangle's bounding box.
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


def _spanned_cells(corners: Floats, cells: int) -> tuple[Ints, Ints, Ints]:
    """Return which triangles, given corners (3, T) on one axis, span cells' centres, and their first and last cell."""
    first, second, third = corners
    low = np.ceil(np.minimum(np.minimum(first, second), third)).clip(0, cells)
    high = np.floor(np.maximum(np.maximum(first, second), third)).clip(-1, cells - 1)
    some = np.flatnonzero(low <= high)
    return some, low[some].astype(np.int64), high[some].astype(np.int64)
