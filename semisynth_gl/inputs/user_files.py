"""The user's paths and files."""

import errno
import os
from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path

Files = str | PathLike[str] | Sequence[str | PathLike[str]]
"""A file, folder or glob, or several of them."""

LFS_POINTER = b"version https://git-lfs.github.com/spec/"
"""Beginning of the file that Git LFS leaves in place of a file that it has not fetched."""

IS_LFS_POINTER = "is a Git LFS pointer in place of the file, which `git lfs pull` fetches"
"""Reason for skipping such a file."""


def expanded(path: str | Path) -> Path:
    """Return a path with home folders in place of ``~`` and ``~name``; ``~name`` stays if there is no such user."""
    return Path(os.path.expanduser(path))  # noqa: PTH111 - pathlib raises for an unknown ~name


def read_file(path: Path, most_bytes: int | None = None) -> bytes:
    """Return the bytes of a file; raises OSError also if there are more than ``most_bytes``."""
    with path.open("rb") as file:
        data = file.read() if most_bytes is None else file.read(most_bytes + 1)
    if most_bytes is not None and len(data) > most_bytes:
        raise OSError(errno.EFBIG, f"it is larger than {most_bytes >> 10} KiB", str(path))
    return data


def files_below(folder: Path) -> Iterator[Path]:
    """Yield all files in a folder and below; a folder with several links to it is entered once."""
    entered: set[str] = set()
    for parent, folders, names in os.walk(folder, followlinks=True):
        real = os.path.realpath(parent)
        if real in entered:
            folders.clear()
            continue
        entered.add(real)
        folders.sort()
        # pathlib raises if a folder can be listed but not entered.
        yield from (path for path in (Path(parent, name) for name in names) if os.path.isfile(path))  # noqa: PTH113


def names_of(files: Files) -> list[str]:
    """Return files, folders and globs as a list of strings."""
    return [os.fspath(each) for each in ([files] if isinstance(files, str | PathLike) else files)]
