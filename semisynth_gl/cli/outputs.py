"""Options that name a file to write.

An existing file is replaced if the same command wrote it. With --overwrite, any other file is replaced too, except
for an input or a dataset's file.
"""

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

# Most bytes that are read to recognise a file; a report on a million pairs has fewer.
_MOST_BYTES = 1 << 30
# Where click's context keeps the value of --overwrite.
_OVERWRITE = "semisynth_gl.overwrite"


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of file that a command writes.

    Attributes:
        name: the kind in messages, after "is not ".
        recognises: tells from the first bytes of a file, at most 1 GiB, whether it is of this kind.
        marked: puts the mark by which ``recognises`` knows the kind into the bytes of a new file.
    """

    name: str
    recognises: Callable[[bytes], bool]
    marked: Callable[[bytes], bytes] = bytes


def json_report(command: str, **values: type) -> Kind:
    """Return the kind of a JSON report that has the keys of ``values``, with values of these types.

    A report with a key "command" must be a report of the same command.
    """

    def recognises(data: bytes) -> bool:
        with suppress(ValueError, RecursionError):
            report = json.loads(data)
            if isinstance(report, dict) and str(report.get("command", command)).startswith(command):
                return all(isinstance(report.get(key), kind) for key, kind in values.items())
        return False

    return Kind(f"a report of {command}", recognises)


def _marked(name: str, head: bytes, mark: bytes) -> Kind:
    """Return the kind of a file that has ``mark`` after its head; ``head`` is a pattern."""
    pattern = re.compile(head, re.DOTALL)

    def recognises(data: bytes) -> bool:
        found = pattern.search(data, 0, 1 << 16)
        return found is not None and data.startswith(mark, found.end())

    return Kind(name, recognises, lambda data: pattern.sub(lambda found: found[0] + mark, data, count=1))


def marked_png(command: str) -> Kind:
    """Return the kind of a PNG whose first text chunk names the command that wrote it."""
    text = b"tEXtSoftware\0" + command.encode()
    chunk = struct.pack(">I", len(text) - 4) + text + struct.pack(">I", zlib.crc32(text))
    # The text comes after the signature and the first chunk.
    return _marked(f"a picture of {command}", rb"\A.{33}", chunk)


def marked_html(command: str) -> Kind:
    """Return the kind of an HTML page whose head names the command that wrote it."""
    return _marked(f"a page of {command}", rb"<head>\n", f'<meta name="generator" content="{command}">\n'.encode())


def marked_ply(command: str) -> Kind:
    """Return the kind of a binary PLY whose first comment names the command that wrote it."""
    head = rb"\Aply\nformat binary_little_endian 1\.0\n"
    return _marked(f"a point cloud of {command}", head, f"comment {command}\n".encode())


CONFIG = Kind("a file that this command replaces unasked", lambda _: False)
"""The kind of a config. It recognises no file: users write configs too, so one is replaced only with --overwrite."""


@dataclass(frozen=True, slots=True)
class Output:
    """A file to write.

    Attributes:
        option: the option that names the file, as messages show it.
        kind: what is written.
        path: the file; None where the option was not given.
        overwrite: whether an existing file of another kind may be replaced; a dataset's file or an input may never.
    """

    option: str
    kind: Kind
    path: Path | None
    overwrite: bool

    @property
    def file(self) -> Path:
        """The path, for options that have a default or are required; raises ValueError where it is None."""
        if self.path is None:
            raise ValueError(f"{self.option} names no file")
        return self.path

    def check(self, inputs: Sequence[str] = (), photographs: Sequence[str] = (), *, makes_folder: bool = False) -> None:
        """Refuse a file that cannot or must not be written or replaced; call this before anything is computed.

        Args:
            inputs: files, folders and globs that the command reads.
            photographs: files, folders and globs of photographs; the file must not become one of them.
            makes_folder: whether `write` may make the file's folder; otherwise the folder must exist.

        Raises:
            InputError: names the option, the file and the fault.
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
                f"{shown}: lies in the dataset's folder {dataset}, where verify would report it; name a file outside "
                "the folder"
            )
        source = reaching_source(path, photographs, image_extensions())
        if source is not None:
            raise InputError(
                f"{shown}: lies among the photographs ({source}) and would be read as one; name a file elsewhere"
            )
        if not path.is_file() or self.kind.recognises(_head(path)):
            return
        source = reaching_source(path, inputs)
        if source is not None:
            raise InputError(f"{shown}: is an input ({source}), which is never replaced; name another file")
        if not self.overwrite:
            raise InputError(
                f"{shown}: exists already and is not {self.kind.name}; choose another name, or replace it with "
                "--overwrite"
            )

    def check_beside(self, config_name: str, config: Config) -> None:
        """Call `check` with a config, and the models and photographs that it names, as inputs."""
        self.check((config_name, *config.models.folders), photograph_sources(config.textures))

    def write(self, data: bytes) -> None:
        """Write the file, if any, and its folder; a failure leaves an existing file as it was.

        The data go to a temporary file that is renamed at the end. Pipes and devices are written to directly.
        """
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
        """Write values as JSON; without ``allow_nan``, ValueError is raised for NaN and infinity."""
        if self.path is not None:
            self.write(f"{json.dumps(values, indent=1, allow_nan=allow_nan)}\n".encode())


def _check_room(folder: Path, shown: str) -> None:
    """Refuse a folder in which no file can be made; permissions do not show a full disk or a kernel's file system."""
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
    """Return a decorator that adds an option for a second file to write; the command needs an `output_option` too.

    Args:
        name: the option.
        parameter: the command's parameter, which takes the `Output`.
        kind: what is written.
        endings: the name's possible endings, in lower case with a dot; any ending will do where none is given.
        settings: further arguments of `option`.
    """

    def opened(ctx: click.Context, _: click.Parameter, path: Path | None) -> Output:
        if path is not None and endings and path.suffix.lower() not in endings:
            raise InputError(f"{name} {path}: expected a name that ends in {endings[0]}")
        return Output(name, kind, path, ctx.meta[_OVERWRITE])

    attributes: dict[str, Any] = {"type": UserPath(), "callback": opened, **settings}
    return option(name, parameter, **attributes)


def output_option(name: str, kind: Kind, *endings: str, **settings: str | bool) -> Callable[[Callback], Callback]:
    """Return a decorator that adds --overwrite and an option for a file to write, the parameter ``output``.

    The arguments are those of `further_output_option`.
    """

    def keep(ctx: click.Context, _: click.Parameter, overwrite: bool) -> None:
        ctx.meta[_OVERWRITE] = overwrite

    file = further_output_option(name, "output", kind, *endings, **settings)
    flag = option(
        "--overwrite",
        is_flag=True,
        is_eager=True,  # read before the files' names
        expose_value=False,
        callback=keep,
        help="Replace existing files of any kind, except inputs and files of a dataset.",
    )
    return lambda command: file(flag(command))


def _is_dataset(folder: Path) -> bool:
    with suppress(OSError):
        return read_beginning(Folder(folder)) is not None
    return False


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(_MOST_BYTES)
