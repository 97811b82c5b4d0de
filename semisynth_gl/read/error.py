"""What is wrong with a file that was read."""

from pathlib import Path

from semisynth_gl.errors import SemisynthError


class ReadError(SemisynthError):
    """A file is missing, cut off, or not what its name says.

    Args:
        path: the file.
        reason: a clause such as ``"ends after 12 of 4096 bytes"``.
    """

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path}: {reason}")
        self.path = path
        self.reason = reason


def read_bytes(path: Path) -> bytes:
    """Read a file whole.

    Raises:
        ReadError: where it is missing or the disk refuses.
    """
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise ReadError(path, "is missing") from None
    except OSError as error:
        raise ReadError(path, f"cannot be read: {error.strerror}") from None
