"""The root of a dataset, in a folder or elsewhere: how its files are read, listed, written and removed.

A file appears only when it is complete. Names are paths below the place, with slashes. Processes and threads may share
a place: each read opens the file anew.
"""

from abc import ABC, abstractmethod
from pathlib import Path
from typing import BinaryIO


class Place(ABC):
    """A dataset's root, at the address that the user gave; ``local`` is its folder on this machine, or None."""

    address: str
    local: Path | None

    @abstractmethod
    def read(self, name: str) -> bytes:
        """Read a file; raises FileNotFoundError where it is missing, and OSError where it cannot be read.

        Raises:
            ReadError: where the name leads out of the place or through a link, or names no plain file.
        """

    @abstractmethod
    def read_part(self, name: str, offset: int, length: int) -> bytes:
        """Read ``length`` bytes from ``offset`` on, fewer where the file ends earlier; raises like `read`."""

    @abstractmethod
    def open(self, name: str) -> BinaryIO:
        """Open a file for reading, with seeking; raises like `read`."""

    @abstractmethod
    def size(self, name: str) -> int | None:
        """Return a file's size in bytes, or None where the file is missing; raises `read`'s other errors."""

    @abstractmethod
    def names(self, folder: str = "") -> list[str]:
        """Return the names of all files in a folder and below it, sorted; none where the folder is missing."""

    @abstractmethod
    def write(self, name: str, data: bytes) -> None:
        """Write or replace a file atomically; raises OSError where it cannot be written.

        Raises:
            InputError: where a link among the file's folders may lead out of the place, or one of its folders is no
                folder.
        """

    @abstractmethod
    def put(self, name: str, file: Path) -> None:
        """Move a file of this machine to ``name`` in the place atomically; raises like `write`."""

    @abstractmethod
    def remove(self, name: str) -> None:
        """Remove a file, or do nothing where it is missing; raises InputError like `write`."""

    def path(self, name: str) -> Path:
        """Return a file's path, for messages; only a local place's path can be opened."""
        return Path(self.address) / name
