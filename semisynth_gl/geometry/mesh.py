"""The type of all meshes, and operations on meshes and vectors."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.inputs.arguments import check_magnitudes, to_array
from semisynth_gl.inputs.errors import InputError

# Maximum distance of vertices from the origin, relative to half the diagonal of the mesh's bounding box. There, float32
# rounds vertices by up to 2^14 x 2^-24, a thousandth of that half diagonal.
_FARTHEST = 1 << 14

Floats = NDArray[np.float64]
Numbers = NDArray[np.number]


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """An indexed triangle mesh with one UV coordinate per vertex.

    The program's own models follow two rules, which hand-made meshes may break. They are normalised: their bounding
    sphere has radius 1 about the origin. One UV unit spans one model unit on the surface, so no texture is stretched.

    Attributes:
        name: the model's name in the provenance of a sample.
        positions: (V, 3) float32, model units, up to 1e9.
        uv: (V, 2) float32; u points to the right and v downwards in the patch, as in its pixel rows.
        triangles: (T, 3) uint32 indices into ``positions``.
        solid: see `is_solid`. The renderer draws only the front faces of a solid mesh, and both faces of other meshes.

    Raises:
        InputError: if shapes, dtypes, indices or values are wrong.
    """

    name: str
    positions: NDArray[np.float32]
    uv: NDArray[np.float32]
    triangles: NDArray[np.uint32]
    solid: bool = False

    def __post_init__(self) -> None:
        for label, width, dtype in (("positions", 3, "float32"), ("uv", 2, "float32"), ("triangles", 3, "uint32")):
            array, rows = getattr(self, label), "T" if label == "triangles" else "V"
            if array.ndim != 2 or array.shape[1] != width or array.dtype != dtype:
                expected = f"{label} must be ({rows}, {width}) {dtype}"
                raise InputError(f"mesh {self.name}: {expected}, got {array.shape} {array.dtype}")
        if len(self.uv) != len(self.positions):
            raise InputError(f"mesh {self.name}: {len(self.positions)} positions but {len(self.uv)} uv")
        if len(self.triangles) == 0:
            raise InputError(f"mesh {self.name}: has no triangles")
        largest, count = int(self.triangles.max()), len(self.positions)
        if largest >= count:
            raise InputError(f"mesh {self.name}: triangle index {largest} is out of range, there are {count} vertices")
        check_magnitudes(f"mesh {self.name}: positions", self.positions)
        check_magnitudes(f"mesh {self.name}: uv", self.uv)

    @property
    def radius(self) -> float:
        """Largest distance of a vertex from the origin, model units."""
        return float(lengths(self.positions.astype(np.float64)).max())


Parts = Iterator[Mesh]
"""The parts of a model."""


def make_mesh(name: str, positions: object, uv: object, triangles: object) -> Mesh:
    """Build a `Mesh` from array-like values, which are converted to its dtypes.

    The mesh must lie so near to the origin that float32 keeps its shape. With half the diagonal of the bounding box as
    the unit, no coordinate of ``positions``, (V, 3), may exceed 16384. For ``uv``, (V, 2), the unit is at least 1.
    ``triangles`` are (T, 3) indices. Raises InputError if shapes, indices or values are wrong.
    """
    vertices = to_array(f"mesh {name}: positions", positions, np.float64)
    coordinates = to_array(f"mesh {name}: uv", uv, np.float64)
    mesh = make_part(name, vertices, coordinates, to_array(f"mesh {name}: triangles", triangles, np.uint32))
    for what, points, least in (("positions", vertices, 0.0), ("uv", coordinates, 1.0)):
        half_diagonal = max(float(lengths(np.ptp(points, axis=0))) / 2, least)
        if np.abs(points).max() > _FARTHEST * half_diagonal > 0:
            raise InputError(
                f"mesh {name}: {what} are farther from 0 than {_FARTHEST} times half the diagonal of their bounding "
                "box: float32 loses their shape. Subtract their middle, and add it to the instance's pose or UV offset"
            )
    return mesh


def make_part(name: str, positions: Numbers, uv: Numbers, triangles: Numbers) -> Mesh:
    """Build a part of a model from arrays of any dtype. Unlike a mesh of `make_mesh`, it may be far from the origin."""
    with np.errstate(over="ignore"):  # Mesh refuses infinite numbers
        vertices, coordinates = (each.astype(np.float32, order="C") for each in (positions, uv))
    return Mesh(name, vertices, coordinates, triangles.astype(np.uint32, order="C"))


def mesh_grid(rows: int, columns: int) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Triangulate a grid of cells: return u and v of its vertices from 0 to 1, (V,) each, and triangles, (T, 3).

    The V = (rows + 1) (columns + 1) vertices are in the order of rows. u grows along a row, v from row to row.
    """
    v, u = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    first = np.arange(v.size).reshape(v.shape)[:-1, :-1].reshape(-1, 1)
    return u.ravel(), v.ravel(), split_quads(first + np.array([0, 1, columns + 2, columns + 1]))


