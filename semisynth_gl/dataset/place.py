"""The root of a dataset, wherever it is: what can be asked of it and done to it.

A file appears when it is complete. Names are paths below the place, with slashes. Files are read without any state that
processes or threads could share: each reading opens what it needs.
"""

from abc import ABC, abstractmethod
from pathlib import Path
from typing import BinaryIO


class Place(ABC):
    """A dataset's root, at the address that the user gave; ``local`` is its folder, None if not on this machine."""

    address: str
    local: Path | None

    @abstractmethod
    def read(self, name: str) -> bytes:
        """Read a file; raises FileNotFoundError where it is missing, and OSError where it cannot be read.

        Raises:
            ReadError: where the name, or a link, leads out of the place, or the file is no plain file.
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
        """Write or replace a file atomically; raises OSError where it cannot be written.

        Raises:
            InputError: where a link, or what else stands in the place of a folder, may lead the file out of the place.
        """

    @abstractmethod
    def put(self, name: str, file: Path) -> None:
        """Move a file of this machine to the place atomically; raises like `write`."""

    @abstractmethod
    def remove(self, name: str) -> None:
        """Remove a file, if it is there; raises InputError like `write`."""

    def path(self, name: str) -> Path:
        """Return a file's path, for messages and where the place is local."""
        return Path(self.address) / name
