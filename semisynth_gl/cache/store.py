"""The cache's entries on disk: values and arrays under a name.

The cache may be emptied, damaged, full, forbidden or shared by several processes at any time. Whatever goes wrong, an
entry counts as absent, and the run goes on without it. An entry is one file, which is written under a temporary name
and renamed once. It holds checksums of all its content. NumPy's .npz would do, could its arrays be mapped into memory.
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

from semisynth_gl.user_files import open_file

LIMIT_BYTES = 4_000_000_000
"""Upper limit of all entries together; a full atlas of 256-pixel patches takes 134 MB."""

LIMIT_SHARE = 0.1
"""Upper limit of all entries, as a share of the space that the disk would have free without them."""

SUFFIX, PARTIAL_SUFFIX = ".prepared", ".prepared-partial"
_VARIABLE = "SEMISYNTH_GL_CACHE"
_MAGIC = b"semisynth-gl prepared 1\n"
_ALIGNMENT = 64


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """The content of an entry.

    Attributes:
        values: in JSON's types.
        arrays: by name. Arrays of an entry from disk are writable, and a write changes nothing on disk.
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


def cache_summary() -> str:
    """Return one line with the cache's folder, its size and the limit of its size."""
    folder = cache_folder()
    if folder is None:
        return "off"
    total = sum(size for _, size, _ in _entry_files(folder))
    return f"{folder}, {total / 1e6:.0f} MB of at most {LIMIT_BYTES / 1e6:.0f} MB"


def read_entry(name: str) -> Entry | None:
    """Return the entry of a name, or None where it is absent or damaged.

    The arrays are mapped into memory, not copied; the file may be replaced or removed meanwhile.
    """
    folder = cache_folder()
    if folder is None:
        return None
    path = folder / (name + SUFFIX)
    try:
        with open_file(path) as file:
            data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
        entry = _decoded(data)
    except (OSError, ValueError, LookupError, TypeError, OverflowError, RecursionError):
        return None
    with suppress(OSError):
        os.utime(path)  # the entries that were unused for longest are removed first
    return entry


def write_entry(name: str, entry: Entry) -> None:
    """Write an entry in place of an earlier one of the same name; older entries are removed where space is short."""
    folder = cache_folder()
    if folder is None:
        return
    head, arrays = _head(entry)
    with suppress(OSError):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not _make_room(folder, max([len(head), *(offset + array.nbytes for offset, array in arrays)])):
            return
        handle, partial = tempfile.mkstemp(suffix=PARTIAL_SUFFIX, dir=folder)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(head)
                for offset, array in arrays:
                    file.write(bytes(offset - file.tell()))
                    file.write(array.data)
            Path(partial).replace(folder / (name + SUFFIX))
        finally:
            Path(partial).unlink(missing_ok=True)


def _head(entry: Entry) -> tuple[bytes, list[tuple[int, NDArray[Any]]]]:
    """Return the first bytes of an entry's file, and the offset of each array with the array, contiguous.

    The head itself has offsets from its own end, since the length of the head depends on them.
    """
    descriptions, arrays, offset = [], [], 0
    for name, array in entry.arrays.items():
        arrays.append((offset, contiguous := np.ascontiguousarray(array)))
        descriptions.append((name, contiguous.dtype.str, array.shape, offset, isal_zlib.crc32(contiguous)))
        offset = _aligned(offset + contiguous.nbytes)
    text = json.dumps({"values": entry.values, "arrays": descriptions}).encode()
    head = _MAGIC + len(text).to_bytes(8, "little") + isal_zlib.crc32(text).to_bytes(4, "little") + text
    return head, [(_aligned(len(head)) + offset, array) for offset, array in arrays]


def _decoded(data: mmap.mmap) -> Entry:
    """Return the entry of a file; ValueError, LookupError or TypeError where any byte is not as it was written."""
    start = len(_MAGIC) + 12
    length = int.from_bytes(data[start - 12 : start - 4], "little")
    text = data[start : start + length] if length < len(data) else b""
    if data[: len(_MAGIC)] != _MAGIC or isal_zlib.crc32(text) != int.from_bytes(data[start - 4 : start], "little"):
        raise ValueError("the head of the entry is damaged")
    head = json.loads(text)
    arrays = {}
    for name, dtype, shape, offset, checksum in head["arrays"]:
        array: NDArray[Any] = np.ndarray(shape, dtype, data, _aligned(start + length) + offset)
        if isal_zlib.crc32(array) != checksum:
            raise ValueError(f"the array {name} of the entry is damaged")
        arrays[name] = array
    return Entry(head["values"], arrays)


def _aligned(offset: int) -> int:
    return -(-offset // _ALIGNMENT) * _ALIGNMENT


def _entry_files(folder: Path) -> list[tuple[int, int, Path]]:
    """Return time of last use, size and path of each entry, and of files that killed processes did not finish."""
    files = []
    with suppress(OSError):
        for path in folder.iterdir():
            if path.suffix in (SUFFIX, PARTIAL_SUFFIX):
                with suppress(OSError):  # another process removed the file
                    status = path.stat()
                    files.append((status.st_mtime_ns, status.st_size, path))
    return sorted(files)


def _make_room(folder: Path, size: int) -> bool:
    """Remove the entries that were unused for longest until ``size`` bytes fit; return False where they never do."""
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
