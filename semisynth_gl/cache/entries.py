"""Entries on disk that survive from run to run: values and arrays under a name.

The cache may be emptied, damaged, full, forbidden or shared by several processes at any time: whatever goes wrong, an
entry is absent, and a run goes on without it. An entry is one file, written under another name first and renamed once.
It holds checksums of all that is read from it.
"""

import json
import mmap
import os
import shutil
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

LIMIT_BYTES = 4_000_000_000
"""All entries together take at most this; a full atlas of 256-pixel patches takes 134 MB."""

LIMIT_SHARE = 0.1
"""They also take at most this share of what the disk would have free without them."""

_VARIABLE = "SEMISYNTH_GL_CACHE"
SUFFIX, PARTIAL_SUFFIX = ".prepared", ".prepared-partial"
_MAGIC = b"semisynth-gl prepared 1\n"
_ALIGNMENT = 64


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """What is kept under a name.

    Attributes:
        values: in JSON's types.
        arrays: by name; those that are read can be written to, which changes nothing on disk.
    """

    values: dict[str, Any]
    arrays: dict[str, NDArray[Any]]


def cache_folder() -> Path | None:
    """Return where entries lie, whether it exists or not; None where the user switched the cache off."""
    chosen = os.environ.get(_VARIABLE, "")
    if chosen.lower() == "off":
        return None
    try:
        if chosen:
            return Path(chosen).expanduser()
        base = Path(os.environ.get("XDG_CACHE_HOME", ""))
        return (base if base.is_absolute() else Path.home() / ".cache") / "semisynth-gl"
    except RuntimeError:  # nobody knows where home is
        return None


def cache_summary() -> str:
    """Return one line: where the cache lies, how large it is, how large it may become."""
    folder = cache_folder()
    if folder is None:
        return "off"
    held = sum(size for _, size, _ in _entries(folder))
    return f"{folder}, {held / 1e6:.0f} MB of at most {LIMIT_BYTES / 1e6:.0f} MB"


def read_entry(name: str) -> Entry | None:
    """Return what is kept under a name, or None where there is nothing, or nothing whole.

    The arrays are mapped, not copied; the file may be replaced or removed under them.
    """
    folder = cache_folder()
    if folder is None:
        return None
    path = folder / (name + SUFFIX)
    try:
        with path.open("rb") as file:
            data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
        entry = _decoded(data)
    except (OSError, ValueError, LookupError, TypeError):
        return None
    with suppress(OSError):
        os.utime(path)  # what was not used for longest goes first
    return entry


def write_entry(name: str, entry: Entry) -> None:
    """Keep an entry under a name, in place of what was there; older ones go where there would be too much."""
    folder = cache_folder()
    if folder is None:
        return
    head, offsets = _head(entry)
    with suppress(OSError):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        size = max([len(head)] + [at + array.nbytes for at, array in zip(offsets, entry.arrays.values(), strict=True)])
        if not _make_room(folder, size):
            return
        handle, partial = tempfile.mkstemp(suffix=PARTIAL_SUFFIX, dir=folder)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(head)
                for at, array in zip(offsets, entry.arrays.values(), strict=True):
                    file.write(bytes(at - file.tell()))
                    file.write(np.ascontiguousarray(array).data)
            Path(partial).replace(folder / (name + SUFFIX))
        finally:
            Path(partial).unlink(missing_ok=True)


def _head(entry: Entry) -> tuple[bytes, list[int]]:
    """The first bytes of an entry's file, and where each array begins.

    The arrays' places are told relative to the end of the head, whose own length they would change.
    """
    described, starts, at = [], [], 0
    for name, array in entry.arrays.items():
        whole = np.ascontiguousarray(array)
        described.append([name, whole.dtype.str, list(array.shape), at, isal_zlib.crc32(whole)])
        starts.append(at)
        at = _aligned(at + whole.nbytes)
    text = json.dumps({"values": entry.values, "arrays": described}).encode()
    head = _MAGIC + len(text).to_bytes(8, "little") + isal_zlib.crc32(text).to_bytes(4, "little") + text
    return head, [_aligned(len(head)) + start for start in starts]


def _decoded(data: mmap.mmap) -> Entry:
    """The entry in a file.

    Raises:
        ValueError, LookupError or TypeError: where anything is not as it was written.
    """
    start = len(_MAGIC) + 12
    length = int.from_bytes(data[start - 12 : start - 4], "little")
    text = data[start : start + length] if length < len(data) else b""
    if data[: len(_MAGIC)] != _MAGIC or isal_zlib.crc32(text) != int.from_bytes(data[start - 4 : start], "little"):
        raise ValueError("the head of the entry is damaged")
    head = json.loads(text)
    arrays = {}
    for name, dtype, shape, at, checksum in head["arrays"]:
        array: NDArray[Any] = np.ndarray(shape, dtype, data, _aligned(start + length) + at)
        if isal_zlib.crc32(array) != checksum:
            raise ValueError(f"the array {name} of the entry is damaged")
        arrays[name] = array
    return Entry(head["values"], arrays)


def _aligned(at: int) -> int:
    return -(-at // _ALIGNMENT) * _ALIGNMENT


def _entries(folder: Path) -> list[tuple[int, int, Path]]:
    """When each was used last, its size and path; also what a killed process left half-written."""
    found = []
    with suppress(OSError):
        for path in folder.iterdir():
            if path.suffix in (SUFFIX, PARTIAL_SUFFIX):
                with suppress(OSError):  # another process removed it
                    status = path.stat()
                    found.append((status.st_mtime_ns, status.st_size, path))
    return sorted(found)


def _make_room(folder: Path, size: int) -> bool:
    """Remove entries, the longest unused first, until one of ``size`` bytes fits in; tell whether it does."""
    entries = _entries(folder)
    held = sum(each for _, each, _ in entries)
    limit = min(LIMIT_BYTES, int(LIMIT_SHARE * (shutil.disk_usage(folder).free + held)))
    if size > limit:
        return False
    for _, each, path in entries:
        if held + size <= limit:
            break
        path.unlink(missing_ok=True)
        held -= each
    return True
