"""The surface models (walls, grounds and panels), and the catalogue of all models that a static instance may have."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from semisynth_gl.geometry.mesh import Mesh, make_mesh, mesh_grid
from semisynth_gl.geometry.model_library import ModelLibrary
from semisynth_gl.scene import Floats, Ints

# Position of the ground's first row of vertices, as a share of the ground's length.
_GROUND_FROM = 1 / 400
_ARC_COLUMNS, _ARC_ROWS = 24, 4
_HALF_ARC_RAD = np.pi / 3

Corner = tuple[float, float]
"""A corner of a rectangle: x and y on the floor, or u and v on a wall, as fractions of the wall's edges."""
Hole = tuple[Corner, Corner]
"""A hole in a wall, by its top left and its bottom right corner."""

_HOLE_COLUMNS = ((0.12, 0.4), (0.37, 0.63), (0.6, 0.88))
DOORWAY_HOLES: Final = tuple(((left, 0.2), (right, 1.0)) for left, right in _HOLE_COLUMNS)
NICHE_HOLES: Final = tuple(((left, 0.3), (right, 0.62)) for left, right in _HOLE_COLUMNS)


def _face() -> Mesh:
    """The unit square of the x-y plane, u along x and v along y."""
    u, v, triangles = mesh_grid(8, 8)
    return make_mesh("face", np.c_[u, v, np.zeros(len(u))], np.c_[u, v], triangles)


def _ground() -> Mesh:
    """A wedge with its tip at the origin, 1 long, 2 wide at its end; rows of vertices are denser towards the tip."""
    u, v, triangles = mesh_grid(24, 8)
    along = _GROUND_FROM ** (1 - v)
    across = (2 * u - 1) * along
    return make_mesh("ground", np.c_[across, np.zeros(len(u)), along], np.c_[across, along], triangles)


def _curved_panel() -> Mesh:
    """A third of a cylinder over the unit square about the origin; it bulges to -z, and u is along the arc."""
    u, v, triangles = mesh_grid(_ARC_ROWS, _ARC_COLUMNS)
    radius = 0.5 / np.sin(_HALF_ARC_RAD)
    angle = (2 * u - 1) * _HALF_ARC_RAD
    middle = radius * (1 + np.cos(_HALF_ARC_RAD)) / 2
    points = np.c_[radius * np.sin(angle), v - 0.5, middle - radius * np.cos(angle)]
    return make_mesh("curved panel", points, np.c_[radius * angle, v], triangles)


def _pierced_face(hole: Hole, name: str) -> Mesh:
    """The unit square of the x-y plane with a rectangular hole; u is x, and v is y."""
    low, high = hole
    lines = [
        np.unique(np.concatenate([np.linspace(0, a, 4), np.linspace(a, b, 4), np.linspace(b, 1, 4)]))
        for a, b in zip(low, high, strict=True)
    ]
    x, y = (np.concatenate([grid.ravel() for grid in grids]) for grids in zip(np.meshgrid(*lines), strict=True))
    width = len(lines[0])
    in_hole = [(a <= line[:-1]) & (line[1:] <= b) for line, a, b in zip(lines, low, high, strict=True)]
    row, column = np.nonzero(~np.outer(in_hole[1], in_hole[0]))
    first = row * width + column
    halves = [(first, first + 1, first + width + 1), (first, first + width + 1, first + width)]
    triangles = np.transpose(halves, (2, 0, 1)).reshape(-1, 3)
    return make_mesh(name, np.c_[x, y, np.zeros(len(x))], np.c_[x, y], triangles)


# Surfaces are grids of many vertices: float32 rounds a vertex in steps that grow with its distance, so the near part of
# a surface must not depend on far vertices. A flat panel is a `FACE`.
FACE, GROUND, CURVED_PANEL = _face(), _ground(), _curved_panel()
DOORWAYS: Final = tuple(_pierced_face(hole, "wall with a doorway") for hole in DOORWAY_HOLES)
NICHES: Final = tuple(_pierced_face(hole, "wall with a niche") for hole in NICHE_HOLES)
SURFACE_MODELS = (FACE, GROUND, CURVED_PANEL, *DOORWAYS, *NICHES)
"""The first models that `Scene.model` indexes, in this order."""


@dataclass(frozen=True, slots=True, eq=False)
class ModelCatalogue:
    """The M models of scenes, `SURFACE_MODELS` and then the library's models, and their bounding boxes."""

    models: tuple[Mesh, ...]
    by_name: Mapping[str, Ints]  # for each kind, the library's models that static instances may have
    low: Floats  # (M, 3) the lower corner of each model's bounding box, model units
    high: Floats  # (M, 3) the opposite corner
    uv_low: Floats  # (M, 2) the lowest UV of each model
    uv_high: Floats  # (M, 2) the highest UV of each model

    def extent(self, number: int) -> Floats:
        """Return the lengths (3,) of a model's bounding box, in model units."""
        return np.asarray(self.high[number] - self.low[number])


def make_catalogue(library: ModelLibrary) -> ModelCatalogue:
    """Return the catalogue of the surface models and a library's models."""
    chosen = library.sampled[library.chances > 0]
    names = np.array([library.models[number].name for number in chosen])
    by_name = {str(name): len(SURFACE_MODELS) + chosen[names == name] for name in np.unique(names)}
    models = (*SURFACE_MODELS, *library.models)
    boxes, uv = (
        np.array([(array.min(axis=0), array.max(axis=0)) for array in arrays], np.float64).swapaxes(0, 1)
        for arrays in ([mesh.positions for mesh in models], [mesh.uv for mesh in models])
    )
    return ModelCatalogue(models, by_name, *boxes, *uv)
