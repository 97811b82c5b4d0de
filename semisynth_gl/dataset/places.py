"""The root of a dataset by its address: a folder of this machine, or an address that fsspec knows."""

import os
import re
import stat
from collections.abc import Iterable, Iterator
from contextlib import suppress
from itertools import count
from pathlib import Path, PurePosixPath
from typing import BinaryIO

from semisynth_gl.dataset.place import Place
from semisynth_gl.dataset.remote import Remote
from semisynth_gl.dataset.schema import PARTIAL, unfinished_path
from semisynth_gl.inputs.errors import InputError, ReadError
from semisynth_gl.inputs.user_files import expanded

__all__ = ["Folder", "Place", "entries_below", "open_place", "sync"]

_ONE_SLASH = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:/(?!/)")


class Folder(Place):
    """A folder of this machine, which need not exist."""

    local: Path

    def __init__(self, path: Path) -> None:
        self.address = str(path)
        self.local = path

    def read(self, name: str) -> bytes:
        """Read a file."""
        with self.open(name) as file:
            return file.read()

    def read_part(self, name: str, offset: int, length: int) -> bytes:
        """Read a part of a file."""
        with self.open(name) as file:
            # At most the rest of the file, so that a wrong length allocates no memory.
            length = max(0, min(length, os.fstat(file.fileno()).st_size - offset))
            file.seek(offset)
            return file.read(length)

    def open(self, name: str) -> BinaryIO:
        """Open a file for reading."""
        self._find(name)
        # Something else may have taken the file's place since: follow no link, and wait for no pipe.
        descriptor = os.open(self.local / name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        return os.fdopen(descriptor, "rb")

    def size(self, name: str) -> int | None:
        """Return a file's size."""
        try:
            return self._find(name).st_size
        except (FileNotFoundError, NotADirectoryError):
            return None

    def _find(self, name: str) -> os.stat_result:
        """Return the status of a plain file in this folder; raises ReadError for a link, anywhere on the way to it."""
        parts = PurePosixPath(name).parts
        if not parts or ".." in parts or PurePosixPath(name).is_absolute():
            raise ReadError(self.local / name, f"{name!r} is no path below {self.local}")
        path = self.local
        for part in parts:
            path /= part
            status = path.lstat()
            if stat.S_ISLNK(status.st_mode):
                raise ReadError(
                    self.local / name,
                    f"{path.relative_to(self.local)} is a link, and may lead out of the dataset's folder: put a copy "
                    "of the file or folder in its place",
                )
        if not stat.S_ISREG(status.st_mode):
            raise ReadError(path, "expected a file, got a folder, a device, a pipe or a socket")
        return status

    def names(self, folder: str = "") -> list[str]:
        """Return the names of all files below a folder; links count as files, and are not followed."""
        if folder and self.path(folder).is_symlink():
            return [folder]
        return sorted(path.relative_to(self.local).as_posix() for path in entries_below(self.local / folder))

    def write(self, name: str, data: bytes) -> None:
        """Write a file under an unfinished name, and rename it."""
        new = self._create(name)
        partial = Path(new.name)
        try:
            with new as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            self._rename(partial, name)
        except BaseException:
            partial.unlink(missing_ok=True)
            raise
        # Outside the try block: once the file is renamed, another run may use the unfinished name.
        sync(self.path(name).parent)

    def put(self, name: str, file: Path) -> None:
        """Rename a file, which must be on the same file system."""
        sync(file)
        self._rename(file, name)
        sync(self.path(name).parent)

    def remove(self, name: str) -> None:
        """Remove a file or a link, but never a folder, which may hold other people's files."""
        self.own_path(name).unlink(missing_ok=True)

    def folders(self) -> list[str]:
        """Return the names of all folders below; links are files."""
        return [
            Path(parent, name).relative_to(self.local).as_posix()
            for parent, folders, _ in os.walk(self.local)
            for name in folders
            if not Path(parent, name).is_symlink()
        ]

    def remove_empty(self, folders: Iterable[str]) -> None:
        """Remove empty folders, the deepest first."""
        paths = {path for folder in folders for path in (Path(folder), *Path(folder).parents)} - {Path()}
        for path in sorted(paths, key=lambda path: len(path.parts), reverse=True):
            with suppress(OSError, InputError):
                self.own_path(str(path)).rmdir()

    def make_folder(self, name: str) -> None:
        """Make a folder, with its parents."""
        self.own_path(f"{name}/*").parent.mkdir(parents=True, exist_ok=True)

    def link(self, name: str, target: str) -> None:
        """Make a symbolic link, whose target is relative to its folder; a link that leads elsewhere is replaced."""
        path = self.own_path(name)
        if path.is_symlink():
            if os.readlink(path) == target:  # noqa: PTH115 - a Path would drop dots
                return
            path.unlink()
        path.parent.mkdir(parents=True, exist_ok=True)
        path.symlink_to(target)

    def own_path(self, name: str, *, in_place: bool = False) -> Path:
        """Return the path of a file to create, replace or remove; or, if ``in_place``, of a file to open for writing.

        Raises:
            InputError: where a folder on the way is a link, which may lead out of this folder, or something else. If
                ``in_place``, also where the file itself is a link or something else.
        """
        path, *ways = self.local / name, *map(str, reversed(PurePosixPath(name).parents[:-1]))
        for way in (*ways, name) if in_place else ways:
            try:
                mode = self.path(way).lstat().st_mode
            except (FileNotFoundError, NotADirectoryError):
                break
            is_right, kind = (stat.S_ISREG, "file") if way == name else (stat.S_ISDIR, "folder")
            if stat.S_ISLNK(mode):
                raise InputError(
                    f"{self.address}: {way} is a link, and may lead out of the dataset's folder: remove it, or put a "
                    f"copy of the {kind} in its place"
                )
            if not is_right(mode):
                raise InputError(f"{self.address}: {way}: expected a {kind}, got something else: remove it")
        return path

    def _create(self, name: str) -> BinaryIO:
        """Create an unfinished file under a name that no other run has taken."""
        self.make_folder(PARTIAL)
        numbers = count()
        while True:
            with suppress(FileExistsError):
                return (self.local / unfinished_path(name, next(numbers))).open("xb")

    def _rename(self, file: Path, name: str) -> None:
        destination = self.own_path(name)
        destination.parent.mkdir(parents=True, exist_ok=True)
        file.replace(destination)


def open_place(address: str | os.PathLike[str]) -> Place:
    """Return the place of an address: a path, in which ``~`` is the home folder, or ``protocol://...`` for fsspec.

    Raises:
        InputError: where the address is empty, has only one slash after its colon or lacks its bucket, or where the
            protocol is unknown or its package not installed.
    """
    text = os.fspath(address)
    path = text.removeprefix("file://").removeprefix("local://")
    if "://" in path:
        return Remote(text)
    if not path.strip():
        raise InputError(f"expected a folder or an address such as s3://bucket/name, got {text!r}")
    protocol = path.partition("/")[0]
    if _ONE_SLASH.match(path) and not Path(protocol).exists():
        raise InputError(
            f"{text}: expected a folder or an address such as {protocol}//bucket/name, got one slash after the colon; "
            f"for a folder of this name give ./{text}"
        )
    return Folder(expanded(path))


def entries_below(folder: Path) -> Iterator[Path]:
    """Yield all files and links below a folder; links are not followed."""
    for parent, folders, files in os.walk(folder):
        yield from (Path(parent) / name for name in files)
        yield from (path for name in folders if (path := Path(parent) / name).is_symlink())


def sync(path: Path) -> None:
    """Wait until the file system says that a file or folder is on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
