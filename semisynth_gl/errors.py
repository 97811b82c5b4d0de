"""Errors whose cause lies outside the program, and the files that were skipped."""

from dataclasses import dataclass
from pathlib import Path


class SemisynthError(Exception):
    """Base of every error that the command line shows as one message without a traceback.

    A message says what was expected, what came and what to do about it.
    """


class InputError(SemisynthError):
    """An input of the user cannot be used: a config, a path, an image, a model, a scene."""


class BackendError(SemisynthError):
    """OpenGL is missing or too old, or refuses a request."""


class ContextLostError(BackendError):
    """The driver has reset the device and ended the OpenGL context with all its objects; a new context may work."""


class WorkerError(SemisynthError):
    """A worker process ended before its task."""


@dataclass(frozen=True, slots=True)
class Skipped:
    """A file that was skipped.

    Attributes:
        path: the file.
        reason: a clause such as ``"has no triangles"``.
    """

    path: Path
    reason: str

    def __str__(self) -> str:
        return f"{self.path}: {self.reason}"
