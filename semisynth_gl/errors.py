"""What can go wrong for reasons that lie outside the program, and how it is told."""

from dataclasses import dataclass
from pathlib import Path


class SemisynthError(Exception):
    """Base of every error that the command line shows as one message without a traceback.

    A message says what was expected, what came and what to do about it.
    """


class InputError(SemisynthError):
    """Something that the user gave cannot be used: a config, a path, an image, a model, a scene."""


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


class BackendError(SemisynthError):
    """OpenGL is missing, too old, or refuses what a scene needs."""


class ContextLostError(BackendError):
    """The OpenGL context is gone: the driver reset the device. All that was on it is lost; a new context may work."""


class WorkerError(SemisynthError):
    """A worker process ended before its work did."""


@dataclass(frozen=True, slots=True)
class Skipped:
    """A file that was left out, and why.

    Attributes:
        path: the file as it was found.
        reason: a clause such as ``"has no triangles"``.
    """

    path: Path
    reason: str

    def __str__(self) -> str:
        return f"{self.path}: {self.reason}"
