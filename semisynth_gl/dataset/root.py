"""A dataset's root: a folder on this machine or an address that fsspec knows, as a path of universal-pathlib."""

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeGuard

from upath import UPath

from semisynth_gl.inputs.errors import InputError, ReadError, how_to_install
from semisynth_gl.inputs.user_files import expanded

# Maximum size of a file that `read_whole` reads.
_MOST_BYTES = 1 << 31


def open_root(address: str | os.PathLike[str]) -> UPath:
    """Return the path of a folder, in which ``~`` is the home folder, or of an address ``protocol://...``.

    Raises:
        InputError: where the address is empty, has one slash after its colon, or has a protocol that is unknown or
            whose package is not installed.
    """
    text = os.fspath(address)
    path = text.removeprefix("file://").removeprefix("local://")
    if not path.strip() or re.match(r"[A-Za-z][A-Za-z0-9+.-]+:/(?!/)", path):
        raise InputError(f"expected a folder or an address such as s3://bucket/name with two slashes, got {text!r}")
    if "://" not in path:
        return UPath(expanded(path))
    try:
        # Without a cache of listings, this process sees other processes' files at once.
        root = UPath(text.rstrip("/"), use_listings_cache=False)
        root.fs  # noqa: B018 - imports the protocol's package
    except ImportError as error:
        raise InputError(
            f"{text}: needs packages that cannot be imported ({error}): {how_to_install('remote')}"
        ) from None
    except ValueError as error:
        raise InputError(f"{text}: {error}") from None
    return root


def is_local(root: UPath) -> TypeGuard[Path]:
    """Return whether a root is a folder on this machine."""
    return isinstance(root, Path)


def shown_path(root: UPath, name: str) -> Path:
    """Return the path of a file for messages, without the protocol of an address."""
    return Path(root.path, name)


def read_whole(root: UPath, name: str) -> bytes:
    """Read a file of a dataset; raises ReadError if it is missing, unreadable, or larger than 2 GiB."""
    data = read_part(root, name, 0, _MOST_BYTES + 1)
    if len(data) > _MOST_BYTES:
        raise ReadError(shown_path(root, name), f"has more than {_MOST_BYTES} bytes")
    return data


def read_if_there(root: UPath, name: str) -> bytes | None:
    """Read a file with `read_whole`, or return None if it is missing; raises as `explained_errors` says."""
    with explained_errors(root):
        return read_whole(root, name) if (root / name).exists() else None


def read_part(root: UPath, name: str, offset: int, length: int) -> bytes:
    """Read up to ``length`` bytes of a file from an offset on; raises ReadError if that fails."""
    path = root / name
    try:
        if not is_local(root):
            return bytes(root.fs.cat_file(path.path, start=offset, end=offset + length))  # one request
        with path.open("rb") as file:
            # Read at most the rest of the file, so that a wrong length allocates no memory.
            length = max(0, min(length, os.fstat(file.fileno()).st_size - offset))
            file.seek(offset)
            return bytes(file.read(length))
    except (FileNotFoundError, NotADirectoryError):
        raise ReadError(shown_path(root, name), "is missing") from None
    except OSError as error:
        raise ReadError(shown_path(root, name), f"cannot be read: {error.strerror or error}") from None


def names_below(root: UPath) -> list[str]:
    """Return the names of all files below a root, sorted; links are treated as files, and not followed."""
    if not is_local(root):
        prefix = f"{root.path.rstrip('/')}/"
        return sorted(path.removeprefix(prefix) for path in root.fs.find(root.path))
    found = []
    for folder, folders, files in os.walk(root):
        links = [name for name in folders if os.path.islink(f"{folder}/{name}")]  # noqa: PTH114 - a million names
        found += [os.path.relpath(f"{folder}/{name}", root) for name in (*files, *links)]
    return sorted(found)


def write(root: UPath, name: str, data: bytes) -> None:
    """Write or replace a file, and make its folders; raises OSError where that fails."""
    path = root / name
    if is_local(root):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    else:
        root.fs.pipe_file(path.path, data)  # stores show a file only once it is complete


def replace(root: UPath, name: str, data: bytes) -> None:
    """Write or replace a file atomically; if the process is killed, a file that ends in .new may remain beside it."""
    unfinished = f"{name}.{os.getpid()}.new" if is_local(root) else name
    write(root, unfinished, data)
    if unfinished != name:
        (root / unfinished).replace(root / name)


@contextmanager
def explained_errors(root: UPath) -> Iterator[None]:
    """Turn errors of an object store, which may have any type, into an InputError with advice."""
    try:
        yield
    except Exception as error:
        if is_local(root) or isinstance(error, InputError | ReadError):
            raise
        raise InputError(
            f"{root}: {type(error).__name__}: {error}; check address, rights, connection and credentials, such as "
            "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
        ) from error
