"""The cache: results that are built once and kept on disk for later runs.

An entry is an .npz file, named by the SHA-256 of a key. The key holds everything that decides the result: values,
files, the code of the program and of plug-ins, and the installed packages. If the cache is off, full, damaged or
read-only, the result is built, and the run goes on.
"""

import hashlib
import json
import logging
import os
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.plugins import modules_sha256, plugins_sha256

LIMIT_BYTES = 4_000_000_000
"""Maximum size of all entries together; a full atlas of 256-pixel patches takes 134 MB."""

SUFFIX = ".prepared"
"""Ending of entries' names. It is not .npz, since the user may choose a folder that holds other .npz files."""

_LOG = logging.getLogger(__name__)


class CacheEntry(NamedTuple):
    """A result as values in JSON's types, and arrays of numbers or bool; "values" is no array's name."""

    values: dict[str, Any]
    arrays: dict[str, NDArray[Any]]


def cached(
    kind: str, key: Mapping[str, Any], build: Callable[[], CacheEntry], *, announce: str | None = None
) -> CacheEntry:
    """Return a result from the cache, or build it and put it into the cache. Errors of ``build`` are passed on.

    Args:
        kind: beginning of the entry's name.
        key: everything that decides the result, except code and packages: JSON's types, paths of files and arrays. If
            a file is missing, the cache is not used.
        build: returns the result.
        announce: what ``build`` does, such as "making models", logged as INFO before it begins; None if it is quick.
    """
    path, folder = None, cache_folder()
    with suppress(OSError):
        if folder is not None:
            code = [modules_sha256(Path(__file__).parent), *plugins_sha256()]
            text = json.dumps([code, _installed_packages(), key], sort_keys=True, default=_key_value)
            path = folder / f"{kind}-{hashlib.sha256(text.encode()).hexdigest()}{SUFFIX}"
    if path is not None:
        # The entry may be missing or damaged. Reading a damaged one may raise anything.
        with suppress(Exception), np.load(path, allow_pickle=False) as file:
            arrays = dict(file)
            return CacheEntry(json.loads(arrays.pop("values").tobytes()), arrays)
    if announce is not None:
        _LOG.info(announce)
    entry = build()
    if path is not None:
        with suppress(OSError):
            _write_entry(path, entry)
    return entry


def _key_value(value: object) -> object:
    """Return what stands for a file or an array in a key."""
    if isinstance(value, Path):
        status = value.stat()
        # If two files swap their names, only st_ctime may change.
        return str(value), status.st_size, status.st_mtime_ns, status.st_ctime_ns
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, hashlib.sha256(value.tobytes()).hexdigest()
    raise TypeError(f"cannot be part of a key: {value!r}")


def _installed_packages() -> list[str]:
    """Return the names of all metadata folders, such as "numpy-2.2.0.dist-info"."""
    names = {path.name for folder in map(Path, sys.path) if folder.is_dir() for path in folder.iterdir()}
    return sorted(name for name in names if name.endswith((".dist-info", ".egg-info")))


def cache_folder() -> Path | None:
    """Return the folder of the entries, which may not exist yet; None where the user switched the cache off."""
    chosen = os.environ.get("SEMISYNTH_GL_CACHE") or f"{os.environ.get('XDG_CACHE_HOME') or '~/.cache'}/semisynth-gl"
    with suppress(RuntimeError):  # the user has no home folder
        return None if chosen.lower() == "off" else Path(chosen).expanduser()
    return None


def _write_entry(path: Path, entry: CacheEntry) -> None:
    """Write an entry, then remove the oldest entries beyond `LIMIT_BYTES`."""
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    content: Any = entry.arrays | {"values": np.frombuffer(json.dumps(entry.values).encode(), np.uint8)}
    # Write under a temporary name first: other processes may read or write the same entry.
    partial = path.with_suffix(f".{os.getpid()}{SUFFIX}")
    try:
        with partial.open("wb") as file:
            np.savez(file, **content)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
    size = 0
    for each in sorted(path.parent.glob(f"*{SUFFIX}"), key=lambda each: -each.stat().st_mtime_ns):
        size += each.stat().st_size
        if size > LIMIT_BYTES:
            each.unlink(missing_ok=True)
