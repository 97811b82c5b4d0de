"""The mean silhouette of models over all directions: the area that a model covers on the screen, and its relief.

It is measured from small height maps of each model from several sides.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from semisynth_gl.config.scene_sections import ParticlesSection
from semisynth_gl.geometry.cells import covered_cells
from semisynth_gl.geometry.mesh import Floats, Mesh
from semisynth_gl.inputs.errors import InputError

# Number of views that all models share; each model has _LEAST_VIEWS or more.
_VIEWS = 450
_LEAST_VIEWS = 3
_CELLS = 32
_QUANTILES = 16


@dataclass(frozen=True, slots=True, eq=False)
class Silhouette:
    """A mean over models, directions and scales, in units of the bounding sphere's radius before stretching.

    Attributes:
        fill: projected area relative to the sphere's disc.
        heights: (16,) float64, rising: quantiles, over the projected area, of the height of the visible surface above
            the plane through the sphere's centre, from -1 to 1.
    """

    fill: float
    heights: Floats


def mean_silhouette(
    models: Sequence[Mesh], chances: Floats, section: ParticlesSection, rng: np.random.Generator
) -> Silhouette:
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
    return Silhouette(round(float(fill), 9), np.round(height[order][np.searchsorted(below, wanted)], 9))


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
