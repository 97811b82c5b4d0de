"""The mean relief of models, measured in small height maps: the projected area, and the heights towards the viewer."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.config.scene_sections import ParticlesSection
from semisynth_gl.geometry.mesh import Floats, Mesh
from semisynth_gl.inputs.errors import InputError

Ints = NDArray[np.int64]

# Number of height maps of all models together, and minimum for each model.
_MAPS, _LEAST_MAPS = 450, 3
# Side of a height map, in cells.
_CELLS = 32
_QUANTILES = 16


@dataclass(frozen=True, slots=True, eq=False)
class MeanModelRelief:
    """Statistics of models' silhouettes and heights: means over models, directions and scales.

    The unit of length is the radius of a model's bounding sphere before the model is stretched.

    Attributes:
        fill: mean projected area of a model, divided by the area of the sphere's disc.
        heights: (16,) float64, increasing quantiles of height over the projected area. The height is that of the
            visible surface above the plane through the sphere's centre, -1 to 1, positive towards the viewer.
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
    maps = max(_LEAST_MAPS, -(-_MAPS // len(models)))
    for mesh, chance in zip(models, chances, strict=True):
        for scale in sample_scales(section, maps, rng):
            axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
            relief = _visible_heights(mesh, scale[:, None] * axes)
            area = len(relief) * (2 / _CELLS) ** 2
            fill += chance / maps * area / np.pi
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
    # Rounded, since the last bits of sums differ between machines, but digests of models must not.
    return MeanModelRelief(round(float(fill), 9), np.round(height[order][np.searchsorted(below, wanted)], 9))


def sample_scales(section: ParticlesSection, count: int, rng: np.random.Generator) -> Floats:
    """Sample scales of models along their axes, (count, 3); the largest scale of each model is 1."""
    scales = section.stretch.sample_many(rng, 3 * count).reshape(count, 3)
    scales[:, 2] *= section.thinness.sample_log(rng, count)
    return np.asarray(scales / scales.max(axis=1, keepdims=True))


def _visible_heights(mesh: Mesh, axes: Floats) -> Floats:
    """Project a mesh orthographically to a height map, and return the heights of the cells that it covers, (N,).

    The columns of ``axes``, (3, 3), are the map's x and y and the direction towards the viewer, in the model's frame.
    If row k is multiplied by a factor, the model is stretched by it along its axis k. The map spans the bounding
    sphere, whose radius is 1.
    """
    points = mesh.positions.astype(np.float64) / mesh.radius @ axes
    x, y = ((points[:, axis] + 1) / 2 * _CELLS - 0.5 for axis in (0, 1))
    triangles = np.ascontiguousarray(mesh.triangles.T, np.int64)
    triangle, cell, u, v = covered_cells(x, y, triangles, _CELLS, _CELLS)
    first, second, third = points[triangles[:, triangle], 2]
    heights: Floats = np.full(_CELLS * _CELLS, -np.inf)
    np.maximum.at(heights, cell, first + u * (second - first) + v * (third - first))
    return heights[np.isfinite(heights)]


def covered_cells(x: Floats, y: Floats, triangles: Ints, columns: int, rows: int) -> tuple[Ints, Ints, Floats, Floats]:
    """Rasterise triangles on a coarse grid: find all pairs of a triangle and a cell whose centre lies in it.

    ``x`` and ``y``, (V,) each, are the vertices' columns and rows; the centre of the first cell is at (0, 0).
    ``triangles`` is (3, T) indices of vertices. Returns four arrays, (N,) each, with one value per pair: the triangle's
    index; the cell's number, row times ``columns`` plus column; and the barycentric coordinates of the cell's centre
    for the triangle's second and third corner.
    """
    # Most triangles are smaller than a cell and contain no centre: first drop those that miss all columns or all rows.
    in_columns, low_x, high_x = _spanned_cells(x[triangles], columns)
    in_rows, low_y, high_y = _spanned_cells(y[triangles[:, in_columns]], rows)
    chosen, low_x, high_x = in_columns[in_rows], low_x[in_rows], high_x[in_rows]
    (first_x, second_x, third_x), (first_y, second_y, third_y) = (axis[triangles[:, chosen]] for axis in (x, y))
    width = high_x - low_x + 1
    count = width * (high_y - low_y + 1)
    # Candidates are all cells of each triangle's bounding box; ``owner`` is the triangle of each candidate.
    owner = np.repeat(np.arange(len(count)), count)
    at_y, at_x = np.divmod(np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count), width[owner])
    cell_x, cell_y = low_x[owner] + at_x, low_y[owner] + at_y
    edge_1_x, edge_1_y = second_x - first_x, second_y - first_y
    edge_2_x, edge_2_y = third_x - first_x, third_y - first_y
    area = (edge_1_x * edge_2_y - edge_1_y * edge_2_x)[owner]
    dx, dy = cell_x - first_x[owner], cell_y - first_y[owner]
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (dx * edge_2_y[owner] - dy * edge_2_x[owner]) / area
        v = (dy * edge_1_x[owner] - dx * edge_1_y[owner]) / area
        inside = np.flatnonzero((u >= 0) & (v >= 0) & (u + v <= 1))
    return chosen[owner[inside]], (cell_y * columns + cell_x)[inside], u[inside], v[inside]


def _spanned_cells(corners: Floats, cells: int) -> tuple[Ints, Ints, Ints]:
    """Return which triangles, given corners (3, T) on one axis, span a cell's centre, and their first and last cell."""
    low, high = np.ceil(corners.min(axis=0)).clip(0, cells), np.floor(corners.max(axis=0)).clip(-1, cells - 1)
    spanning = np.flatnonzero(low <= high)
    return spanning, low[spanning].astype(np.int64), high[spanning].astype(np.int64)
