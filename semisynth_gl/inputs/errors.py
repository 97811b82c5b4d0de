"""Errors whose cause is outside the program, functions for their messages, and skipped files."""

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self


class SemisynthError(Exception):
    """Base of every error that the command line shows as one message without a traceback.

    A message says what was expected, what was found and what to do about it.
    """


class InputError(SemisynthError):
    """An input of the user cannot be used: a config, a path, an image, a model, a scene.

    Attributes:
        argument: name of the wrong argument of a public function, or "". The message begins with this name; the
            command line shows its option instead.
    """

    def __init__(self, text: str, *, argument: str = "") -> None:
        super().__init__(text)
        self.argument = argument

    @property
    def text(self) -> str:
        """The message without the argument."""
        return super().__str__()

    def __str__(self) -> str:
        return f"{self.argument}: {self.text}" if self.argument else self.text


class ReadError(SemisynthError):
    """A file is missing, cut off, or not what its name says; ``reason`` is a clause such as ``"is missing"``."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path}: {reason}")
        self.path = path
        self.reason = reason

    def __reduce__(self) -> tuple[type[Self], tuple[Path, str]]:
        return type(self), (self.path, self.reason)


class BackendError(SemisynthError):
    """OpenGL is missing or too old, or refuses a request."""


class ContextLostError(BackendError):
    """The driver has reset the device, which ends the OpenGL context with all its objects; a new context may work."""


class WorkerError(SemisynthError):
    """A worker process died before its task was done."""


@dataclass(frozen=True, slots=True)
class SkippedFile:
    """A file that was skipped, and a clause that says why, such as ``"has no triangles"``."""

    path: Path
    reason: str

    def __str__(self) -> str:
        return f"{self.path}: {self.reason}"


def shown(value: object, most: int = 100) -> str:
    """Return a value as a message shows it: its repr, cut to ``most`` characters."""
    return cut(repr(value), most)


def cut(text: str, most: int = 100) -> str:
    """Return a text, cut to ``most`` characters and "..." if it is longer."""
    return text if len(text) <= most else f"{text[:most]}..."


def abbreviate(names: Sequence[str], most: int = 8) -> str:
    """Join names with commas; beyond ``most`` names, give the number of the rest."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, such as ``"1 pair"`` or ``"2 patches"``."""
    return f"{number} {noun}{'' if number == 1 else 'es' if noun.endswith('ch') else 's'}"


def most_similar(name: str, known: Iterable[str]) -> list[str]:
    """Return the known name that is most like a wrong name, in a list; an empty list if none is similar."""
    return difflib.get_close_matches(name, list(known), 1, 0.7)


def did_you_mean(names: Iterable[str], otherwise: str = "") -> str:
    """Ask "did you mean ...?" with these names; return ``otherwise`` if there are none."""
    joined = " or ".join(names)
    return f"did you mean {joined}?" if joined else otherwise


def how_to_install(extra: str) -> str:
    """Return the command that installs an extra of pyproject.toml; it works for checkouts too."""
    return f"pip install 'semisynth-gl[{extra}]'"
