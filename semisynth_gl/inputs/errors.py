"""Errors whose cause lies outside the program, what their messages share, and the files that were skipped."""

import difflib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import requires
from pathlib import Path


class SemisynthError(Exception):
    """Base of every error that the command line shows as one message without a traceback.

    A message says what was expected, what came and what to do about it.
    """


class InputError(SemisynthError):
    """An input of the user cannot be used: a config, a path, an image, a model, a scene."""


class ReadError(SemisynthError):
    """A file is missing, cut off, or not what its name says; the reason is a clause, as of `Skipped`."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path}: {reason}")
        self.path = path
        self.reason = reason


class BackendError(SemisynthError):
    """OpenGL is missing or too old, or refuses a request."""


class ContextLostError(BackendError):
    """The driver has reset the device and ended the OpenGL context with all its objects; a new context may work."""


class WorkerError(SemisynthError):
    """A worker process ended before its task."""


@dataclass(frozen=True, slots=True)
class Skipped:
    """A file that was skipped, and a clause that says why, such as ``"has no triangles"``."""

    path: Path
    reason: str

    def __str__(self) -> str:
        return f"{self.path}: {self.reason}"


def shown(value: object, most: int = 100) -> str:
    """Return a value as a message shows it, cut where it is longer than so many characters."""
    try:
        return cut(repr(value), most)
    except Exception:  # noqa: BLE001 - a value's own method may raise anything; whole numbers of 4301 digits do
        whole = isinstance(value, int)
        return "a number of thousands of digits" if whole else f"a {type(value).__name__} that cannot be shown"


def described(error: BaseException) -> str:
    """Return the type and the text of an error of other people's code."""
    try:
        text = str(error)
    except Exception:  # noqa: BLE001 - its own method may raise anything
        text = "its text cannot be shown"
    return f"{type(error).__name__}: {text}"


def cut(text: str, most: int = 100) -> str:
    """Return a text, cut where it is longer than so many characters."""
    return text if len(text) <= most else f"{text[:most]}..."


def abbreviate(names: Sequence[str], most: int = 8) -> str:
    """Join names with commas; of more than ``most``, write the first ones and the number of the others."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, such as ``"1 pair"``, ``"2 patches"`` or ``"3 kinds of model"``."""
    head, of, rest = noun.partition(" of ")
    plural = "" if number == 1 else "es" if head.endswith(("ch", "s", "x")) else "s"
    return f"{number} {head}{plural}{of}{rest}"


def near(name: str, known: Iterable[str], least_ratio: float = 0.7) -> list[str]:
    """Return the known name that a wrong one was most likely meant for, or nothing.

    The two must be alike by ``least_ratio`` or more, see `difflib.SequenceMatcher.ratio`.
    """
    return difflib.get_close_matches(name, list(known), 1, least_ratio)


def did_you_mean(names: Iterable[str], otherwise: str = "") -> str:
    """Return the question for a message, or other words where there are no names."""
    listed = " or ".join(names)
    return f"did you mean {listed}?" if listed else otherwise


def how_to_install(extra: str) -> str:
    """Return the commands that install an extra of pyproject.toml, from an index or beside a wheel or checkout."""
    ours = re.compile(rf"(.*?)\s*;.*\bextra\s*==\s*['\"]{extra}['\"]")
    packages = [f"'{found[1]}'" for text in requires("semisynth-gl") or () if (found := ours.match(text))]
    return (
        f"pip install 'semisynth-gl[{extra}]', or, where semisynth-gl came as a wheel or a checkout, "
        f"pip install {' '.join(packages)}"
    )
