"""Reads a model's file with trimesh: its triangles and UV, and nothing from outside the folder that it lies in."""

import bz2
import gzip
import io
import json
import logging
import tarfile
import warnings
import zipfile
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import trimesh
from trimesh.exchange import load as trimesh_load
from trimesh.resolvers import Resolver, ZipResolver

from semisynth_gl.geometry.model_parts import BrokenModelError, Part, PlacedParts
from semisynth_gl.inputs.errors import cut, described, shown
from semisynth_gl.inputs.user_files import IS_LFS_POINTER, LFS_POINTER, open_file

MAX_BYTES = 256 << 20
"""Most bytes of a model's file together with the files that it refers to, unpacked."""

MAX_TRIANGLES, MAX_VERTICES, MAX_PARTS = 2_000_000, 20_000_000, 20_000
"""Most triangles, vertices and parts of a model, counted as often as its nodes place them.

Vertices that several parts share count once for each part.
"""

# Keeps trimesh's messages off standard error where the application has not set up logging.
logging.getLogger("trimesh").addHandler(logging.NullHandler())

_ARCHIVES = frozenset(trimesh_load.compressed_loaders)

FORMATS = frozenset({*trimesh_load.mesh_loaders, *_ARCHIVES, *trimesh.available_formats()})
"""File name suffixes that trimesh knows, without the leading dot; some need a package that may not be installed."""

# Packages that trimesh needs for a format.
_PACKAGES = {
    **dict.fromkeys(("dae", "zae"), "pycollada"),
    **dict.fromkeys(("3mf", "3dxml", "xaml"), "lxml networkx"),
    **dict.fromkeys(("step", "stp"), "cascadio"),
}
_COMPRESSIONS = {"KHR_draco_mesh_compression": "Draco", "EXT_meshopt_compression": "meshopt"}

_TEXT_FORMATS = frozenset({"gltf", "obj", "off", "stl", "stl_ascii", "xyz"})

_LIMIT = f"the limit is {MAX_BYTES:,} bytes: decimate the model, for example in MeshLab or Blender"


def read_parts(path: Path) -> PlacedParts:
    """Read the parts of a model's file that have triangles, in the order of the nodes that place them.

    Files that it refers to are looked for in its own folder and below. Nothing is downloaded; materials and textures
    are left out.

    Raises:
        BrokenModelError: where the file cannot be read, refers to a file elsewhere, or exceeds a limit.
        MemoryError: where the reader needs more memory than this process may have.
    """
    suffix = max((kind for kind in FORMATS if path.name.lower().endswith(f".{kind}")), key=len, default=None)
    if suffix is None:
        kind = path.suffix or path.name
        raise BrokenModelError(f"is of a kind that is not read ({kind}): save it as .glb, for example in Blender")
    if suffix not in trimesh.available_formats():
        how = f": pip install {_PACKAGES[suffix]}" if suffix in _PACKAGES else ""
        raise BrokenModelError(f"needs a package that is not installed for trimesh to read {path.suffix} files{how}")
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            content = _read(path, MAX_BYTES)
            if suffix in _ARCHIVES:
                scenes = _scenes_in_archive(path, suffix, content)
            else:
                # Materials are skipped, since their textures would be read for nothing. Not for glTF, whose loader
                # drops the UV map along with the material.
                beside, skip_materials = _Neighbours(path, MAX_BYTES - len(content)), suffix not in {"glb", "gltf"}
                scenes = [_scene(content, suffix, beside, skip_materials=skip_materials)]
            return _placed_parts(scenes)
        except (BrokenModelError, MemoryError):
            raise
        except Exception as error:  # a reader may throw anything at a hostile file
            clause = cut(" ".join(described(error).split()), 120)
            raise BrokenModelError(f"cannot be read ({clause})") from error


