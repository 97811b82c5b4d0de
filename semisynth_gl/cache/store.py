"""The cache's entries on disk: values and arrays under a name.

At any time the cache may be emptied, damaged, full, forbidden or shared by several processes. Whatever goes wrong, the
entry counts as absent, and the run goes on without it. An entry is one file, which is written under a temporary name
and then renamed. It holds checksums of all its content. It is read into memory before the checksums are compared: a
mapped file could change, or be cut off, while a run uses it. NumPy's .npz has no checksums of all its bytes. diskcache
unpickles the content of its files, and so would run code that somebody put there.
"""

import json
import os
import shutil
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from io import BufferedReader
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from semisynth_gl.inputs.user_files import open_file

LIMIT_BYTES = 4_000_000_000
"""Largest size of all entries together; a full atlas of 256-pixel patches takes 134 MB."""

LIMIT_SHARE = 0.1
"""Largest size of all entries together, as a share of the space that the disk would have free without them."""

SUFFIX, PARTIAL_SUFFIX = ".prepared", ".prepared-partial"
_VARIABLE = "SEMISYNTH_GL_CACHE"
_MAGIC = b"semisynth-gl prepared 2\n"
_LENGTH, _CHECKSUM = 8, 4
_DTYPES = frozenset(np.dtype(code).str for code in (*np.typecodes["AllInteger"], *"efd?"))


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """The content of an entry: values in JSON's types, and arrays of numbers or bool, both by name.

    The arrays of an entry that was read from disk are writable; writing to them changes nothing on disk.
    """

    values: dict[str, Any]
    arrays: dict[str, NDArray[Any]]


def cache_folder() -> Path | None:
    """Return the folder of the entries, which may not exist yet; None where the user switched the cache off."""
    chosen = os.environ.get(_VARIABLE, "")
    if chosen.lower() == "off":
        return None
    try:
        if chosen:
            return Path(chosen).expanduser()
        base = Path(os.environ.get("XDG_CACHE_HOME", ""))
        return (base if base.is_absolute() else Path.home() / ".cache") / "semisynth-gl"
    except RuntimeError:  # the user has no home folder
        return None


def is_writable(folder: Path) -> bool:
    """Return whether entries can be written to their folder, which may not exist yet."""
    whole = folder.absolute()
    there = next(each for each in (whole, *whole.parents) if os.access(each, os.F_OK))
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK)


def cache_summary() -> str:
    """Return one line with the cache's folder, the size of its entries and `LIMIT_BYTES`, or "off".

    On a disk with little free space, `LIMIT_SHARE` makes the true limit lower than the one in the line.
    """
    folder = cache_folder()
    if folder is None:
        return "off"
    if not is_writable(folder):
        return f"off: {folder} cannot be written to; set {_VARIABLE} to another folder"
    total = sum(size for _, size, _ in _entry_files(folder))
    return f"{folder}, {total / 1e6:.0f} MB of at most {LIMIT_BYTES / 1e6:.0f} MB"


def read_entry(name: str) -> Entry | None:
    """Return the entry of a name, all of it in memory; None where it is absent, unreadable or damaged."""
    folder = cache_folder()
    if folder is None:
        return None
    path = folder / (name + SUFFIX)
    try:
        with open_file(path) as file:
            entry = _read(file)
    except (OSError, ValueError, LookupError, TypeError, OverflowError, RecursionError, MemoryError):
        return None
    with suppress(OSError):
        os.utime(path)  # marks the entry as used: the entries that were unused for longest are removed first
    return entry


def write_entry(name: str, entry: Entry) -> None:
    """Write an entry, replacing an earlier entry of its name.

    Entries that were unused for longest are removed to make room. Where there is never enough room, or the disk cannot
    be written to, nothing is written and no error is raised.
    """
    folder = cache_folder()
    if folder is None:
        return
    head, arrays = _encoded(entry)
    with suppress(OSError):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not _make_room(folder, len(head) + sum(array.nbytes for array in arrays)):
            return
        handle, partial = tempfile.mkstemp(suffix=PARTIAL_SUFFIX, dir=folder)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(head)
                for array in arrays:
                    file.write(array.data)
            Path(partial).replace(folder / (name + SUFFIX))
        finally:
            Path(partial).unlink(missing_ok=True)


