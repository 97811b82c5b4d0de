"""Standard output and standard error that may be closed, full, or left by their reader at any time.

Messages are lost then, and nothing else: a dataset does not fail because nobody hears of it. A result that is printed,
such as the table of ``evaluate``, is what the command was run for, so that its loss is an error.
"""

import errno
import io
import os
import sys
from typing import Any, TextIO

import click

from semisynth_gl.inputs.errors import SemisynthError


class PrintError(SemisynthError):
    """Standard output takes no more."""


class _Stream(io.FileIO):
    """An open descriptor; what it does not take is dropped, and all that follows. The first loss of results is told."""

    def __init__(self, descriptor: int, *, results: bool) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self._results = results
        self._lost = False

    def write(self, data: Any) -> int:  # noqa: ANN401 - any buffer
        if not self._lost:
            try:
                return super().write(data) or 0
            except OSError as error:
                self._lost = True
                if self._results:
                    left = error.errno == errno.EPIPE
                    why = "nobody reads standard output any more" if left else f"standard output: {error.strerror}"
                    raise PrintError(f"{why}, so not all of it was printed") from None
        return memoryview(data).nbytes


def guard_streams() -> None:
    """Replace ``sys.stdout`` and ``sys.stderr`` by streams that print any text and never stop a command for a message.

    A closed descriptor of the first three is opened on /dev/null: the next file to be opened would get its number, and
    with it every message of a driver.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    sys.stdout = _text(_Stream(1, results=True), sys.stdout)
    sys.stderr = _text(_Stream(2, results=False), sys.stderr)


def say(text: str) -> None:
    """Print a message on standard output; where it takes none, standard error says so."""
    try:
        click.echo(text)
    except PrintError as error:
        click.echo(f"note: {error}", err=True)


def _text(raw: io.FileIO, before: TextIO | None) -> TextIO:
    encoding = before.encoding if before is not None else "utf-8"
    # Names of files may hold bytes that are no text.
    return io.TextIOWrapper(io.BufferedWriter(raw), encoding, errors="backslashreplace", line_buffering=True)
