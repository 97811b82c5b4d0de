"""The root of a dataset: a folder of this machine, or an address that fsspec knows (``s3://``, ``gs://``, ...).

In both, a file appears when it is complete. Names are paths below the place, with slashes. Files are read without any
state that processes or threads could share: each reading opens what it needs.
"""

import os
import re
import stat
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from itertools import count
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO, Self, cast

from semisynth_gl.dataset.schema import PARTIAL, unfinished_path
from semisynth_gl.errors import InputError, ReadError, how_to_install
from semisynth_gl.user_files import expanded

_WITH_BUCKETS = frozenset({"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "adl", "oci", "oss"})
_ONE_SLASH = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:/(?!/)")


class Place(ABC):
    """A dataset's root.

    Attributes:
        address: the place as the user named it.
        local: the folder, or None for a place that is not on this machine.
    """

    address: str
    local: Path | None

    @abstractmethod
    def read(self, name: str) -> bytes:
        """Read a file.

        Raises:
            FileNotFoundError: where the file is missing.
            ReadError: where the name, or a link, leads out of the place, or is no plain file.
            OSError: where the file cannot be read.
        """

    @abstractmethod
    def read_part(self, name: str, offset: int, length: int) -> bytes:
        """Read ``length`` bytes from ``offset`` on, fewer where the file ends before; raises like `read`."""

    @abstractmethod
    def open(self, name: str) -> BinaryIO:
        """Open a file for reading anywhere in it; raises like `read`."""

    @abstractmethod
    def size(self, name: str) -> int | None:
        """Return a file's size in bytes, or None where the file is missing; else raises like `read`."""

    @abstractmethod
    def names(self, folder: str = "") -> list[str]:
        """Return the names of all files in a folder and below it, sorted; none where the folder is missing."""

    @abstractmethod
    def write(self, name: str, data: bytes) -> None:
        """Write or replace a file atomically.

        Raises:
            OSError: where the file cannot be written.
        """

    @abstractmethod
    def put(self, name: str, file: Path) -> None:
        """Move a file of this machine to the place atomically; raises like `write`."""

    @abstractmethod
    def remove(self, name: str) -> None:
        """Remove a file; nothing happens where it is missing."""

    @abstractmethod
    def folders(self) -> list[str]:
        """Return the names of all folders below; none where there are no folders."""

    @abstractmethod
    def remove_empty(self, folders: Iterable[str]) -> None:
        """Remove those of the folders, and of the folders above them, in which nothing is left."""

    def path(self, name: str) -> Path:
        """Return a file's path, for messages and where the place is local."""
        return Path(self.address) / name


class Folder(Place):
    """A folder of this machine.

    Args:
        path: the folder, which need not exist.
    """

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
            # At most what is there: a wrong length must not ask for memory.
            length = max(0, min(length, os.fstat(file.fileno()).st_size - offset))
            parts = []
            while length and (part := os.pread(file.fileno(), length, offset)):
                parts.append(part)
                offset, length = offset + len(part), length - len(part)
            return b"".join(parts)

    def open(self, name: str) -> BinaryIO:
        """Open a file for reading."""
        self._find(name)
        # Whatever has taken the file's place since: no link is followed, and no pipe waited for.
        descriptor = os.open(self.local / name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        return os.fdopen(descriptor, "rb")

    def size(self, name: str) -> int | None:
        """Return a file's size."""
        try:
            return self._find(name).st_size
        except (FileNotFoundError, NotADirectoryError):
            return None

    def _find(self, name: str) -> os.stat_result:
        """Return the status of a plain file, which stands in this folder without any link on the way to it."""
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
        return sorted(path.relative_to(self.local).as_posix() for path in entries_below(self.local / folder))

    def write(self, name: str, data: bytes) -> None:
        """Write a file under another name, and rename it."""
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
        # Not above: from the renaming on, the unfinished name may be another run's.
        sync(self.path(name).parent)

    def put(self, name: str, file: Path) -> None:
        """Rename a file, which has to lie on the same file system."""
        sync(file)
        self._rename(file, name)
        sync(self.path(name).parent)

    def remove(self, name: str) -> None:
        """Remove a file or a link; never a folder, which may hold what others put there."""
        with suppress(NotADirectoryError):
            (self.local / name).unlink(missing_ok=True)

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
            with suppress(OSError):
                (self.local / path).rmdir()

    def _create(self, name: str) -> BinaryIO:
        """Create an unfinished file under a name that no other run has taken."""
        (self.local / PARTIAL).mkdir(parents=True, exist_ok=True)
        numbers = count()
        while True:
            with suppress(FileExistsError):
                return (self.local / unfinished_path(name, next(numbers))).open("xb")

    def _rename(self, file: Path, name: str) -> None:
        destination = self.local / name
        destination.parent.mkdir(parents=True, exist_ok=True)
        file.replace(destination)


class Remote(Place):
    """An address that fsspec knows.

    Args:
        address: the address with its protocol.

    Raises:
        InputError: where fsspec or the protocol's package is not installed, the protocol is unknown, or the address of
            an object store has no bucket.
    """

    local: None = None

    def __init__(self, address: str) -> None:
        protocol, _, path = address.partition("://")
        if protocol.rpartition("::")[2] in _WITH_BUCKETS and not path.partition("/")[0]:
            raise InputError(f"{address}: expected an address with a bucket, such as {protocol}://bucket/name")
        self.address = address.rstrip("/")
        self._connect()

    def _connect(self) -> None:
        self._process = os.getpid()
        try:
            # Without a cache of listings, files of other processes show at once.
            self._connected, self._root = import_module("fsspec").core.url_to_fs(self.address, use_listings_cache=False)
        except ImportError as error:
            raise InputError(
                f"{self.address}: writing there needs packages that cannot be imported ({error}): "
                f"{how_to_install('remote')}; and what fsspec names for {self.address.partition('://')[0]}://"
            ) from None
        except ValueError as error:
            raise InputError(f"{self.address}: {error}") from None

    @property
    def _system(self) -> Any:  # noqa: ANN401 - fsspec has no types
        """The file system; a forked process opens connections of its own."""
        if self._process != os.getpid():
            self._connect()
        return self._connected

    def __reduce__(self) -> tuple[type[Self], tuple[str]]:
        # Connections do not travel to other processes.
        return type(self), (self.address,)

    def read(self, name: str) -> bytes:
        """Read a file."""
        with self._clear_errors():
            return bytes(self._system.cat_file(self._at(name)))

    def read_part(self, name: str, offset: int, length: int) -> bytes:
        """Read a part of a file, with one request."""
        if not length:
            return b""
        with self._clear_errors():
            return bytes(self._system.cat_file(self._at(name), start=offset, end=offset + length))

    def open(self, name: str) -> BinaryIO:
        """Open a file for reading."""
        with self._clear_errors():
            return cast("BinaryIO", self._system.open(self._at(name), "rb"))

    def size(self, name: str) -> int | None:
        """Return a file's size."""
        with self._clear_errors():
            try:
                return int(self._system.info(self._at(name))["size"])
            except FileNotFoundError:
                return None

    def names(self, folder: str = "") -> list[str]:
        """Return the names of all files below a folder."""
        with self._clear_errors():
            try:
                paths = self._system.find(self._at(folder))
            except FileNotFoundError:
                return []
        return sorted(path.removeprefix(f"{self._root}/") for path in paths)

    def write(self, name: str, data: bytes) -> None:
        """Write a file; object stores show it when it is complete."""
        with self._clear_errors(writing=True):
            self._make_parent(name)
            self._system.pipe_file(self._at(name), data)

    def put(self, name: str, file: Path) -> None:
        """Upload a file, and remove it here."""
        with self._clear_errors(writing=True):
            self._make_parent(name)
            self._system.put_file(str(file), self._at(name))
        file.unlink()

    def remove(self, name: str) -> None:
        """Remove a file."""
        with self._clear_errors(), suppress(FileNotFoundError):
            self._system.rm_file(self._at(name))

    def folders(self) -> list[str]:
        """Return nothing: stores have no folders."""
        return []

    def remove_empty(self, folders: Iterable[str]) -> None:
        """Do nothing: stores have no folders."""

    def path(self, name: str) -> Path:
        """Return a file's address, which looks like a path."""
        return Path(f"{self.address.partition('://')[2]}/{name}")

    def _at(self, name: str) -> str:
        return f"{self._root}/{name}".rstrip("/")

    def _make_parent(self, name: str) -> None:
        # Object stores have no folders; to make a "folder" there would be to make a bucket.
        protocol = self._system.protocol
        if _WITH_BUCKETS.isdisjoint(protocol if isinstance(protocol, tuple | list) else (protocol,)):
            self._system.makedirs(self._at(name).rpartition("/")[0], exist_ok=True)

    @contextmanager
    def _clear_errors(self, *, writing: bool = False) -> Iterator[None]:
        """Turn errors of fsspec's packages about rights and buckets into InputError."""
        try:
            yield
        except OSError as error:
            if isinstance(error, FileNotFoundError) and not writing:
                raise
            raise InputError(f"{self.address}: {error}; check address, rights and connection") from None
        except NotImplementedError:
            # Such as http://, which fsspec only reads.
            raise InputError(f"{self.address}: fsspec cannot write to such an address; choose another") from None
        except Exception as error:
            # botocore's NoCredentialsError and its like are no OSErrors, and their packages may be absent.
            kind = type(error).__name__
            if "Credential" in kind or type(error).__module__.split(".")[0] in ("botocore", "aiobotocore", "google"):
                raise InputError(
                    f"{self.address}: {kind}: {error}; set the credentials that the store needs, "
                    "such as AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
                ) from None
            raise


def open_place(address: str | os.PathLike[str]) -> Place:
    """Return the place of an address: a path, in which ``~`` is the home folder, or ``protocol://...`` for fsspec.

    Raises:
        InputError: where the address is empty or lacks its bucket, or the protocol's package is not installed.
    """
    text = os.fspath(address)
    if "://" in text and not text.startswith("file://"):
        return Remote(text)
    path = text.removeprefix("file://")
    if not path.strip():
        raise InputError(f"expected a folder or an address such as s3://bucket/name, got {text!r}")
    protocol = path.partition("/")[0]
    if _ONE_SLASH.match(path) and not Path(protocol).exists():
        raise InputError(
            f"{text}: expected a folder or an address such as {protocol}//bucket/name, got one slash behind the colon; "
            f"for a folder of this name give ./{text}"
        )
    return Folder(expanded(path))


def entries_below(folder: Path) -> Iterator[Path]:
    """Yield all files and links below a folder; links are not followed."""
    for parent, folders, files in os.walk(folder):
        yield from (Path(parent) / name for name in files)
        yield from (path for name in folders if (path := Path(parent) / name).is_symlink())


def sync(path: Path) -> None:
    """Wait until a file or folder is on the disk, as far as the file system tells."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
