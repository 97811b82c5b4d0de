"""The user's paths and files: ``~`` is expanded, and only files on a disk are opened.

Reading a pipe may take for ever, opening a device may already have an effect, and a file of the kernel's may wait for
events or change while it is read.
"""

import errno
import os
import stat
from collections.abc import Iterator, Sequence
from io import BufferedReader
from os import PathLike
from pathlib import Path

from semisynth_gl.inputs.errors import InputError

Files = str | PathLike[str] | Sequence[str | PathLike[str]]
"""A file, folder or glob, or several of them."""

LFS_POINTER = b"version https://git-lfs.github.com/spec/"
"""Beginning of the file that Git LFS leaves in place of one that was not fetched."""

IS_LFS_POINTER = "is a Git LFS pointer in place of the file, which `git lfs pull` fetches"
"""Reason for skipping such a file."""

_KERNELS = ("/proc", "/sys")
_KINDS = {
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


class NotOnDiskError(OSError):
    """A path leads to something other than a file on a disk; ``strerror`` says what it is."""


def expanded(path: str | Path) -> Path:
    """Return a path with the home folder in place of ``~``.

    Raises InputError where ``~`` names a user who does not exist, or the path has a zero byte, which no file name has.
    """
    if "\0" in str(path):
        raise InputError(f"{str(path)!r}: expected the name of a file or folder, got one with a zero byte")
    try:
        return Path(path).expanduser()
    except RuntimeError:
        name = str(path).partition("/")[0]
        raise InputError(f"{path}: there is no user {name[1:]!r} whose home {name} would be; write ./{name}") from None


def open_file(path: Path) -> BufferedReader:
    """Open a file on a disk for reading.

    Raises:
        NotOnDiskError: where the path leads to a pipe, a device, a socket, or a file of /proc or /sys.
        OSError: where the file is missing, is a folder, or may not be read.
    """
    _check(path, os.stat(path))  # noqa: PTH116 - a path with a zero byte is an error of its own there
    # The kind is checked again, since the file may have become a pipe; O_NONBLOCK keeps a pipe from waiting.
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        _check(path, os.fstat(descriptor))
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def read_file(path: Path, most_bytes: int | None = None) -> bytes:
    """Return the bytes of a file on a disk; raises as `open_file` does, and OSError if they exceed ``most_bytes``."""
    with open_file(path) as file:
        data = file.read() if most_bytes is None else file.read(most_bytes + 1)
    if most_bytes is not None and len(data) > most_bytes:
        raise OSError(errno.EFBIG, f"it has more than {most_bytes} bytes", str(path))
    return data


def files_below(folder: Path) -> Iterator[Path]:
    """Yield all files in a folder and below, but do not enter links to folders, nor /proc and /sys."""
    for parent, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not of_kernel(os.path.join(parent, name))]  # noqa: PTH118
        yield from (path for path in (Path(parent, name) for name in names) if path.is_file())


def of_kernel(path: str | Path) -> bool:
    """Return whether a path leads to /proc or /sys or below, after links are followed."""
    real = os.path.realpath(path)
    return real.startswith(tuple(f"{folder}/" for folder in _KERNELS)) or real in _KERNELS


def _check(path: Path, status: os.stat_result) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    kind = _KINDS.get(stat.S_IFMT(status.st_mode)) or ("a file of the kernel's" if of_kernel(path) else None)
    if kind is not None:
        raise NotOnDiskError(errno.EINVAL, f"it is {kind}, not a file on a disk", str(path))


def names_of(files: Files) -> list[str]:
    """Return files, folders and globs as a list of strings."""
    return [os.fspath(each) for each in ([files] if isinstance(files, str | PathLike) else files)]
