"""Loads the user's models from files, with trimesh: their triangles and UV.

Only surfaces count: positions, triangles, UV maps. Materials, colours and textures are dropped. Nothing is downloaded,
and nothing is opened outside the folder that a model lies in.
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
from semisynth_gl.inputs.errors import InputError, Skipped, cut, described
from semisynth_gl.inputs.user_files import IS_LFS_POINTER, LFS_POINTER, files_below

MAX_BYTES = 256 << 20
"""Most bytes of a model's file, unpacked, and of the files that it refers to."""

MAX_TRIANGLES, MAX_VERTICES = 2_000_000, 20_000_000
"""Most triangles and vertices of a model, counted as often as its nodes place them."""

# Keeps trimesh's messages off standard error where the application has not set up logging.
logging.getLogger("trimesh").addHandler(logging.NullHandler())

# trimesh knows the formats of the first group, some of them with a package that may not be installed.
_FORMATS = (*trimesh_load.mesh_loaders, *trimesh.available_formats(), "zip")
_NOT_READ = ("fbx", "usd", "usda", "usdc", "usdz", "blend", "3ds", "max")
_ENDINGS = tuple(f".{suffix}" for suffix in (*_FORMATS, *_NOT_READ))


def load_models(folders: Sequence[Path]) -> tuple[list[Mesh], list[Skipped]]:
    """Read all models in folders and below, in the order of the folders and of the paths in each folder.

    The parts of a file are joined as its nodes place them, and the model is normalised. Parts keep their UV map, scaled
    to model units; parts and single triangles without usable UV get it from `project_uv`. Models in formats that are
    not read are reported, other files ignored.

    Returns the models, named by their paths relative to the folder, and the unusable files, each with a reason. Raises
    InputError where a folder does not exist, or no file has a usable model.
    """
    meshes, skipped = list[Mesh](), list[Skipped]()
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
                skipped.append(Skipped(path, error.text))
    if not meshes:
        where = ", ".join(str(folder) for folder in folders)
        reasons = "".join(f"\n  {broken}" for broken in skipped)
        raise InputError(f"models: expected at least one usable model in {where}, found none{reasons}")
    return meshes, skipped


def read_surfaces(path: Path) -> list[Surface]:
    """Read the parts of a model's file that have triangles, once for each node that places them, in the scene's frame.

    Raises InputError where the file cannot be read, refers to a file elsewhere, exceeds a limit, or has vertices that
    are not finite or triangles whose indices are out of range; its text is a clause about the file.
    """
    suffix = path.suffix.lower().removeprefix(".")
    if suffix not in trimesh.available_formats():
        raise InputError(f"is not of a kind that trimesh reads here ({path.suffix}): save it as .glb")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return _surfaces(_scene(path, suffix))
    except InputError:
        raise
    except Exception as error:  # a reader may throw anything at a hostile file
        clause = cut(" ".join(described(error).split()), 120)
        raise InputError(f"cannot be read ({clause})") from error


def _scene(path: Path, suffix: str) -> trimesh.Scene:
    content = _read(path, MAX_BYTES)
    if zipfile.is_zipfile(io.BytesIO(content)):  # as .zip, .3mf, .3dxml and .zae are
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            _require_at_most(MAX_BYTES, "bytes once unpacked", sum(info.file_size for info in archive.infolist()))
    if suffix in {"glb", "gltf"}:  # trimesh would look for another file, whatever is wrong with a .gltf
        _check_gltf(content)
    if suffix in {"obj", "off"}:  # trimesh needs a further package for a comment in Latin-1, and takes no BOM
        content = content.decode("utf-8-sig", errors="replace").encode()
    return trimesh.load_scene(
        io.BytesIO(content),
        file_type=suffix,
        resolver=_ModelFolder(path),
        process=False,
        allow_remote=False,
        # Their textures would be read for nothing. glTF's loader drops the UV map along with the material.
        skip_materials=suffix not in {"glb", "gltf"},
    )