def _check_compression(gltf: bytes) -> None:
    """Refuse a glTF or GLB file that requires a compression which is not read here."""
    text = gltf
    if gltf.startswith(b"glTF"):  # a header of 12 bytes, then the length and the kind of the chunk of JSON
        text = gltf[20 : 20 + int.from_bytes(gltf[12:16], "little")]
    required = json.loads(text).get("extensionsRequired", [])
    for name in filter(_COMPRESSIONS.__contains__, required):
        if name == "KHR_draco_mesh_compression" and find_spec("DracoPy") is not None:
            continue
        hint = ", or pip install DracoPy" if "draco" in name else ""
        raise BrokenModelError(f"is compressed with {_COMPRESSIONS[name]}: save it without compression{hint}")


def _scene(content: bytes, suffix: str, resolver: Resolver, *, skip_materials: bool) -> trimesh.Scene:
    if zipfile.is_zipfile(io.BytesIO(content)):  # as 3mf, 3dxml and zae are
        _require_room(_unpacked_size(content))
    content = _in_utf8(content, suffix)
    if suffix in {"glb", "gltf"}:  # trimesh would look for another file, whatever is wrong with a .gltf
        _check_compression(content)
    return trimesh.load_scene(
        io.BytesIO(content),
        file_type=suffix,
        resolver=resolver,
        process=False,
        allow_remote=False,
        skip_materials=skip_materials,
    )


def _in_utf8(content: bytes, suffix: str) -> bytes:
    """Return a file's content with its text in UTF-8; text in another encoding is taken for Latin-1.

    For other encodings trimesh needs a further package, though often only a comment is in Latin-1.
    """
    text = b""
    if suffix == "ply":
        text = content.partition(b"end_header")[0]
    elif suffix in _TEXT_FORMATS and not _is_binary_stl(content, suffix):
        text = content
    try:
        text.decode()
    except UnicodeDecodeError:
        return text.decode("latin-1").encode() + content[len(text) :]
    return content


def _is_binary_stl(content: bytes, suffix: str) -> bool:
    return suffix == "stl" and len(content) == 84 + 50 * int.from_bytes(content[80:84], "little")


def _placed_parts(scenes: list[trimesh.Scene]) -> PlacedParts:
    """Return the triangle meshes of scenes, and the nodes that place them."""
    meshes: list[trimesh.Trimesh] = []
    placed, matrices = [], []
    for scene in scenes:
        numbers: dict[Any, int] = {}
        for node in scene.graph.nodes_geometry:
            scene_from_part, name = scene.graph[node]
            geometry = scene.geometry[name]
            if not isinstance(geometry, trimesh.Trimesh) or len(geometry.faces) == 0:
                continue  # point clouds and lines have no surface
            if name not in numbers:
                numbers[name] = len(meshes)
                meshes.append(geometry)
            placed.append(numbers[name])
            matrices.append(np.asarray(scene_from_part, np.float64))
    for limit, what, count in (
        (MAX_PARTS, "parts", len(placed)),
        (MAX_TRIANGLES, "triangles", sum(len(meshes[number].faces) for number in placed)),
        (MAX_VERTICES, "vertices", sum(len(meshes[number].vertices) for number in placed)),
    ):
        if count > limit:
            how = "join them" if what == "parts" else "decimate the model"
            raise BrokenModelError(
                f"has {count:,} {what}, the limit is {limit:,}: {how}, for example in MeshLab or Blender"
            )
    return PlacedParts(
        tuple(map(_part, meshes)), np.array(placed, np.int64), np.array(matrices, np.float64).reshape(-1, 4, 4)
    )


def _part(geometry: trimesh.Trimesh) -> Part:
    vertices = np.asarray(geometry.vertices, np.float64)
    triangles = np.asarray(geometry.faces, np.int64)
    for what, array in (("vertices", vertices), ("triangles", triangles)):
        if array.ndim != 2 or array.shape[1] != 3:  # trimesh reads OBJ's lines by the length of the first
            raise BrokenModelError(f"has {what} of shape {array.shape}, expected three columns")
    uv = getattr(geometry.visual, "uv", None)
    has_uv = uv is not None and np.shape(uv) == (len(vertices), 2)
    return Part(vertices, triangles, np.asarray(uv, np.float64) if has_uv else None)


