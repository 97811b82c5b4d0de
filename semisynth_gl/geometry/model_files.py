"""Loads the user's models from files.

Only surfaces count: positions, triangles, UV maps. Materials, colours and textures are dropped, so a colour that is not
finite does no harm, whereas a single position that is not finite makes the model unusable.
"""

import logging
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from semisynth_gl.geometry.mesh import Floats, Mesh
from semisynth_gl.geometry.model_parts import BrokenModelError, PlacedParts
from semisynth_gl.geometry.model_process import ModelReader
from semisynth_gl.geometry.model_units import Surface, join_surfaces
from semisynth_gl.inputs.errors import InputError, Skipped
from semisynth_gl.inputs.user_files import files_below, of_kernel

# Reading a smaller file takes a second or two; larger files are logged.
_LARGE_BYTES = 10_000_000

# Formats of models that trimesh does not know.
_NOT_READ = ("fbx", "usd", "usda", "usdc", "usdz", "blend", "3ds", "max")

_LOG = logging.getLogger(__name__)


def load_models(folders: Sequence[Path]) -> tuple[list[Mesh], list[Skipped]]:
    """Read all models in folders and below, in the order of the folders and of the paths in each folder.

    ``folders`` may also name single files. The parts of a file are joined as its nodes place them, and the model is
    normalised. Parts keep their UV map, scaled to model units; parts and single triangles without usable UV get it from
    `project_uv`. Files in formats that trimesh does not know are ignored, but those of models are reported. Nothing is
    downloaded.

    Returns the models, named by their paths relative to the folder, and the unusable files, each with a reason. Raises
    InputError where a folder does not exist or is not on a disk, or no file has a usable model.
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
            with suppress(OSError):  # a file that cannot be read is reported below
                if (size := path.stat().st_size) >= _LARGE_BYTES:
                    _LOG.info("reading %s, %d MB", name, size // 1_000_000)
            try:
                with np.errstate(all="ignore"):
                    meshes.append(join_surfaces(name, list(_placed(reader.read(path)))))
            except BrokenModelError as error:
                skipped.append(Skipped(path, str(error)))
    if not meshes:
        where = ", ".join(str(folder) for folder in folders)
        reasons = "".join(f"\n  {broken}" for broken in skipped)
        raise InputError(f"models: expected at least one usable model in {where}, found none{reasons}")
    return meshes, skipped


def _files(folders: Sequence[Path], formats: Collection[str]) -> Iterator[tuple[Path, str]]:
    """Yield the given files, and the files of a known format in the given folders, each with its name."""
    endings = tuple(f".{suffix}" for suffix in {*formats, *_NOT_READ})
    for folder in folders:
        if not folder.is_dir():
            yield folder, folder.name
            continue
        for path in sorted(files_below(folder)):
            if path.name.lower().endswith(endings):
                yield path, path.relative_to(folder).as_posix()


def _placed(read: PlacedParts) -> Iterator[Surface]:
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
        if np.linalg.det(transform[:3, :3]) < 0:  # reversed, so that the outside of a mirrored part stays outside
            triangles = triangles[:, ::-1]
        used, renumbered = np.unique(triangles, return_inverse=True)
        # v points upwards in all formats, as trimesh returns it.
        downwards = None if part.uv is None else part.uv[used] * (1, -1) + np.array([0, 1])
        yield positions[used], renumbered.reshape(-1, 3), downwards


def _require_finite(positions: Floats, what: str) -> None:
    for is_bad, label in ((np.isnan(positions), "NaN"), (np.isinf(positions), "infinite")):
        if is_bad.any():
            raise BrokenModelError(f"has {int(is_bad.any(axis=1).sum())} {label} {what}")
