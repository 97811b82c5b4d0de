"""The mesh type that the builders, the loader and the renderer share, and operations on meshes and vectors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.inputs.arguments import check_magnitudes, to_array
from semisynth_gl.inputs.errors import InputError

# float32 rounds a number by up to 2^-24 of it, so the error of vertices grows with their distance from the origin. At
# this many times half a mesh's extent it is 2^-20 of that half, a thousandth of a pixel for a mesh 2000 px wide.
_FAR = 16
# Beyond this many times half its extent, float64 holds a mesh no better than float32 does at the origin: 53 - 24 bits.
_FARTHEST = 2.0**29

Floats = NDArray[np.float64]
Vertices = NDArray[np.float32] | Floats


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """An indexed triangle mesh with one UV coordinate per vertex.

    Models of the generator follow two rules that hand-made meshes need not. They are normalised: their bounding sphere
    has radius 1 about the origin. Their UV is measured in model units along the surface, so that one UV unit spans one
    model unit and no texture is stretched.

    Attributes:
        name: the model's name in the provenance of a sample.
        positions: (V, 3) float32 or float64, model units, up to 1e9; float64 is for meshes far from their origin.
        uv: (V, 2) float32 or float64; u to the right and v downwards in the patch, as in its pixel rows.
        triangles: (T, 3) uint32 indices into ``positions``.
        solid: whether the mesh is solid (see `is_solid`). Only the fronts of a solid mesh's triangles are drawn, of
            other meshes both sides.

    Raises:
        InputError: where shapes, dtypes, indices or values are wrong.
    """

    name: str
    positions: Vertices
    uv: Vertices
    triangles: NDArray[np.uint32]
    solid: bool = False

    def __post_init__(self) -> None:
        floats = ("float32", "float64")
        for label, width, dtypes in (("positions", 3, floats), ("uv", 2, floats), ("triangles", 3, ("uint32",))):
            array, rows = getattr(self, label), "T" if label == "triangles" else "V"
            if array.ndim != 2 or array.shape[1] != width or array.dtype not in dtypes:
                expected = f"{label} must be ({rows}, {width}) {' or '.join(dtypes)}"
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
        return float(np.sqrt((self.positions.astype(np.float64) ** 2).sum(axis=1).max()))


def make_mesh(name: str, positions: object, uv: object, triangles: object) -> Mesh:
    """Build a `Mesh` from anything array-like, converting to its dtypes.

    Positions and UV become float32, but stay float64 where they lie farther from the origin than 16 times half their
    extent, as coordinates of maps and sites do.

    Args:
        name: see `Mesh`.
        positions: (V, 3), model units, up to 1e9.
        uv: (V, 2), up to 1e9.
        triangles: (T, 3) indices.

    Raises:
        InputError: where shapes, indices or values are wrong.
    """
    vertices, coordinates, index = _arrays(name, positions, uv, triangles)
    return Mesh(name, _rounded_near(vertices), _rounded_near(coordinates), index)


def make_part(name: str, positions: object, uv: object, triangles: object) -> Mesh:
    """Build a part of a model, as `make_mesh` does but always in float32: the origin is that of the model."""
    vertices, coordinates, index = _arrays(name, positions, uv, triangles)
    return Mesh(name, vertices.astype(np.float32, order="C"), coordinates.astype(np.float32, order="C"), index)


def _arrays(name: str, positions: object, uv: object, triangles: object) -> tuple[Floats, Floats, NDArray[np.uint32]]:
    """Return positions and UV in float64, and triangles, (T, 3); refuses numbers too large to be rounded to float32."""
    index = to_array(f"mesh {name}: triangles", triangles, np.int64)
    if index.size % 3:
        raise InputError(f"mesh {name}: triangles must be (T, 3), got {index.shape}")
    index = index.reshape(-1, 3)
    if len(index) and int(index.min()) < 0:
        raise InputError(f"mesh {name}: triangle index {int(index.min())} is negative")
    arrays = []
    for what, values in ((f"mesh {name}: positions", positions), (f"mesh {name}: uv", uv)):
        arrays.append(to_array(what, values, np.float64))
        check_magnitudes(what, arrays[-1])
    return arrays[0], arrays[1], np.ascontiguousarray(index, np.uint32)


def _rounded_near(points: Floats) -> Vertices:
    """Round points to float32 where they do not lie far from 0."""
    is_far = points.ndim == 2 and _times_away(points) > _FAR
    return np.ascontiguousarray(points) if is_far else points.astype(np.float32, order="C")


def _times_away(points: Vertices) -> float:
    """Return how far points (N, D) lie from 0, in units of half their extent; inf where all points coincide."""
    if not len(points):
        return 0.0
    low, high = points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64)
    away, reach = max(-low.min(), high.max()), lengths(high - low) / 2
    return float(away / reach) if reach > 0 else inf


@dataclass(frozen=True, slots=True, eq=False)
class CentredMesh:
    """A mesh as it is drawn, in float32 and near its origin, and where its origins lie in the original mesh.

    Attributes:
        mesh: the mesh; its positions and UV are the original ones minus ``origin`` and ``uv_origin``.
        origin: (3,) float64, model units; zero where the positions were not moved.
        uv_origin: (2,) float64; zero where the UV was not moved.
    """

    mesh: Mesh
    origin: Floats
    uv_origin: Floats


def centred(mesh: Mesh) -> CentredMesh:
    """Move a mesh to its origin where it lies far away, and do the same with its UV.

    Raises InputError where positions or UV lie so far away that float64 does not hold their shape.
    """
    for what, points in (("positions", mesh.positions), ("uv", mesh.uv)):
        if _FARTHEST < (times := _times_away(points)) < inf:
            raise InputError(
                f"mesh {mesh.name}: {what} must lie within {_FARTHEST:.2g} times their size of 0, got {times:.2g}: "
                "float64 does not hold their shape there"
            )
    (positions, origin), (uv, uv_origin) = _moved(mesh.positions), _moved(mesh.uv)
    return CentredMesh(replace(mesh, positions=positions, uv=uv), origin, uv_origin)


def _moved(points: Vertices) -> tuple[NDArray[np.float32], Floats]:
    """Return points (N, D) in float32, moved to 0 by their middle if far away, and the shift, (D,), which may be 0."""
    origin = np.zeros(points.shape[1])
    if _times_away(points) > _FAR:
        origin = (points.min(axis=0).astype(np.float64) + points.max(axis=0)) / 2
        points = points - origin
    return points.astype(np.float32, copy=False), origin


def mesh_grid(rows: int, columns: int) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Return the triangulation of a grid of cells: u and v from 0 to 1, (V,) each, and triangles, (T, 3).

    The V = (rows + 1) (columns + 1) vertices run row by row; u grows along a row, v from row to row.
    """
    v, u = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    first = np.arange(v.size).reshape(v.shape)[:-1, :-1].reshape(-1, 1)
    return u.ravel(), v.ravel(), halved(first + np.array([0, 1, columns + 2, columns + 1]))