def _encoded(entry: Entry) -> tuple[bytes, list[NDArray[Any]]]:
    """Return the first bytes of an entry's file, and the arrays that follow them one after the other, contiguous."""
    arrays = [np.ascontiguousarray(array) for array in entry.arrays.values()]
    descriptions = [
        [name, array.dtype.str, array.shape, _checksum(name, array)]
        for name, array in zip(entry.arrays, arrays, strict=True)
    ]
    text = json.dumps({"values": entry.values, "arrays": descriptions}).encode()
    length, checksum = len(text).to_bytes(_LENGTH, "little"), isal_zlib.crc32(text).to_bytes(_CHECKSUM, "little")
    return b"".join((_MAGIC, length, checksum, text)), arrays


def _read(file: BufferedReader) -> Entry:
    """Read an entry's file.

    Raises ValueError where any byte has changed since the file was written. Where another program wrote the head,
    LookupError, TypeError, OverflowError, RecursionError or MemoryError may come as well.
    """
    left = os.fstat(file.fileno()).st_size
    magic, length, checksum = (file.read(size) for size in (len(_MAGIC), _LENGTH, _CHECKSUM))
    # Never reads more than the file holds: a wrong length must not take memory.
    text = file.read(min(left, int.from_bytes(length, "little")))
    if magic != _MAGIC or isal_zlib.crc32(text) != int.from_bytes(checksum, "little"):
        raise ValueError("the head of the entry is damaged")
    head = json.loads(text)
    arrays: dict[str, NDArray[Any]] = {}
    for name, dtype, shape, expected in head["arrays"]:
        # In a head that another program wrote, a shape may hold texts or lists, which `prod` would repeat.
        if not all(type(size) is int and size >= 0 for size in shape):
            raise ValueError(f"the entry has an array {name} of the impossible shape {shape}")
        if dtype not in _DTYPES or prod(shape) * np.dtype(dtype).itemsize > left:
            raise ValueError(f"the entry cannot hold its array {name} of {shape} {dtype}")
        arrays[name] = array = np.empty(shape, dtype)
        read = file.readinto(array.reshape(-1).view(np.uint8).data)
        if read != array.nbytes or _checksum(name, array) != expected:
            raise ValueError(f"the array {name} of the entry is damaged")
    if file.read(1):
        raise ValueError("the entry goes on behind its last array")
    return Entry(head["values"], arrays)


def _checksum(name: str, array: NDArray[Any]) -> int:
    """Return a checksum of an array's values, and of its name, dtype and shape."""
    return isal_zlib.crc32(array, isal_zlib.crc32(json.dumps([name, array.dtype.str, array.shape]).encode()))


def _entry_files(folder: Path) -> list[tuple[int, int, Path]]:
    """Return time of last use (ns), size (bytes) and path of each entry and each unfinished file, oldest first.

    Processes that were killed leave unfinished files behind.
    """
    files = []
    with suppress(OSError):
        for path in folder.iterdir():
            if path.suffix in (SUFFIX, PARTIAL_SUFFIX):
                with suppress(OSError):  # another process removed the file
                    status = path.stat()
                    files.append((status.st_mtime_ns, status.st_size, path))
    return sorted(files)


def _make_room(folder: Path, size: int) -> bool:
    """Remove the entries that were unused for longest until ``size`` bytes fit; return False where they cannot fit."""
    files = _entry_files(folder)
    total = sum(file_size for _, file_size, _ in files)
    limit = min(LIMIT_BYTES, int(LIMIT_SHARE * (shutil.disk_usage(folder).free + total)))
    if size > limit:
        return False
    for _, file_size, path in files:
        if total + size <= limit:
            break
        path.unlink(missing_ok=True)
        total -= file_size
    return True
