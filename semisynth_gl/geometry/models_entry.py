"""Models as an entry of the cache, and back."""

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from semisynth_gl.cache.entries import Entry
from semisynth_gl.errors import Skipped
from semisynth_gl.geometry.mesh import Mesh

_ARRAYS = ("positions", "uv", "triangles")
_VALUES = tuple(field.name for field in fields(Mesh) if field.name not in _ARRAYS)


def packed_meshes(meshes: Sequence[Mesh]) -> Entry:
    """Turn meshes into an entry, whose arrays hold those of all meshes one after the other."""
    rows = {name: [len(getattr(mesh, name)) for mesh in meshes] for name in _ARRAYS}
    arrays = {name: np.concatenate([getattr(mesh, name) for mesh in meshes]) for name in _ARRAYS}
    return Entry({"rows": rows, "meshes": [{name: getattr(mesh, name) for name in _VALUES} for mesh in meshes]}, arrays)


def unpacked_meshes(entry: Entry) -> tuple[Mesh, ...]:
    """Turn an entry back into its meshes."""
    parts = {name: np.split(entry.arrays[name], np.cumsum(entry.values["rows"][name])[:-1]) for name in _ARRAYS}
    return tuple(
        Mesh(**(values | {name: arrays[index] for name, arrays in parts.items()}))
        for index, values in enumerate(entry.values["meshes"])
    )


def packed_skipped(skipped: Sequence[Skipped]) -> list[list[str]]:
    """Turn what was left out into JSON's types."""
    return [[str(each.path), each.reason] for each in skipped]


def unpacked_skipped(values: Sequence[Sequence[str]]) -> tuple[Skipped, ...]:
    """Turn what was left out back."""
    return tuple(Skipped(Path(path), reason) for path, reason in values)
