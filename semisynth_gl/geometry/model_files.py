"""Loads the user's models from files with trimesh: positions, triangles and UV maps.

Materials, colours and textures are dropped. Nothing is downloaded, and no file outside the model's folder is opened.
"""

import io
import json
import logging
import warnings
import zipfile
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import trimesh
from trimesh.exchange import load as trimesh_load
from trimesh.resolvers import FilePathResolver

from semisynth_gl.geometry.mesh import Floats, Mesh
from semisynth_gl.geometry.model_units import Surface, join_surfaces
from semisynth_gl.inputs.errors import InputError, SkippedFile, cut
from semisynth_gl.inputs.user_files import IS_LFS_POINTER, LFS_POINTER, files_below

# Maximum size of a model's file, of a .zip's unpacked content, and of all files together that a model refers to.
MAX_BYTES = 256 << 20
# Maximum numbers of triangles and vertices of a model. A part that occurs several times in the scene counts each time.
MAX_TRIANGLES, MAX_VERTICES = 2_000_000, 20_000_000

# Keeps trimesh's messages off standard error if the application has not set up logging.
logging.getLogger("trimesh").addHandler(logging.NullHandler())

# Formats of trimesh, some of which need packages that may be missing, and formats that trimesh cannot read.
_FORMATS = (*trimesh_load.mesh_loaders, *trimesh.available_formats(), "zip")
_UNREADABLE = ("fbx", "usd", "usda", "usdc", "usdz", "blend", "3ds", "max")
_ENDINGS = tuple(f".{suffix}" for suffix in (*_FORMATS, *_UNREADABLE))


def load_models(folders: Sequence[Path]) -> tuple[list[Mesh], list[SkippedFile]]:
    """Read all models in folders and their subfolders; each file becomes one model, see `make_model`.

    Files in formats that are not models are ignored. Returns the models, named by their paths relative to the folder
    and in the order of folders and paths, and the unusable files with reasons. Raises InputError if a folder does not
    exist, or no file has a usable model.
    """
    meshes, skipped = list[Mesh](), list[SkippedFile]()
    for folder in folders:
        if not folder.is_dir():
            found = "is a file" if folder.exists() else "does not exist"
            raise InputError(f"models: expected a folder, but {folder} {found}")
        for path in sorted(files_below(folder)):
            if not path.name.lower().endswith(_ENDINGS):
                continue
            try:
                meshes.append(join_surfaces(path.relative_to(folder).as_posix(), read_surfaces(path)))
            except InputError as error:
                skipped.append(SkippedFile(path, error.text))
    if not meshes:
        where = ", ".join(str(folder) for folder in folders)
        reasons = "".join(f"\n  {broken}" for broken in skipped)
        raise InputError(f"models: expected at least one usable model in {where}, found none{reasons}")
    return meshes, skipped


def read_surfaces(path: Path) -> list[Surface]:
    """Read the parts of a model's file that have triangles, in the scene's frame; a part may occur several times.

    Raises InputError if the file cannot be read, refers to a file outside its folder, exceeds a limit, or has vertices
    that are not finite or indices out of range. The message is a clause such as "has no triangles".
    """
    suffix = path.suffix.lower().removeprefix(".")
    if suffix not in trimesh.available_formats():
        raise InputError(f"has a format that trimesh cannot read here ({path.suffix}): save it as .glb")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return _surfaces(_scene(path, suffix))
    except InputError:
        raise
    except Exception as error:  # trimesh may raise any error for a damaged file
        text = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(f"cannot be read ({cut(text, 120)})") from error


def _scene(path: Path, suffix: str) -> trimesh.Scene:
    content = _read(path, MAX_BYTES)
    if zipfile.is_zipfile(io.BytesIO(content)):  # .zip, .3mf, .3dxml and .zae
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            _require_at_most(MAX_BYTES, "bytes once unpacked", sum(info.file_size for info in archive.infolist()))
    if suffix in {"glb", "gltf"}:
        _check_gltf(content)
    if suffix in {"obj", "off"}:  # trimesh needs a further package for Latin-1, and cannot read a byte order mark
        content = content.decode("utf-8-sig", errors="replace").encode()
    return trimesh.load_scene(
        io.BytesIO(content),
        file_type=suffix,
        resolver=_FolderResolver(path),
        process=False,
        allow_remote=False,
        # Skips reading textures. In glTF, trimesh would also skip the UV map.
        skip_materials=suffix not in {"glb", "gltf"},
    )


