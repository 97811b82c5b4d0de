"""Options that name a file to write."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import click

from semisynth_gl.cli.options import Callback, UserPath, option
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.inputs.user_files import expanded

# Where click's context keeps the value of --overwrite.
_OVERWRITE = "semisynth_gl.overwrite"


@dataclass(frozen=True, slots=True)
class Output:
    """A file to write; ``path`` is None where the ``option`` was not given."""

    option: str
    path: Path | None
    overwrite: bool

    def check(self, *inputs: str) -> None:
        """Refuse a file that cannot or must not be written; call this before anything is computed.

        ``inputs`` are files that the command reads. Raises InputError, which names the option, the file and the fault.
        """
        if self.path is None:
            return
        folder, shown = self.path.parent, f"{self.option} {self.path}"
        if not folder.is_dir():
            raise InputError(f"{shown}: the folder {folder} does not exist")
        if self.path.is_dir():
            raise InputError(f"{shown}: is a folder; name a file")
        if self.path.resolve() in [expanded(source).resolve() for source in inputs]:
            raise InputError(f"{shown}: is an input; name another file")
        if self.path.is_file() and not self.overwrite:
            raise InputError(f"{shown}: exists already; choose another name, or replace it with --overwrite")
        if not self.path.exists():
            try:
                TemporaryFile(dir=folder).close()  # permissions do not show a full disk
            except OSError as error:
                raise InputError(f"{shown}: the folder cannot be written to: {error.strerror or error}") from None

    def write(self, data: bytes) -> None:
        """Write the file, if any."""
        if self.path is not None:
            self.path.write_bytes(data)

    def write_json(self, values: object, *, allow_nan: bool = True) -> None:
        """Write values as JSON; without ``allow_nan``, ValueError is raised for NaN and infinity."""
        self.write(f"{json.dumps(values, indent=1, allow_nan=allow_nan)}\n".encode())


def further_output_option(name: str, parameter: str, *endings: str, **settings: Any) -> Callable[[Callback], Callback]:  # noqa: ANN401 - click's
    """Return a decorator that adds an option for a second file to write; the command needs an `output_option` too.

    Args:
        name: the option.
        parameter: the command's parameter, which takes the `Output`.
        endings: the name's possible endings, in lower case with a dot; any ending will do where none is given.
        settings: further arguments of `option`.
    """

    def opened(ctx: click.Context, _: click.Parameter, path: Path | None) -> Output:
        if path is not None and endings and path.suffix.lower() not in endings:
            raise InputError(f"{name} {path}: expected a name that ends in {endings[0]}")
        return Output(name, path, ctx.meta[_OVERWRITE])

    return option(name, parameter, type=UserPath(), callback=opened, **settings)


def output_option(name: str, *endings: str, **settings: Any) -> Callable[[Callback], Callback]:  # noqa: ANN401 - click's
    """Return a decorator that adds --overwrite and an option for a file to write, the parameter ``output``."""

    def keep(ctx: click.Context, _: click.Parameter, overwrite: bool) -> None:
        ctx.meta[_OVERWRITE] = overwrite

    file = further_output_option(name, "output", *endings, **settings)
    # Eager options are read before the files' names.
    attributes: Any = {"is_flag": True, "is_eager": True, "expose_value": False, "callback": keep}
    flag = option("--overwrite", help="Replace existing files.", **attributes)
    return lambda command: file(flag(command))
