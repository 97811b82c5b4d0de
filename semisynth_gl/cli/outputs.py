"""Options that write one file. What stands under its name already is replaced only where the same command wrote it."""

import json
import os
import re
import struct
import zlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import click

from semisynth_gl.cli.options import Callback, UserPath, option
from semisynth_gl.config import Config
from semisynth_gl.dataset.begun import read_beginning
from semisynth_gl.dataset.places import Folder
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.textures.images import image_extensions
from semisynth_gl.textures.reach import photograph_sources, reaching_source

# More than a report of a million pairs.
_MOST_BYTES = 1 << 30
# Where click's context keeps the value of --overwrite.
_OVERWRITE = "semisynth_gl.overwrite"


@dataclass(frozen=True, slots=True)
class Kind:
    """What a command writes: its name in messages, and how its files are told from others.

    A new file's bytes go through ``marked``, so that ``recognises`` finds them to be of this kind.
    """

    name: str
    recognises: Callable[[bytes], bool]
    marked: Callable[[bytes], bytes] = bytes


def json_report(command: str, **values: type) -> Kind:
    """Return the kind of a JSON report, known by its keys and their types; where it has ``command``, by that too."""

    def recognises(data: bytes) -> bool:
        with suppress(ValueError, RecursionError):
            report = json.loads(data)
            if isinstance(report, dict) and str(report.get("command", command)).startswith(command):
                return all(isinstance(report.get(key), kind) for key, kind in values.items())
        return False

    return Kind(f"a report of {command}", recognises)


def _marked(name: str, head: bytes, mark: bytes) -> Kind:
    """Return the kind of a file with a mark behind its head, which is a pattern."""
    pattern = re.compile(head, re.DOTALL)

    def recognises(data: bytes) -> bool:
        found = pattern.search(data, 0, 1 << 16)
        return found is not None and data.startswith(mark, found.end())

    return Kind(name, recognises, lambda data: pattern.sub(lambda found: found[0] + mark, data, count=1))


def marked_png(command: str) -> Kind:
    """Return the kind of a PNG, whose first text says which command wrote it."""
    text = b"tEXtSoftware\0" + command.encode()
    chunk = struct.pack(">I", len(text) - 4) + text + struct.pack(">I", zlib.crc32(text))
    # Behind the signature and the first chunk.
    return _marked(f"a picture of {command}", rb"\A.{33}", chunk)


def marked_html(command: str) -> Kind:
    """Return the kind of an HTML page, whose head says which command wrote it."""
    return _marked(f"a page of {command}", rb"<head>\n", f'<meta name="generator" content="{command}">\n'.encode())


def marked_ply(command: str) -> Kind:
    """Return the kind of a binary PLY, whose first comment says which command wrote it."""
    head = rb"\Aply\nformat binary_little_endian 1\.0\n"
    return _marked(f"a point cloud of {command}", head, f"comment {command}\n".encode())


CONFIG = Kind("a config that may be replaced", lambda _: False)
"""The kind of a config: users write such files too, so a config is replaced only with --overwrite."""


