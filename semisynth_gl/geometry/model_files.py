"""Files of the user's models: any format that trimesh reads, as normalised meshes with UV in model units.

Only surfaces count: positions, triangles, UV maps. Materials, colours and textures are dropped, so that colours may be
not finite, while a single position that is not finite breaks the model.
"""

import logging
import warnings
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.exchange import load as trimesh_load

from semisynth_gl.errors import InputError, Skipped
from semisynth_gl.geometry.mesh import Mesh, make_mesh, merged, normalised, without_degenerate
from semisynth_gl.geometry.unwrap import project_uv
from semisynth_gl.user_files import files_below, of_kernel, open_file

# Keeps trimesh's messages off standard error where the application sets up no log.
logging.getLogger("trimesh").addHandler(logging.NullHandler())

UV_LOSS = 0.5
"""Largest share of a part's surface without usable UV; where it is larger, the part's UV map is not used at all."""

PULL_LIMIT = 16
"""UV of a triangle is unusable where the texture is stretched this many times as much as on the rest of its part."""


class _BrokenModelError(Exception):
    """A model is unusable; the message is a clause such as ``"has no triangles"``."""


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
    meshes: list[Mesh] = []
    skipped: list[Skipped] = []
    for folder in folders:
        if of_kernel(folder):
            raise InputError(f"models: expected a folder or a file on a disk, but {folder} is the kernel's")
        if not folder.exists():
            raise InputError(f"models: expected a folder or a file, but {folder} does not exist")
        single = not folder.is_dir()
        for path in [folder] if single else sorted(files_below(folder)):
            suffix = _model_suffix(path)
            if suffix is None and not single:
                continue
            try:
                meshes.append(_load_model(path, path.name if single else path.relative_to(folder).as_posix(), suffix))
            except _BrokenModelError as error:
                skipped.append(Skipped(path, str(error)))
    if not meshes:
        where = ", ".join(str(folder) for folder in folders)
        reasons = "".join(f"\n  {broken}" for broken in skipped)
        raise InputError(f"models: expected at least one usable model in {where}, found none{reasons}")
    return meshes, skipped


def _model_suffix(path: Path) -> str | None:
    """Return the format of a file's name, such as ``"obj"`` or ``"tar.gz"``; None where trimesh knows none."""
    known = set(trimesh_load.mesh_loaders) | set(trimesh_load.compressed_loaders) | trimesh.available_formats()
    fitting = [suffix for suffix in known if path.name.lower().endswith(f".{suffix}")]
    return max(fitting, key=len) if fitting else None


def _load_model(path: Path, name: str, suffix: str | None) -> Mesh:
    try:
        open_file(path).close()
    except OSError as error:
        raise _BrokenModelError(f"cannot be read: {error.strerror}") from error
    kind = path.suffix or path.name
    if suffix is None:
        raise _BrokenModelError(f"is of a kind that trimesh cannot read ({kind})")
    if suffix not in trimesh.available_formats():
        raise _BrokenModelError(f"needs a package that is not installed for trimesh to read {kind} files")
    # Textures of a material would be decoded for nothing. glTF's loader drops the UV map along with the material.
    skip_materials = suffix not in {"glb", "gltf"}
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            scene = trimesh.load_scene(path, process=False, allow_remote=False, skip_materials=skip_materials)
            parts = list(_parts(scene))
        except _BrokenModelError:
            raise
        except Exception as error:  # a reader may throw anything at a hostile file
            clause = " ".join(f"{type(error).__name__}: {error}".split())[:120]
            raise _BrokenModelError(f"cannot be read ({clause})") from error
    if not parts:
        raise _BrokenModelError("has no triangles")
    return _joined(name, parts)


_Part = tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64] | None]
"""Positions (V, 3), triangles (T, 3), and UV (V, 2) with v downwards where the file has a UV map."""


def _parts(scene: trimesh.Scene) -> Iterator[_Part]:
    """Yield the triangle meshes of a scene, once for each node that places them, in the scene's frame."""
    for node in scene.graph.nodes_geometry:
        scene_from_part, geometry_name = scene.graph[node]
        geometry = scene.geometry[geometry_name]
        if not isinstance(geometry, trimesh.Trimesh) or len(geometry.faces) == 0:
            continue  # point clouds and lines have no surface
        transform = np.asarray(scene_from_part, np.float64)
        local = np.asarray(geometry.vertices, np.float64)
        triangles = np.asarray(geometry.faces, np.int64)
        index = triangles.min() if triangles.min() < 0 else triangles.max()
        if not 0 <= index < len(local):
            raise _BrokenModelError(f"has triangle index {index} out of range, there are {len(local)} vertices")
        _require_finite(local, "vertices")
        positions = local @ transform[:3, :3].T + transform[:3, 3]
        _require_finite(positions, "vertices once its nodes are placed")
        if np.linalg.det(transform[:3, :3]) < 0:  # a mirrored part keeps its outside
            triangles = triangles[:, ::-1]
        used, renumbered = np.unique(triangles, return_inverse=True)
        uv = getattr(geometry.visual, "uv", None)
        has_uv = uv is not None and np.shape(uv) == (len(local), 2)
        # trimesh returns v upwards for all formats.
        downwards = np.asarray(uv, np.float64)[used] * (1, -1) + np.array([0, 1]) if has_uv else None
        yield positions[used], renumbered.reshape(-1, 3), downwards


def _require_finite(positions: NDArray[np.float64], what: str) -> None:
    for is_bad, label in ((np.isnan(positions), "NaN"), (np.isinf(positions), "infinite")):
        if is_bad.any():
            raise _BrokenModelError(f"has {int(is_bad.any(axis=1).sum())} {label} {what}")


def _joined(name: str, parts: list[_Part]) -> Mesh:
    """Join parts to one normalised mesh."""
    # In float64, before anything is rounded: a model may stand far from its origin, or be of any size.
    vertices = np.concatenate([positions for positions, _, _ in parts])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre = low / 2 + high / 2
    extent = float(np.abs(high / 2 - low / 2).max())
    if not extent > 0 or extent < 1e-9 * float(np.abs(centre).max()):
        raise _BrokenModelError("has no extent")
    try:
        unwrapped = [_unwrapped(name, (positions - centre) / extent, faces, uv) for positions, faces, uv in parts]
        # Normalised twice, since vertices without a triangle may have widened the bounding box.
        return normalised(without_degenerate(normalised(merged(name, list(chain(*unwrapped))))))
    except InputError as error:
        raise _BrokenModelError("has no triangle with an area") from error


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