class _Neighbours(Resolver):
    """Gives trimesh only regular files in a model's folder and below, up to ``room`` bytes in all."""

    def __init__(self, model: Path, room: int) -> None:
        self.file_name = model.name  # trimesh names the parts of an OBJ file by it
        self._folder = model.parent.resolve()
        self._room = room

    def get(self, name: str) -> bytes:
        name = name.strip()
        # Tried as trimesh does: many exporters write paths of the machine that they ran on.
        for candidate in (name, name.lstrip("/"), PurePosixPath(name).name):
            try:
                # If not strict, a link to itself would leave the rest of the path unresolved, which may be a link
                # to another folder.
                path = (self._folder / candidate).resolve(strict=True)
            except (OSError, RuntimeError):  # RuntimeError for links to themselves, before Python 3.13
                continue
            if path.is_relative_to(self._folder) and path.is_file():
                content = _read(path, self._room)
                self._room -= len(content)
                return content
        raise BrokenModelError(f"refers to {shown(name)}, expected a file in the model's folder or below it")

    def keys(self) -> list[str]:
        return []

    def write(self, name: str, data: Any) -> None:  # noqa: ANN401, ARG002 - as trimesh's resolvers have it
        raise BrokenModelError(f"writes a file, {name!r}")

    def namespaced(self, namespace: str) -> "_Neighbours":
        raise BrokenModelError(f"refers to the folder {namespace!r}")


def _read(path: Path, room: int) -> bytes:
    try:
        file = open_file(path)
    except OSError as error:
        raise BrokenModelError(f"cannot be read: {error.strerror}") from error
    with file:
        content = file.read(room + 1)
        if len(content) > room:
            size = path.stat().st_size
            raise BrokenModelError(f"is too large with what it refers to ({path.name} has {size:,} bytes), {_LIMIT}")
    if content.startswith(LFS_POINTER):
        raise BrokenModelError(f"{IS_LFS_POINTER} ({path.name})")
    return content


def _scenes_in_archive(path: Path, suffix: str, content: bytes) -> list[trimesh.Scene]:
    """Load the models in an archive; members that cannot be read are ignored, unless no member can be read."""
    members = _unpacked(path, suffix, content)
    resolver = ZipResolver({name: io.BytesIO(member) for name, member in members.items()})
    scenes, first_error = [], None
    for name, member in members.items():
        kind = PurePosixPath(name.lower()).suffix[1:]
        if kind not in trimesh_load.mesh_formats():
            continue
        try:
            # glTF's UV maps are lost with the materials, as in datasets of earlier versions.
            scenes.append(_scene(member, kind, resolver, skip_materials=True))
        except MemoryError:
            raise
        except Exception as error:  # noqa: BLE001 - a reader may throw anything at a hostile file
            first_error = first_error or error
    if first_error and not scenes:
        raise first_error
    return scenes


def _unpacked(path: Path, suffix: str, content: bytes) -> Mapping[str, bytes]:
    """Return the content of each file in an archive by its name, in the archive's order."""
    if suffix.endswith("zip"):
        _require_room(_unpacked_size(content))
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            return {info.filename: archive.read(info) for info in archive.infolist() if not info.is_dir()}
    packed: gzip.GzipFile | bz2.BZ2File
    packed = gzip.GzipFile(fileobj=io.BytesIO(content)) if suffix.endswith("gz") else bz2.BZ2File(io.BytesIO(content))
    with packed:
        whole = packed.read(MAX_BYTES + 1)
    _require_room(len(whole))
    if "tar" not in suffix:
        return {path.name.removesuffix(path.suffix): whole}
    with tarfile.open(fileobj=io.BytesIO(whole), mode="r:") as archive:
        files = [member for member in archive.getmembers() if member.isfile()]
        _require_room(sum(file.size for file in files))  # a sparse file may be larger than the archive
        streams = [(file.name, archive.extractfile(file)) for file in files]
        return {name: stream.read() for name, stream in streams if stream is not None}


def _unpacked_size(content: bytes) -> int:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return sum(info.file_size for info in archive.infolist())


def _require_room(size: int) -> None:
    if size > MAX_BYTES:
        raise BrokenModelError(f"takes {size:,} bytes or more unpacked, {_LIMIT}")
