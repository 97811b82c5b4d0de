"""Files that commands write."""

import json
import os
from pathlib import Path

import click

from semisynth_gl.cli.options import UserPath
from semisynth_gl.inputs.errors import InputError


class OutputFile(UserPath):
    """The type of a file to write; its folder has to exist, and its name to have one of the ``endings``, if any."""

    def __init__(self, *endings: str) -> None:
        super().__init__()
        self._endings = endings

    def convert(self, value: str | os.PathLike[str], param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path; raises InputError, which names the option, before anything is computed."""
        path = super().convert(value, param, ctx)
        shown = f"{param.opts[0] if param else 'file'} {path}"
        if self._endings and path.suffix.lower() not in self._endings:
            raise InputError(f"{shown}: expected a name that ends in {self._endings[0]}")
        if not path.parent.is_dir():
            raise InputError(f"{shown}: the folder {path.parent} does not exist")
        if path.is_dir():
            raise InputError(f"{shown}: is a folder; name a file")
        return path


def write_json(path: Path, values: object) -> None:
    """Write values as JSON."""
    path.write_text(f"{json.dumps(values, indent=1)}\n", "utf-8")