def _read(path: Path, most: int) -> bytes:
    with path.open("rb") as file:
        content = file.read(most + 1)
    _require_at_most(most, f"bytes in {path.name}", len(content))
    if content.startswith(LFS_POINTER):
        raise InputError(f"{IS_LFS_POINTER} ({path.name})")
    return content


def _check_gltf(gltf: bytes) -> None:
    """Refuse a glTF or GLB file that requires a compression which is not read here, or declares too many vertices."""
    text = gltf
    if gltf.startswith(b"glTF"):  # a header of 12 bytes, then the length and the kind of the chunk of JSON
        text = gltf[20 : 20 + int.from_bytes(gltf[12:16], "little")]
    document = json.loads(text)
    not_read = {"EXT_meshopt_compression"} | ({"KHR_draco_mesh_compression"} if find_spec("DracoPy") is None else set())
    for name in not_read.intersection(document.get("extensionsRequired", [])):
        raise InputError(f"is compressed with {name}: save it without compression")
    # Counted before trimesh allocates them: an accessor may have more elements than the file has bytes, and trimesh
    # copies vertices that primitives share.
    counts = [accessor["count"] for accessor in document.get("accessors", [])]
    attributes_of = [primitive["attributes"] for mesh in document.get("meshes", []) for primitive in mesh["primitives"]]
    vertices = sum(counts[attributes["POSITION"]] for attributes in attributes_of if "POSITION" in attributes)
    _require_at_most(MAX_VERTICES, "vertices", max([*counts, vertices]))


def _surfaces(scene: trimesh.Scene) -> list[Surface]:
    """Return the triangle meshes of a scene, once for each node that places them, in the scene's frame."""
    placed = [
        (part, np.asarray(scene_from_part, np.float64))
        for scene_from_part, name in (scene.graph[node] for node in scene.graph.nodes_geometry)
        # Point clouds and lines have no surface.
        if isinstance(part := scene.geometry[name], trimesh.Trimesh) and len(part.faces) > 0
    ]
    _require_at_most(MAX_TRIANGLES, "triangles", sum(len(part.faces) for part, _ in placed))
    _require_at_most(MAX_VERTICES, "vertices", sum(len(part.vertices) for part, _ in placed))
    return [_surface(part, scene_from_part) for part, scene_from_part in placed]


def _surface(part: trimesh.Trimesh, scene_from_part: Floats) -> Surface:
    local = np.asarray(part.vertices, np.float64)
    triangles = np.asarray(part.faces, np.int64)
    if triangles.min() < 0 or triangles.max() >= len(local):
        raise InputError(f"has a triangle index out of range, there are {len(local)} vertices")
    positions = local @ scene_from_part[:3, :3].T + scene_from_part[:3, 3]
    if bad := int((~np.isfinite(positions)).any(axis=1).sum()):
        raise InputError(f"has {bad} vertices that are not finite")
    if np.linalg.det(scene_from_part[:3, :3]) < 0:  # reversed, so that the outside of a mirrored part stays outside
        triangles = triangles[:, ::-1]
    upwards = getattr(part.visual, "uv", None)  # in all formats, as trimesh returns it
    if upwards is None or np.shape(upwards) != (len(local), 2):
        return positions, triangles, None
    return positions, triangles, np.asarray(upwards, np.float64) * (1, -1) + np.array([0, 1])


def _require_at_most(limit: int, what: str, count: int) -> None:
    if count > limit:
        how = "decimate the model, for example in MeshLab or Blender"
        raise InputError(f"has {count:,} {what}, the limit is {limit:,}: {how}")


class _ModelFolder(FilePathResolver):
    """Gives trimesh only files in a model's folder and below, and no more than `MAX_BYTES` of them."""

    def __init__(self, model: Path) -> None:
        super().__init__(str(model))
        self._folder = model.parent.resolve()
        self._left = MAX_BYTES

    def get(self, name: str) -> bytes:
        path = (self._folder / name).resolve()
        if not path.is_relative_to(self._folder) or not path.is_file():
            raise InputError(f"refers to {cut(name)!r}, expected a file in the model's folder or below it")
        content = _read(path, self._left)
        self._left -= len(content)
        return content