def _read(path: Path, limit: int) -> bytes:
    with path.open("rb") as file:
        content = file.read(limit + 1)
    _require_at_most(limit, f"bytes in {path.name}", len(content))
    if content.startswith(LFS_POINTER):
        raise InputError(f"{IS_LFS_POINTER} ({path.name})")
    return content


def _check_gltf(gltf: bytes) -> None:
    """Refuse a glTF or GLB file whose JSON is damaged, which needs a missing decoder, or has too many vertices."""
    # The header of a GLB file has 12 bytes; then follow length and kind of the JSON.
    is_binary = gltf.startswith(b"glTF")
    document = json.loads(gltf[20 : 20 + int.from_bytes(gltf[12:16], "little")] if is_binary else gltf)
    unreadable = {"EXT_meshopt_compression"} | (set() if find_spec("DracoPy") else {"KHR_draco_mesh_compression"})
    for name in unreadable.intersection(document.get("extensionsRequired", [])):
        raise InputError(f"is compressed with {name}: save it without compression")
    # Check before trimesh allocates memory: an accessor may declare more elements than the file has bytes, and trimesh
    # copies vertices that primitives share.
    counts = [accessor["count"] for accessor in document.get("accessors", [])]
    attributes_of = [primitive["attributes"] for mesh in document.get("meshes", []) for primitive in mesh["primitives"]]
    vertices = sum(counts[attributes["POSITION"]] for attributes in attributes_of if "POSITION" in attributes)
    _require_at_most(MAX_VERTICES, "vertices", max([*counts, vertices]))


def _surfaces(scene: trimesh.Scene) -> list[Surface]:
    # Scenes may also have point clouds and lines.
    parts = [
        (part, np.asarray(scene_from_part, np.float64))
        for scene_from_part, name in (scene.graph[node] for node in scene.graph.nodes_geometry)
        if isinstance(part := scene.geometry[name], trimesh.Trimesh) and len(part.faces) > 0
    ]
    _require_at_most(MAX_TRIANGLES, "triangles", sum(len(part.faces) for part, _ in parts))
    _require_at_most(MAX_VERTICES, "vertices", sum(len(part.vertices) for part, _ in parts))
    return [_surface(part, scene_from_part) for part, scene_from_part in parts]


def _surface(part: trimesh.Trimesh, scene_from_part: Floats) -> Surface:
    local = np.asarray(part.vertices, np.float64)
    triangles = np.asarray(part.faces, np.int64)
    if triangles.min() < 0 or triangles.max() >= len(local):
        raise InputError(f"has a triangle index out of range, there are {len(local)} vertices")
    positions = local @ scene_from_part[:3, :3].T + scene_from_part[:3, 3]
    if bad := int((~np.isfinite(positions)).any(axis=1).sum()):
        raise InputError(f"has {bad} vertices that are not finite")
    if np.linalg.det(scene_from_part[:3, :3]) < 0:  # a mirrored part would be turned inside out
        triangles = triangles[:, ::-1]
    uv = getattr(part.visual, "uv", None)
    if uv is None or np.shape(uv) != (len(local), 2):
        return positions, triangles, None
    # trimesh's v points upwards.
    return positions, triangles, np.asarray(uv, np.float64) * (1, -1) + np.array([0, 1])


def _require_at_most(limit: int, what: str, count: int) -> None:
    if count > limit:
        raise InputError(f"has {count:,} {what}, the limit is {limit:,}: simplify it, for example in MeshLab")


class _FolderResolver(FilePathResolver):
    """Reads the files that a model refers to, only from its folder and subfolders, and up to `MAX_BYTES` in total."""

    def __init__(self, model: Path) -> None:
        super().__init__(str(model))
        self._folder = model.parent.resolve()
        self._bytes_left = MAX_BYTES

    def get(self, name: str) -> bytes:
        path = (self._folder / name).resolve()
        if not path.is_relative_to(self._folder) or not path.is_file():
            raise InputError(f"refers to {cut(name)!r}, expected a file in the model's folder or a subfolder")
        content = _read(path, self._bytes_left)
        self._bytes_left -= len(content)
        return content
