"""Files of the user's models as normalised meshes with UV in model units.

Only surfaces count: positions, triangles, UV maps. Materials, colours and textures are dropped, so that colours may be
not finite, while a single position that is not finite breaks the model.
"""

from collections.abc import Collection, Iterator, Sequence
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.errors import InputError, Skipped
from semisynth_gl.geometry.mesh import Mesh, make_mesh, merged, normalised, without_degenerate
from semisynth_gl.geometry.model_parts import BrokenModelError, PlacedParts
from semisynth_gl.geometry.model_process import ModelReader
from semisynth_gl.geometry.unwrap import project_uv
from semisynth_gl.user_files import files_below, of_kernel

UV_LOSS = 0.5
"""Largest share of a part's surface without usable UV; where it is larger, the part's UV map is not used at all."""

PULL_LIMIT = 16
"""UV of a triangle is unusable where the texture is stretched this many times as much as on the rest of its part."""


def load_models(folders: Sequence[Path]) -> tuple[list[Mesh], list[Skipped]]:
    """Read all models in folders and below, in the order of the folders and of the paths in each folder.

    The parts of a file are joined as its nodes place them. Parts keep their UV map, scaled to model units; parts and
    single triangles without usable UV get it from `project_uv`. Files of other formats are ignored. Nothing is
    downloaded.

    Args:
        folders: folders, or single files.

    Returns:
        The models, named by their paths relative to the folder, and the broken files with a reason each.

    Raises:
        InputError: where a folder does not exist, or no file has a usable model.
    """
    for folder in folders:
        if of_kernel(folder):
            raise InputError(f"models: expected a folder or a file on a disk, but {folder} is the kernel's")
        if not folder.exists():
            raise InputError(f"models: expected a folder or a file, but {folder} does not exist")
    with ModelReader() as reader:
        meshes: list[Mesh] = []
        skipped: list[Skipped] = []
        for path, name in _files(folders, reader.formats):
            try:
                with np.errstate(all="ignore"):
                    meshes.append(_joined(name, list(_placed(reader.read(path)))))
            except BrokenModelError as error:
                skipped.append(Skipped(path, str(error)))
    if not meshes:
        where = ", ".join(str(folder) for folder in folders)
        reasons = "".join(f"\n  {broken}" for broken in skipped)
        raise InputError(f"models: expected at least one usable model in {where}, found none{reasons}")
    return meshes, skipped


def _files(folders: Sequence[Path], formats: Collection[str]) -> Iterator[tuple[Path, str]]:
    """Yield the files that are given, and those of a known format in folders, each with its name."""
    endings = tuple(f".{suffix}" for suffix in formats)
    for folder in folders:
        if not folder.is_dir():
            yield folder, folder.name
            continue
        for path in sorted(files_below(folder)):
            if path.name.lower().endswith(endings):
                yield path, path.relative_to(folder).as_posix()


_Part = tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64] | None]
"""Positions (V, 3), triangles (T, 3), and UV (V, 2) with v downwards where the file has a UV map."""


def _placed(read: PlacedParts) -> Iterator[_Part]:
    """Yield the parts of a model, once for each node that places them, in the scene's frame."""
    for number, transform in zip(read.placed, read.scene_from_part, strict=True):
        part = read.parts[number]
        local, triangles = part.vertices, part.triangles
        index = triangles.min() if triangles.min() < 0 else triangles.max()
        if not 0 <= index < len(local):
            raise BrokenModelError(f"has triangle index {index} out of range, there are {len(local)} vertices")
        _require_finite(local, "vertices")
        positions = local @ transform[:3, :3].T + transform[:3, 3]
        _require_finite(positions, "vertices once its nodes are placed")
        if np.linalg.det(transform[:3, :3]) < 0:  # a mirrored part keeps its outside
            triangles = triangles[:, ::-1]
        used, renumbered = np.unique(triangles, return_inverse=True)
        # v points upwards in all formats, as trimesh returns it.
        downwards = None if part.uv is None else part.uv[used] * (1, -1) + np.array([0, 1])
        yield positions[used], renumbered.reshape(-1, 3), downwards