def split_quads(quads: NDArray[np.int64]) -> NDArray[np.int64]:
    """Split quadrilaterals of indices, (Q, 4), into triangles, (2 Q, 3); all first halves precede all second halves."""
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def cross(first: Floats, second: Floats) -> Floats:
    """Return cross products along the last axis, (..., 3), as `numpy.cross` does, but fast for small arrays."""
    a, b, c = first[..., 0], first[..., 1], first[..., 2]
    p, q, r = second[..., 0], second[..., 1], second[..., 2]
    return np.stack([b * r - c * q, c * p - a * r, a * q - b * p], axis=-1)


def least_aligned_axis(direction: Floats) -> Floats:
    """Return the unit vector, (3,), of the axis along which a direction (3,) has its smallest component.

    Components are compared to six decimals, since processors round differently. The first of equal components wins.
    """
    return np.asarray(np.eye(3)[np.argmin(np.round(np.abs(direction), 6))])


def face_normals(corners: Floats) -> Floats:
    """Return normals, (T, 3), of triangles with corners (T, 3, 3); the length of a normal is twice the area."""
    return cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def lengths(vectors: Floats) -> Floats:
    """Return the lengths of vectors along the last axis, (..., D), as `numpy.linalg.norm` does."""
    return np.asarray(np.sqrt(np.add.reduce(vectors * vectors, axis=-1)))


def unit(vector: Floats) -> Floats:
    """Scale a vector, (3,), to length 1."""
    return vector / np.linalg.norm(vector)


def merged(name: str, parts: Iterable[Mesh]) -> Mesh:
    """Join meshes into one that is not marked solid; vertices and triangles keep their order."""
    meshes = list(parts)
    starts = np.cumsum([0, *(len(mesh.positions) for mesh in meshes[:-1])]).astype(np.uint32)
    triangles = [mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)]
    positions, uv = [mesh.positions for mesh in meshes], [mesh.uv for mesh in meshes]
    return make_part(name, np.concatenate(positions), np.concatenate(uv), np.concatenate(triangles))


def normalised(mesh: Mesh) -> Mesh:
    """Centre a mesh's bounding box on the origin, and scale positions and UV to radius 1, without the mark ``solid``.

    Raises InputError if all vertices coincide.
    """
    positions = mesh.positions.astype(np.float64)
    centred = positions - (positions.min(axis=0) + positions.max(axis=0)) / 2
    radius = float(lengths(centred).max())
    if not radius > 0:
        raise InputError(f"mesh {mesh.name}: has no extent")
    return make_part(mesh.name, centred / radius, mesh.uv.astype(np.float64) / radius, mesh.triangles)


def without_degenerate(mesh: Mesh) -> Mesh:
    """Drop triangles without area, and vertices without a triangle; if there are any, the mark ``solid`` goes, too.

    A triangle counts as without area if its height over its longest edge is at most a millionth of the mesh's radius:
    it cannot be seen, and its normal is noise. Raises InputError if no triangle remains.
    """
    corners = mesh.positions.astype(np.float64)[mesh.triangles]
    double_areas = lengths(face_normals(corners))
    longest = lengths(corners - corners[:, [2, 0, 1]]).max(axis=1)
    sound = double_areas > 1e-6 * mesh.radius * longest
    used, renumbered = np.unique(mesh.triangles[sound], return_inverse=True)
    if sound.all() and len(used) == len(mesh.positions):
        return mesh
    return make_part(mesh.name, mesh.positions[used], mesh.uv[used], renumbered.reshape(-1, 3))
