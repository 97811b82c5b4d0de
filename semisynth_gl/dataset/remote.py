"""The root of a dataset at an address that fsspec knows (``s3://``, ``gs://``, ...)."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO, Self, cast

from semisynth_gl.dataset.place import Place
from semisynth_gl.inputs.errors import InputError, how_to_install

_WITH_BUCKETS = frozenset({"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "adl", "oci", "oss"})


class Remote(Place):
    """The place at an address that fsspec knows, such as ``s3://bucket/name``.

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
            # Without a cache of listings, this process sees other processes' files at once.
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
        """The file system; a forked process opens new connections."""
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
        """Write a file; object stores show it only when it is complete."""
        with self._clear_errors(writing=True):
            self._make_parent(name)
            self._system.pipe_file(self._at(name), data)

    def put(self, name: str, file: Path) -> None:
        """Upload a file, and remove it here."""
        with self._clear_errors(writing=True):
            self._make_parent(name)
            self._system.put_file(str(file), self._at(name))
        file.unlink()

    def copy(self, originals: Mapping[str, str]) -> None:
        """Copy files inside the store; ``originals`` has the name of each copy's original."""
        with self._clear_errors(writing=True):
            for name in originals:
                self._make_parent(name)
            self._system.copy([*map(self._at, originals.values())], [*map(self._at, originals)])

    def remove(self, name: str) -> None:
        """Remove a file."""
        with self._clear_errors(), suppress(FileNotFoundError):
            self._system.rm_file(self._at(name))

    def path(self, name: str) -> Path:
        """Return a file's address without its protocol, as a path for messages."""
        return Path(f"{self.address.partition('://')[2]}/{name}")

    def _at(self, name: str) -> str:
        return f"{self._root}/{name}".rstrip("/")

    def _make_parent(self, name: str) -> None:
        # Object stores have no folders; making a "folder" there would make a bucket.
        protocol = self._system.protocol
        if _WITH_BUCKETS.isdisjoint(protocol if isinstance(protocol, tuple | list) else (protocol,)):
            self._system.makedirs(self._at(name).rpartition("/")[0], exist_ok=True)

    @contextmanager
    def _clear_errors(self, *, writing: bool = False) -> Iterator[None]:
        """Raise InputError for errors of fsspec's packages, but keep FileNotFoundError unless ``writing``."""
        try:
            yield
        except OSError as error:
            if isinstance(error, FileNotFoundError) and not writing:
                raise
            raise InputError(f"{self.address}: {error}; check address, rights and connection") from None
        except NotImplementedError:
            # fsspec can only read some protocols, such as http://.
            raise InputError(f"{self.address}: fsspec cannot write to such an address; choose another") from None
        except Exception as error:
            # Errors such as botocore's NoCredentialsError are no OSErrors, and cannot be imported where their packages
            # are absent.
            kind = type(error).__name__
            if "Credential" in kind or type(error).__module__.split(".")[0] in ("botocore", "aiobotocore", "google"):
                raise InputError(
                    f"{self.address}: {kind}: {error}; set the credentials that the store needs, "
                    "such as AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
                ) from None
            raise