def _require_finite(positions: NDArray[np.float64], what: str) -> None:
    for is_bad, label in ((np.isnan(positions), "NaN"), (np.isinf(positions), "infinite")):
        if is_bad.any():
            raise BrokenModelError(f"has {int(is_bad.any(axis=1).sum())} {label} {what}")


def _joined(name: str, parts: list[_Part]) -> Mesh:
    """Join parts to one normalised mesh."""
    if not parts:
        raise BrokenModelError("has no triangles")
    # In float64, before anything is rounded: a model may stand far from its origin, or be of any size.
    vertices = np.concatenate([positions for positions, _, _ in parts])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre = low / 2 + high / 2
    extent = float(np.abs(high / 2 - low / 2).max())
    if not extent > 0 or extent < 1e-9 * float(np.abs(centre).max()):
        raise BrokenModelError("has no extent")
    try:
        unwrapped = [_unwrapped(name, (positions - centre) / extent, faces, uv) for positions, faces, uv in parts]
        # Normalised twice, since vertices without a triangle may have widened the bounding box.
        return normalised(without_degenerate(normalised(merged(name, list(chain(*unwrapped))))))
    except InputError as error:
        raise BrokenModelError("has no triangle with an area") from error


def _unwrapped(
    name: str, positions: NDArray[np.float64], triangles: NDArray[np.int64], uv: NDArray[np.float64] | None
) -> list[Mesh]:
    """Return a part with its UV map in model units where the map is usable, and projected UV elsewhere."""
    if uv is None:
        return [project_uv(name, positions, triangles)]
    area, uv_area, pull = _texture_pull(positions[triangles], uv[triangles])
    mapped = (area > 0) & np.isfinite(pull)
    if area[mapped].sum() <= UV_LOSS * area.sum():
        return [project_uv(name, positions, triangles)]
    # The texture is finer than this scale on half of the surface. A mean would be decided by a few triangles that fill
    # much of the map, such as eyes on a body of one colour.
    factor = np.sqrt(area[mapped] / uv_area[mapped])
    order = np.argsort(factor, kind="stable")
    share = np.cumsum(area[mapped][order])
    scale = float(factor[order][np.searchsorted(share, share[-1] / 2)])
    usable = (area == 0) | (mapped & (pull < PULL_LIMIT * scale))
    if area[usable].sum() <= UV_LOSS * area.sum():
        return [project_uv(name, positions, triangles)]
    kept = make_mesh(name, positions, np.where(np.isfinite(uv), uv, 0) * scale, triangles[usable])
    return [kept] if usable.all() else [kept, project_uv(name, positions, triangles[~usable])]


def _texture_pull(
    corners: NDArray[np.float64], uv: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return twice the area of triangles, twice their UV area, and how far the texture is pulled over them; (T,) each.

    The pull is the largest ratio of a length to its length in UV, over all directions. It is infinite or NaN where the
    UV map has collapsed. Corners are (T, 3, 3), UV is (T, 3, 2).
    """
    # Squared ratios are eigenvalues of inv(T) S; S and T hold inner products of two edges, on the surface and in UV.
    a, b, c = _inner_products(np.diff(corners, axis=1))
    p, q, r = _inner_products(np.diff(uv, axis=1))
    with np.errstate(all="ignore"):
        determinant, uv_determinant = a * c - b * b, p * r - q * q
        half_trace = (c * p - 2 * b * q + a * r) / 2
        root = np.sqrt(np.maximum(half_trace**2 - determinant * uv_determinant, 0))
        pull = np.sqrt((half_trace + root) / uv_determinant)
        return np.sqrt(np.maximum(determinant, 0)), np.sqrt(np.maximum(uv_determinant, 0)), pull


def _inner_products(edges: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Return the products first by first, first by second and second by second of edges, (T, 2, D); (T,) each."""
    first, second = edges[:, 0], edges[:, 1]
    return (first * first).sum(axis=1), (first * second).sum(axis=1), (second * second).sum(axis=1)
