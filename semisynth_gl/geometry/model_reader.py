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

from semisynth_gl.geometry.mesh import Floats
from semisynth_gl.geometry.model_units import BrokenModelError, Surface
from semisynth_gl.inputs.errors import cut, described, shown
from semisynth_gl.inputs.user_files import IS_LFS_POINTER, LFS_POINTER

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


def read_surfaces(path: Path) -> list[Surface]:
    """Read the parts of a model's file that have triangles, once for each node that places them, in the scene's frame.

    Files that it refers to are looked for in its own folder and below. Nothing is downloaded; materials and textures
    are left out.

    Raises:
        BrokenModelError: where the file cannot be read, refers to a file elsewhere, exceeds a limit, or has vertices
            that are not finite or triangles whose indices are out of range.
        MemoryError: where there is not enough memory.
    """
    suffix = max((kind for kind in FORMATS if path.name.lower().endswith(f".{kind}")), key=len, default=None)
    if suffix is None:
        kind = path.suffix or path.name
        raise BrokenModelError(f"is of a kind that is not read ({kind}): save it as .glb, for example in Blender")
    if suffix not in trimesh.available_formats():
        how = f": pip install {_PACKAGES[suffix]}" if suffix in _PACKAGES else ""
        raise BrokenModelError(f"needs a package that is not installed for trimesh to read {path.suffix} files{how}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            content = _read(path, MAX_BYTES)
            if suffix in _ARCHIVES:
                scenes = _scenes_in_archive(path, suffix, content)
            else:
                scenes = [_scene(content, suffix, _Neighbours(path, MAX_BYTES - len(content)))]
            return _surfaces(scenes)
        except (BrokenModelError, MemoryError):
            raise
        except Exception as error:  # a reader may throw anything at a hostile file
            clause = cut(" ".join(described(error).split()), 120)
            raise BrokenModelError(f"cannot be read ({clause})") from error


def _check_gltf(gltf: bytes) -> None:
    """Refuse a glTF or GLB file that requires a compression which is not read here, or has too many vertices."""
    text = gltf
    if gltf.startswith(b"glTF"):  # a header of 12 bytes, then the length and the kind of the chunk of JSON
        text = gltf[20 : 20 + int.from_bytes(gltf[12:16], "little")]
    document = json.loads(text)
    for name in filter(_COMPRESSIONS.__contains__, document.get("extensionsRequired", [])):
        if name == "KHR_draco_mesh_compression" and find_spec("DracoPy") is not None:
            continue
        hint = ", or pip install DracoPy" if "draco" in name else ""
        raise BrokenModelError(f"is compressed with {_COMPRESSIONS[name]}: save it without compression{hint}")
    # Counted before trimesh allocates them: an accessor may have more elements than the file has bytes, and trimesh
    # copies vertices that primitives share.
    counts = [accessor["count"] for accessor in document.get("accessors", [])]
    attributes_of = [primitive["attributes"] for mesh in document.get("meshes", []) for primitive in mesh["primitives"]]
    vertices = sum(counts[attributes["POSITION"]] for attributes in attributes_of if "POSITION" in attributes)
    _require_at_most(MAX_VERTICES, "vertices", max([*counts, vertices]))


def _scene(content: bytes, suffix: str, resolver: Resolver) -> trimesh.Scene:
    if zipfile.is_zipfile(io.BytesIO(content)):  # as 3mf, 3dxml and zae are
        _require_room(_unpacked_size(content))
    content = _in_utf8(content, suffix)
    if suffix in {"glb", "gltf"}:  # trimesh would look for another file, whatever is wrong with a .gltf
        _check_gltf(content)
    return trimesh.load_scene(
        io.BytesIO(content),
        file_type=suffix,
        resolver=resolver,
        process=False,
        allow_remote=False,
        # Their textures would be read for nothing. glTF's loader drops the UV map along with the material.
        skip_materials=suffix not in {"glb", "gltf"},
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


def _surfaces(scenes: list[trimesh.Scene]) -> list[Surface]:
    """Return the triangle meshes of scenes, once for each node that places them, in the scene's frame."""
    placed = [
        (part, np.asarray(scene_from_part, np.float64))
        for scene in scenes
        for scene_from_part, name in (scene.graph[node] for node in scene.graph.nodes_geometry)
        # Point clouds and lines have no surface.
        if isinstance(part := scene.geometry[name], trimesh.Trimesh) and len(part.faces) > 0
    ]
    _require_at_most(MAX_PARTS, "parts", len(placed))
    _require_at_most(MAX_TRIANGLES, "triangles", sum(len(part.faces) for part, _ in placed))
    _require_at_most(MAX_VERTICES, "vertices", sum(len(part.vertices) for part, _ in placed))
    return [_surface(part, scene_from_part) for part, scene_from_part in placed]


def _require_at_most(limit: int, what: str, count: int) -> None:
    if count > limit:
        how = f"{'join them' if what == 'parts' else 'decimate the model'}, for example in MeshLab or Blender"
        raise BrokenModelError(f"has {count:,} {what}, the limit is {limit:,}: {how}")


def _surface(part: trimesh.Trimesh, scene_from_part: Floats) -> Surface:
    local = np.asarray(part.vertices, np.float64)
    triangles = np.asarray(part.faces, np.int64)
    for what, array in (("vertices", local), ("triangles", triangles)):
        if array.ndim != 2 or array.shape[1] != 3:  # trimesh reads OBJ's lines by the length of the first
            raise BrokenModelError(f"has {what} of shape {array.shape}, expected three columns")
    index = triangles.min() if triangles.min() < 0 else triangles.max()
    if not 0 <= index < len(local):
        raise BrokenModelError(f"has triangle index {index} out of range, there are {len(local)} vertices")
    _require_finite(local, "vertices")
    positions = local @ scene_from_part[:3, :3].T + scene_from_part[:3, 3]
    _require_finite(positions, "vertices once its nodes are placed")
    if np.linalg.det(scene_from_part[:3, :3]) < 0:  # reversed, so that the outside of a mirrored part stays outside
        triangles = triangles[:, ::-1]
    used, renumbered = np.unique(triangles, return_inverse=True)
    upwards = getattr(part.visual, "uv", None)  # in all formats, as trimesh returns it
    has_uv = upwards is not None and np.shape(upwards) == (len(local), 2)
    uv = np.asarray(upwards, np.float64)[used] * (1, -1) + np.array([0, 1]) if has_uv else None
    return positions[used], renumbered.reshape(-1, 3), uv


def _require_finite(positions: Floats, what: str) -> None:
    for is_bad, label in ((np.isnan(positions), "NaN"), (np.isinf(positions), "infinite")):
        if is_bad.any():
            raise BrokenModelError(f"has {int(is_bad.any(axis=1).sum())} {label} {what}")


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
        file = path.open("rb")
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
            scenes.append(_scene(member, kind, resolver))
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
