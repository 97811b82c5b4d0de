"""Options that write one file. What stands under its name already is replaced only where the same command wrote it."""

import json
import os
import struct
import zlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import wraps
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
# PNG's signature and its first chunk.
_PNG_HEAD = 33


@dataclass(frozen=True, slots=True)
class Kind:
    """What a command writes, and how it is known again.

    Attributes:
        name: the words for it in messages.
        recognises: returns whether a file's bytes are of this kind.
        marked: returns the bytes of a new file so that they are recognised.
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


def marked_png(command: str) -> Kind:
    """Return the kind of a PNG, whose first text says which command wrote it."""
    text = b"tEXtSoftware\0" + command.encode()
    chunk = struct.pack(">I", len(text) - 4) + text + struct.pack(">I", zlib.crc32(text))

    def recognises(data: bytes) -> bool:
        return data[_PNG_HEAD:].startswith(chunk)

    return Kind(f"a picture of {command}", recognises, lambda data: data[:_PNG_HEAD] + chunk + data[_PNG_HEAD:])


def marked_html(command: str) -> Kind:
    """Return the kind of an HTML page, whose head says which command wrote it."""
    tag = f'<meta name="generator" content="{command}">'.encode()
    head = b"<head>\n"

    def recognises(data: bytes) -> bool:
        return head + tag in data[: 1 << 16]

    return Kind(f"a page of {command}", recognises, lambda data: data.replace(head, head + tag + b"\n", 1))


def marked_ply(command: str) -> Kind:
    """Return the kind of a binary PLY, whose first comment says which command wrote it."""
    head = b"ply\nformat binary_little_endian 1.0\n"
    marked_head = head + f"comment {command}\n".encode()

    def recognises(data: bytes) -> bool:
        return data.startswith(marked_head)

    return Kind(f"a point cloud of {command}", recognises, lambda data: data.replace(head, marked_head, 1))


CONFIG = Kind("a config that may be replaced", lambda _: False)
"""The kind of a config: users write such files too, so none is replaced without being asked for."""


@dataclass(frozen=True, slots=True)
class Output:
    """A file that an option names.

    Attributes:
        option: the option, for messages.
        kind: what is written.
        path: the file, or None where none is asked for.
        overwrite: replace a file of another kind too; never a file of a dataset or an input.
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

    def at(self, path: Path) -> "Output":
        """Return the output in another file."""
        return replace(self, path=path)

    def check(self, inputs: Sequence[str] = (), photographs: Sequence[str] = (), *, makes_folder: bool = False) -> None:
        """Refuse a file that cannot or must not be written or replaced; call it before anything is computed.

        Args:
            inputs: files, folders and globs that the command reads.
            photographs: those that it takes photographs from.
            makes_folder: whether the file's folder is made where it is missing.

        Raises:
            InputError: with the file, and what would be lost.
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


def _check_room(folder: Path, shown: str) -> None:
    """Refuse a folder that takes no new file: permissions do not tell, of a full disk or of the kernel's files."""
    if not folder.is_dir():
        raise InputError(f"{shown}: {folder} is a file; name a folder")
    try:
        with TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(f"{shown}: the folder {folder} cannot be written to: {error.strerror or error}") from None


def ending_check(name: str, *endings: str) -> Callable[..., Path | None]:
    """Return a callback for click that refuses files whose names end otherwise; see `output_option`."""

    def check(_: click.Context, __: click.Parameter, path: Path | None) -> Path | None:
        if path is not None and endings and path.suffix.lower() not in endings:
            raise InputError(f"{name} {path}: expected a name that ends in {endings[0]}")
        return path

    return check


def output_option(
    name: str,
    kind: Kind,
    *endings: str,
    help: str,  # noqa: A002 - click's word
    default: str | None = None,
    required: bool = False,
) -> Callable[[Callback], Callback]:
    """Return a decorator that adds an option for a file to write, and --overwrite, and gives the command an `Output`.

    Args:
        name: the option.
        kind: what is written.
        *endings: the endings that the name may have; none for any.
        help: of the option.
        default: the file's name where the option is not given.
        required: whether it has to be given.
    """

    def decorate(command: Callback) -> Callback:
        @wraps(command)
        def with_output(*, output_path: Path | None, overwrite: bool, **values: Any) -> Any:  # noqa: ANN401 - click's
            return command(output=Output(name, kind, output_path, overwrite), **values)

        # An option whose default is said to be None counts as given, and would never be missed.
        defaults: dict[str, Any] = {} if default is None else {"default": default}
        flag = option("--overwrite", is_flag=True, help=f"Replace the file of {name} whatever it is, but for inputs.")
        file = option(
            name,
            "output_path",
            type=UserPath(),
            callback=ending_check(name, *endings),
            required=required,
            **defaults,
            help=help,
        )
        return file(flag(with_output))

    return decorate


def _is_dataset(folder: Path) -> bool:
    with suppress(OSError):
        return read_beginning(Folder(folder)) is not None
    return False


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(_MOST_BYTES)
