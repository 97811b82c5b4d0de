"""Options that several commands share, and the files that options name."""

import os
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial, wraps
from pathlib import Path
from typing import Any

import click

from semisynth_gl.config import Config, load_config, packaged_configs
from semisynth_gl.errors import InputError
from semisynth_gl.render.context import BACKENDS, Backend

Command = Callable[..., Any]

option = partial(click.option, show_default=True)
NATURAL = click.IntRange(min=0)
COUNT = click.IntRange(min=1)


class OutputFile(click.Path):
    """The type of an option that names a file to write; the folder must exist.

    Args:
        endings: the endings that the name may have; none for any.
    """

    def __init__(self, *endings: str) -> None:
        super().__init__(path_type=Path)
        self._endings = endings

    def convert(self, value: str | os.PathLike[str], param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path, or refuse a file that cannot be written, before anything is computed."""
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        name = param.opts[0] if param is not None else "file"
        if self._endings and path.suffix.lower() not in self._endings:
            raise InputError(f"{name} {path}: expected a name that ends in {self._endings[0]}")
        if not path.absolute().parent.is_dir():
            raise InputError(f"{name} {path}: the folder {path.absolute().parent} does not exist")
        return path


def option_group(name: str, group: type, *options: Callable[[Command], Command]) -> Callable[[Command], Command]:
    """Return a decorator that adds options to a command and gives it their values as one argument.

    Args:
        name: the name of the command's parameter.
        group: a dataclass with a field for the value of each option.
        options: click's options, in the order of the help.
    """
    names = [field.name for field in fields(group)]

    def decorate(command: Command) -> Command:
        @wraps(command)
        def grouped(**values: Any) -> Any:  # noqa: ANN401 - click's
            values[name] = group(**{field: values.pop(field) for field in names})
            return command(**values)

        for add_option in reversed(options):
            add_option(grouped)
        return grouped

    return decorate


images_option = partial(
    option,
    "--images",
    multiple=True,
    metavar="PATH_OR_GLOB",
    help="Photographs to cut patches from: a file, folder or glob. May be repeated.",
)


@dataclass(frozen=True, slots=True)
class SceneOptions:
    """The options that decide what pairs show, and how they are rendered."""

    config_name: str
    images: tuple[str, ...]
    models: tuple[str, ...]
    seed: int
    settings: tuple[str, ...]
    backend: Backend

    def config(self, *settings: str) -> Config:
        """Load the config that the options describe, with further settings."""
        return read_config(self.config_name, self.images, self.models, (*self.settings, *settings))


scene_options = option_group(
    "scene",
    SceneOptions,
    option(
        "--config",
        "config_name",
        required=True,
        metavar="NAME_OR_PATH",
        help=f"A YAML file, or a packaged config: {', '.join(packaged_configs())}.",
    ),
    images_option(),
    option(
        "--models",
        multiple=True,
        metavar="DIR",
        help="A folder of 3D models to add to those that are built in. May be repeated.",
    ),
    option("--seed", type=NATURAL, default=0, help="Another seed, another dataset."),
    option(
        "--set",
        "settings",
        multiple=True,
        metavar="dotted.key=value",
        help="Override a key of the config, for example camera.width_px=640. May be repeated.",
    ),
    option(
        "--backend",
        type=click.Choice(BACKENDS),
        default="auto",
        help="egl: a GPU, or llvmpipe; osmesa: Mesa's off-screen renderer; auto: the first that works.",
    ),
)


def read_config(
    config_name: str, images: tuple[str, ...], models: tuple[str, ...], settings: tuple[str, ...]
) -> Config:
    """Load the config that the options --config, --images, --models and --set describe."""
    overrides = list(settings)
    config = load_config(config_name, overrides)
    if images:
        overrides += ["textures.source=images", f"textures.images={_quoted(images)}"]
    if models:
        overrides.append(f"models.folders={_quoted((*config.models.folders, *models))}")
    return load_config(config_name, overrides)


def _quoted(values: tuple[str, ...]) -> str:
    """Write strings as a YAML list."""
    quoted = ("'" + value.replace("'", "''") + "'" for value in values)
    return f"[{', '.join(quoted)}]"


def write_output(path: Path, data: bytes) -> None:
    """Write a file under a name of this process, then rename it: the file is complete, or as it was before."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        partial.write_bytes(data)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
