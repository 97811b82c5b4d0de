"""The root of a dataset: a folder of this machine, or an address that fsspec knows (``s3://``, ``gs://``, ...).

In both, a file appears when it is complete. Names are paths below the place, with slashes.
"""

import os
import shutil
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO, cast

from semisynth_gl.dataset.schema import PARTIAL
from semisynth_gl.errors import InputError


class Place(ABC):
    """A dataset's root.

    Attributes:
        address: the place as the user named it.
    """

    address: str

    @property
    @abstractmethod
    def local(self) -> Path | None:
        """The folder, or None for a place that is not on this machine."""

    @abstractmethod
    def read(self, name: str) -> bytes:
        """Read a file.

        Raises:
            FileNotFoundError: where the file is missing.
            OSError: where the file cannot be read.
        """

    @abstractmethod
    def open(self, name: str) -> BinaryIO:
        """Open a file for reading anywhere in it; raises like `read`."""

    @abstractmethod
    def size(self, name: str) -> int | None:
        """Return a file's size in bytes, or None where there is none."""

    @abstractmethod
    def names(self, folder: str = "") -> list[str]:
        """Return the names of all files in a folder and below it, sorted; none where there is no folder."""

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
        """Remove a file; nothing happens where there is none."""

    def path(self, name: str) -> Path:
        """Return a file's path, for messages and where the place is local."""
        return Path(self.address) / name


class Folder(Place):
    """A folder of this machine.

    Args:
        path: it need not exist.
    """

    def __init__(self, path: Path) -> None:
        self.address = str(path)
        self._path = path

    @property
    def local(self) -> Path:
        """The folder."""
        return self._path

    def read(self, name: str) -> bytes:
        """Read a file."""
        return (self._path / name).read_bytes()

    def open(self, name: str) -> BinaryIO:
        """Open a file for reading."""
        return (self._path / name).open("rb")

    def size(self, name: str) -> int | None:
        """Return a file's size."""
        try:
            return (self._path / name).stat().st_size
        except (FileNotFoundError, NotADirectoryError):
            return None

    def names(self, folder: str = "") -> list[str]:
        """Return the names of all files below a folder; links count as files, and are not followed."""
        top = self._path / folder
        found = [
            Path(at) / name
            for at, folders, files in os.walk(top)
            for name in (*files, *(each for each in folders if (Path(at) / each).is_symlink()))
        ]
        return sorted(path.relative_to(self._path).as_posix() for path in found)

    def write(self, name: str, data: bytes) -> None:
        """Write a file under another name, and rename it."""
        partial = self._partial(name)
        try:
            with partial.open("wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            self._rename(partial, name)
        except BaseException:
            partial.unlink(missing_ok=True)
            raise

    def put(self, name: str, file: Path) -> None:
        """Rename a file, which has to lie on the same file system."""
        sync(file)
        self._rename(file, name)

    def remove(self, name: str) -> None:
        """Remove a file."""
        (self._path / name).unlink(missing_ok=True)

    def _partial(self, name: str) -> Path:
        folder = self._path / PARTIAL
        folder.mkdir(parents=True, exist_ok=True)
        # Of two runs that write the same file, neither must write into the other's.
        return folder / f"{name.replace('/', '-')}.{os.getpid()}"

    def _rename(self, file: Path, name: str) -> None:
        destination = self._path / name
        destination.parent.mkdir(parents=True, exist_ok=True)
        file.replace(destination)
        sync(destination.parent)


class Remote(Place):
    """An address that fsspec knows.

    Args:
        address: with its protocol.

    Raises:
        InputError: where fsspec or what it needs for the protocol is not installed, or the protocol is unknown.
    """

    def __init__(self, address: str) -> None:
        self.address = address.rstrip("/")
        protocol = address.partition("://")[0]
        try:
            self._open_system()
        except ImportError as error:
            raise InputError(
                f"{address}: writing there needs packages that cannot be imported ({error}): "
                f"pip install 'semisynth-gl[remote]', and what fsspec names for {protocol}://"
            ) from None
        except ValueError as error:
            raise InputError(f"{address}: {error}") from None

    def __getstate__(self) -> dict[str, Any]:
        # Connections do not travel to other processes.
        return {"address": self.address}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.address = state["address"]
        self._open_system()

    def _open_system(self) -> None:
        fsspec = import_module("fsspec")
        # What another process wrote must be seen at once.
        self._system, self._root = fsspec.core.url_to_fs(self.address, use_listings_cache=False)

    @property
    def local(self) -> None:
        """None: not of this machine."""
        return None

    def read(self, name: str) -> bytes:
        """Read a file."""
        with self._clear_errors():
            return bytes(self._system.cat_file(self._at(name)))

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
                found = self._system.find(self._at(folder))
            except FileNotFoundError:
                return []
        return sorted(path.removeprefix(f"{self._root}/") for path in found)

    def write(self, name: str, data: bytes) -> None:
        """Write a file; object stores show it when it is whole."""
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

    def path(self, name: str) -> Path:
        """Return a file's address, which looks like a path."""
        return Path(f"{self.address.partition('://')[2]}/{name}")

    def _at(self, name: str) -> str:
        return f"{self._root}/{name}".rstrip("/")

    def _make_parent(self, name: str) -> None:
        # Object stores have no folders; making a "folder" there would try to make a bucket.
        if not _has_buckets(self._system):
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
    """Return the place of an address: a path, or ``protocol://...`` for fsspec.

    Raises:
        InputError: where what the protocol needs is not installed.
    """
    text = os.fspath(address)
    if "://" in text and not text.startswith("file://"):
        return Remote(text)
    return Folder(Path(text.removeprefix("file://")))


def sync(path: Path) -> None:
    """Wait until a file or folder is on the disk, as far as the file system tells."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def remove_entries(folder: Path, names: list[str]) -> None:
    """Remove files and folders of a folder by name."""
    for name in names:
        path = folder / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def _has_buckets(system: Any) -> bool:  # noqa: ANN401 - fsspec has no types
    protocols = system.protocol if isinstance(system.protocol, tuple | list) else (system.protocol,)
    return not {"s3", "gs", "gcs", "abfs", "az", "adl", "oci", "oss"}.isdisjoint(protocols)
