"""The one mesh type that every builder, loader and the renderer share."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.errors import InputError
from semisynth_gl.geometry.vectors import cross, lengths


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """An indexed triangle mesh with one UV coordinate per vertex.

    Models of the generator follow two rules that hand-made meshes need not: they are normalised (bounding sphere of
    radius 1 about the origin, see `normalised`), and their UV is measured in model units along the surface, so that
    one UV unit spans one model unit and a texture lies on them without stretching.

    Attributes:
        name: what the provenance of a sample calls it.
        positions: (V, 3) float32, model units.
        uv: (V, 2) float32; u to the right and v downwards in the patch, as in its pixel rows.
        triangles: (T, 3) uint32 indices into ``positions``.
        solid: whether the surface encloses a body and its triangles turn anticlockwise seen from outside, so that no
            back of a triangle is ever seen from there (see `is_solid`). Else both sides are drawn.
    """

    name: str
    positions: NDArray[np.float32]
    uv: NDArray[np.float32]
    triangles: NDArray[np.uint32]
    solid: bool = False

    def __post_init__(self) -> None:
        for label, array, width in (("positions", self.positions, 3), ("uv", self.uv, 2)):
            if array.ndim != 2 or array.shape[1] != width or array.dtype != np.float32:
                raise InputError(
                    f"mesh {self.name}: {label} must be (V, {width}) float32, got {array.shape} {array.dtype}"
                )
        if self.triangles.ndim != 2 or self.triangles.shape[1] != 3 or self.triangles.dtype != np.uint32:
            raise InputError(
                f"mesh {self.name}: triangles must be (T, 3) uint32, got {self.triangles.shape} {self.triangles.dtype}"
            )
        if len(self.uv) != len(self.positions):
            raise InputError(f"mesh {self.name}: {len(self.positions)} positions but {len(self.uv)} uv")
        if len(self.triangles) == 0:
            raise InputError(f"mesh {self.name}: has no triangles")
        if int(self.triangles.max()) >= len(self.positions):
            raise InputError(
                f"mesh {self.name}: triangle index {int(self.triangles.max())} is out of range, "
                f"there are {len(self.positions)} vertices"
            )
        if not (np.isfinite(self.positions).all() and np.isfinite(self.uv).all()):
            raise InputError(f"mesh {self.name}: has vertices or uv that are not finite")

    @property
    def radius(self) -> float:
        """Largest distance of a vertex from the origin, model units."""
        return float(np.sqrt((self.positions.astype(np.float64) ** 2).sum(axis=1).max()))


def make_mesh(name: str, positions: object, uv: object, triangles: object) -> Mesh:
    """Build a `Mesh` from anything array-like, converting to its dtypes.

    Args:
        name: see `Mesh`.
        positions: (V, 3), model units.
        uv: (V, 2).
        triangles: (T, 3) indices.

    Raises:
        InputError: where shapes, indices or values are wrong.
    """
    index = np.asarray(triangles, np.int64).reshape(-1, 3)
    if len(index) and int(index.min()) < 0:
        raise InputError(f"mesh {name}: triangle index {int(index.min())} is negative")
    return Mesh(
        name,
        np.ascontiguousarray(positions, np.float32),
        np.ascontiguousarray(uv, np.float32),
        np.ascontiguousarray(index, np.uint32),
    )


def merged(name: str, parts: Sequence[Mesh]) -> Mesh:
    """Join meshes into one, vertices in the order given."""
    offsets = np.cumsum([0] + [len(part.positions) for part in parts[:-1]])
    return make_mesh(
        name,
        np.concatenate([part.positions for part in parts]),
        np.concatenate([part.uv for part in parts]),
        np.concatenate([part.triangles.astype(np.int64) + offset for part, offset in zip(parts, offsets, strict=True)]),
    )


def normalised(mesh: Mesh) -> Mesh:
    """Centre a mesh's bounding box on the origin and scale it to radius 1; its UV scales along.

    Raises:
        InputError: where all vertices coincide.
    """
    positions = mesh.positions.astype(np.float64)
    centred = positions - (positions.min(axis=0) + positions.max(axis=0)) / 2
    radius = float(np.sqrt((centred**2).sum(axis=1).max()))
    if not radius > 0:
        raise InputError(f"mesh {mesh.name}: has no extent")
    return make_mesh(mesh.name, centred / radius, mesh.uv.astype(np.float64) / radius, mesh.triangles)


def without_degenerate(mesh: Mesh) -> Mesh:
    """Drop triangles of no area, and the vertices that nothing uses any more.

    A triangle counts as one of no area where its height is below a millionth of the mesh's radius: nothing of it can
    be seen, and its normal and texture direction are noise.

    Raises:
        InputError: where no triangle is left.
    """
    corners = mesh.positions.astype(np.float64)[mesh.triangles]
    double_areas = lengths(cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    longest = lengths(corners - corners[:, [2, 0, 1]]).max(axis=1)
    sound = double_areas > 1e-6 * mesh.radius * longest
    kept = mesh.triangles[sound]
    used = np.zeros(len(mesh.positions), bool)
    used[kept] = True
    if sound.all() and used.all():
        return mesh
    return make_mesh(mesh.name, mesh.positions[used], mesh.uv[used], (np.cumsum(used) - 1)[kept])