def halved(quads: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cut quadrilaterals of indices, (Q, 4), along a diagonal: (2 Q, 3), all first halves before all second halves."""
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def cross(first: Floats, second: Floats) -> Floats:
    """Return cross products along the last axis, (..., 3), bit for bit equal to those of `numpy.cross`.

    With `numpy.cross` and `numpy.linalg.norm`, which are slow on small arrays, the builders would take a quarter
    longer.
    """
    a, b, c = first[..., 0], first[..., 1], first[..., 2]
    p, q, r = second[..., 0], second[..., 1], second[..., 2]
    x = b * r - c * q
    product = np.empty((*np.shape(x), 3))
    product[..., 0] = x
    product[..., 1] = c * p - a * r
    product[..., 2] = a * q - b * p
    return product


def least_axis(direction: Floats) -> Floats:
    """Return the unit vector, (3,), of the axis along which a direction (3,) has its smallest component.

    Components that agree to 1e-6 count as equal, and the first of them is taken: sines and products of matrices differ
    in their last bits from processor to processor, and must not decide.
    """
    axis: Floats = np.eye(3)[np.argmin(np.round(np.abs(direction), 6))]
    return axis


def face_normals(corners: Floats) -> Floats:
    """Return the normals of triangles, (T, 3), from their corners, (T, 3, 3); a normal's length is twice the area."""
    return cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def lengths(vectors: Floats) -> Floats:
    """Return the lengths of vectors along the last axis, (..., D), bit for bit equal to `numpy.linalg.norm`."""
    return np.asarray(np.sqrt(np.add.reduce(vectors * vectors, axis=-1)))


def unit(vector: Floats) -> Floats:
    """Scale a vector, (3,), to length 1."""
    return vector / np.linalg.norm(vector)


def merged(name: str, parts: Sequence[Mesh]) -> Mesh:
    """Join meshes into one of the given name, with vertices and triangles in the order given; ``solid`` is not set."""
    offsets = np.cumsum([0] + [len(part.positions) for part in parts[:-1]])
    triangles = [part.triangles.astype(np.int64) + offset for part, offset in zip(parts, offsets, strict=True)]
    positions, uv = [part.positions for part in parts], [part.uv for part in parts]
    return make_part(name, np.concatenate(positions), np.concatenate(uv), np.concatenate(triangles))


def normalised(mesh: Mesh) -> Mesh:
    """Centre a mesh's bounding box on the origin and scale it, with its UV, to radius 1.

    Raises InputError where all vertices coincide.
    """
    positions = mesh.positions.astype(np.float64)
    centred = positions - (positions.min(axis=0) + positions.max(axis=0)) / 2
    radius = float(np.sqrt((centred**2).sum(axis=1).max()))
    if not radius > 0:
        raise InputError(f"mesh {mesh.name}: has no extent")
    return make_part(mesh.name, centred / radius, mesh.uv.astype(np.float64) / radius, mesh.triangles)


def without_degenerate(mesh: Mesh) -> Mesh:
    """Drop triangles without area, and vertices without a triangle.

    A triangle has no area where its height over its longest edge is at most a millionth of the mesh's radius: it
    cannot be seen, and its normal and texture direction are noise. Raises InputError where no triangle remains.
    """
    corners = mesh.positions.astype(np.float64)[mesh.triangles]
    double_areas = lengths(face_normals(corners))
    longest = lengths(corners - corners[:, [2, 0, 1]]).max(axis=1)
    sound = double_areas > 1e-6 * mesh.radius * longest
    kept = mesh.triangles[sound]
    used = np.zeros(len(mesh.positions), bool)
    used[kept] = True
    if sound.all() and used.all():
        return mesh
    return make_part(mesh.name, mesh.positions[used], mesh.uv[used], (np.cumsum(used) - 1)[kept])
