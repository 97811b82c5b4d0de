"""Loads the user's models from files.

Only surfaces count: positions, triangles, UV maps. Materials, colours and textures are dropped, so a colour that is not
finite does no harm, whereas a single position that is not finite makes the model unusable.
"""

import logging
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.geometry.model_units import BrokenModelError, join_surfaces
from semisynth_gl.inputs.errors import InputError, Skipped
from semisynth_gl.inputs.user_files import files_below

OUT_OF_MEMORY = "does not fit into memory: decimate the model, for example in MeshLab or Blender"
"""The only reason for leaving a model out that may be gone the next time; results with it are not cached."""

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
    InputError where a folder does not exist, or no file has a usable model.
    """
    for folder in folders:
        if not folder.exists():
            raise InputError(f"models: expected a folder or a file, but {folder} does not exist")
    from semisynth_gl.geometry.model_reader import FORMATS, read_surfaces  # noqa: PLC0415  # trimesh is slow to load

    meshes: list[Mesh] = []
    skipped: list[Skipped] = []
    for path, name in _files(folders, FORMATS):
        with suppress(OSError):  # a file that cannot be read is reported below
            if (size := path.stat().st_size) >= _LARGE_BYTES:
                _LOG.info("reading %s, %d MB", name, size // 1_000_000)
        try:
            with np.errstate(all="ignore"):
                meshes.append(join_surfaces(name, read_surfaces(path)))
        except BrokenModelError as error:
            skipped.append(Skipped(path, str(error)))
        except MemoryError:
            skipped.append(Skipped(path, OUT_OF_MEMORY))
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
