"""Standard output and standard error. Each may be closed, full, or without a reader at any time.

A lost message does no harm: a dataset does not fail because nobody reads the messages about it. But a printed result,
such as the table of ``evaluate``, is the purpose of its command, so its loss is an error.
"""

import errno
import io
import os
import sys
from typing import Any, TextIO

import click

from semisynth_gl.inputs.errors import SemisynthError


class PrintError(SemisynthError):
    """Part of a result could not be printed, because standard output is closed, full or without a reader."""


class _Stream(io.FileIO):
    """An open descriptor. After a failed write, all further bytes are dropped; if they are results, it raises once."""

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
    """Replace ``sys.stdout`` and ``sys.stderr`` by streams that print any text; a lost message never stops a command.

    Writing to the new ``sys.stdout`` raises `PrintError` at the first loss. Closed descriptors among 0, 1 and 2 are
    opened on /dev/null; otherwise the next opened file would get the number, and a driver's messages would land in it.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    sys.stdout = _text(_Stream(1, results=True), sys.stdout)
    sys.stderr = _text(_Stream(2, results=False), sys.stderr)


def say(text: str) -> None:
    """Print a message on standard output; where that fails, print a note on standard error instead of raising."""
    try:
        click.echo(text)
    except PrintError as error:
        click.echo(f"note: {error}", err=True)


def _text(raw: io.FileIO, before: TextIO | None) -> TextIO:
    encoding = before.encoding if before is not None else "utf-8"
    # File names may hold bytes that are not text.
    return io.TextIOWrapper(io.BufferedWriter(raw), encoding, errors="backslashreplace", line_buffering=True)