@dataclass(frozen=True, slots=True)
class Output:
    """A file that an option names; ``path`` is None where no file is asked for.

    ``overwrite`` lets it replace a file of another kind too, but never a file of a dataset or an input.
    """

    option: str
    kind: Kind
    path: Path | None
    overwrite: bool

    @property
    def file(self) -> Path:
        """The file, of an option that has a default or has to be given."""
        if self.path is None:
            raise ValueError(f"{self.option} names no file")
        return self.path

    def check(self, inputs: Sequence[str] = (), photographs: Sequence[str] = (), *, makes_folder: bool = False) -> None:
        """Refuse a file that cannot or must not be written or replaced; call it before anything is computed.

        Inputs are files, folders and globs that the command reads; ``photographs`` name those with photographs.
        ``makes_folder`` says that the file's folder is made where it is missing.
        """
        if self.path is None:
            return
        path, shown = Path(os.path.realpath(self.path)), f"{self.option} {self.path}"
        if not (makes_folder or path.parent.exists()):
            raise InputError(f"{shown}: the folder {path.parent} does not exist")
        if path.is_dir():
            raise InputError(f"{shown}: is a folder; name a file")
        # Pipes and devices, such as /dev/stdout, are written as they are, and hold nothing that could be lost.
        if path.is_file() or not path.exists():
            _check_room(next(above for above in path.parents if above.exists()), shown)
        dataset = next((above for above in path.parents if _is_dataset(above)), None)
        if dataset is not None:
            raise InputError(
                f"{shown}: lies in the dataset's folder {dataset}, where verify would take it for a foreign file; name "
                "a file outside it"
            )
        source = reaching_source(path, photographs, image_extensions())
        if source is not None:
            raise InputError(
                f"{shown}: lies where photographs are sought ({source}), and would become one; name a file elsewhere"
            )
        if not path.is_file() or self.kind.recognises(_head(path)):
            return
        source = reaching_source(path, inputs)
        if source is not None:
            raise InputError(f"{shown}: is an input ({source}), which is left as it is; name another file")
        if not self.overwrite:
            raise InputError(
                f"{shown}: is there already, and is not {self.kind.name}; choose another name, or replace it with "
                "--overwrite"
            )

    def check_beside(self, config_name: str, config: Config) -> None:
        """`check` beside a config and all that it names: photographs and models."""
        self.check((config_name, *config.models.folders), photograph_sources(config.textures))

    def write(self, data: bytes) -> None:
        """Write the file under a name of this process, then rename it: it is complete, or as it was before."""
        if self.path is None:
            return
        self.path.parent.mkdir(parents=True, exist_ok=True)
        path, data = Path(os.path.realpath(self.path)), self.kind.marked(data)
        if path.exists() and not path.is_file():
            path.write_bytes(data)
            return
        partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
        try:
            partial.write_bytes(data)
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)

    def write_json(self, values: object, *, allow_nan: bool = True) -> None:
        """Write values as JSON."""
        if self.path is not None:
            self.write(f"{json.dumps(values, indent=1, allow_nan=allow_nan)}\n".encode())


def _check_room(folder: Path, shown: str) -> None:
    """Refuse a folder that takes no new file: permissions do not tell, of a full disk or of the kernel's files."""
    if not folder.is_dir():
        raise InputError(f"{shown}: {folder} is a file; name a folder")
    try:
        with TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(f"{shown}: the folder {folder} cannot be written to: {error.strerror or error}") from None


def further_output_option(
    name: str, parameter: str, kind: Kind, *endings: str, **settings: str | bool
) -> Callable[[Callback], Callback]:
    """Return a decorator for an option that names a further file to write, beside the `output_option` of the command.

    A parameter of the command takes the `Output`. The file's name has to end in one of the endings, if any are given.
    """

    def opened(ctx: click.Context, _: click.Parameter, path: Path | None) -> Output:
        if path is not None and endings and path.suffix.lower() not in endings:
            raise InputError(f"{name} {path}: expected a name that ends in {endings[0]}")
        return Output(name, kind, path, ctx.meta[_OVERWRITE])

    attributes: dict[str, Any] = {"type": UserPath(), "callback": opened, **settings}
    return option(name, parameter, **attributes)


def output_option(name: str, kind: Kind, *endings: str, **settings: str | bool) -> Callable[[Callback], Callback]:
    """Return a decorator for a file to write, the command's parameter ``output``, and for --overwrite."""

    def keep(ctx: click.Context, _: click.Parameter, overwrite: bool) -> None:
        ctx.meta[_OVERWRITE] = overwrite

    file = further_output_option(name, "output", kind, *endings, **settings)
    flag = option(
        "--overwrite",
        is_flag=True,
        is_eager=True,  # read before the files' names
        expose_value=False,
        callback=keep,
        help=f"Replace the file of {name} whatever it is, but for inputs.",
    )
    return lambda command: file(flag(command))


def _is_dataset(folder: Path) -> bool:
    with suppress(OSError):
        return read_beginning(Folder(folder)) is not None
    return False


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(_MOST_BYTES)
