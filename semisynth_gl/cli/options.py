"""Options that several commands share, and the types of options' values."""

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial, wraps
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from semisynth_gl.cli.completion import beginning
from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.config import Config, load_config, packaged_configs
from semisynth_gl.config.explain import config_keys
from semisynth_gl.config.load import summaries
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.render.backends import BACKENDS, Backend

Callback = Callable[..., Any]

option = partial(click.option, show_default=True)

_MOST = 10_000_000
NATURAL = click.IntRange(min=0, max=_MOST)
COUNT = click.IntRange(min=1, max=_MOST)
MOST_WORKERS = 1024
# JSON readers in other languages take whole numbers of at most 64 bits.
SEED = click.IntRange(min=0, max=(1 << 63) - 1)


class Command(click.Command):
    """A command whose errors name its options in place of the library's arguments."""

    def invoke(self, ctx: click.Context) -> Any:  # noqa: ANN401 - click's signature
        """Run the command."""
        try:
            return super().invoke(ctx)
        except InputError as error:
            name_option(error, self)
            raise


def name_option(error: InputError, command: click.Command) -> None:
    """Put a command's option in place of the argument that an error is about."""
    name = "settings" if error.argument == "overrides" else error.argument
    options = {each.name: max(each.opts, key=len) for each in command.params if isinstance(each, click.Option)}
    error.argument = options.get(name, error.argument)


class Number(click.FloatRange):
    """The type of a number in a range; unlike click's own type, it refuses nan."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:  # noqa: ANN401
        """Return the number, or refuse a value that is not a number in the range."""
        number = float(super().convert(value, param, ctx))
        if math.isnan(number):
            self.fail(f"{value!r} is not a number.", param, ctx)
        return number


def above_0(largest: float) -> Number:
    """Return the type of a number above 0 and up to ``largest``."""
    return Number(min=0, min_open=True, max=largest)


class UserPath(click.Path):
    """The type of a path to a file or folder; ``~`` is the home folder, and an empty name is refused."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: str | os.PathLike[str], param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path."""
        named = _named(os.fsdecode(value), param)
        return _at_home(os.fsdecode(super().convert(named, param, ctx)), param)


class FilesType(click.types.StringParamType):
    """The type of a file, folder, glob or address as the user wrote it; the command looks for the files later.

    With ``home``, the type replaces ``~`` in a path by the home folder; without, that is left to the search for files.
    """

    def __init__(self, *, home: bool = False) -> None:
        self._home = home

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:  # noqa: ARG002 - click's
        """Leave the completion of files and folders to the shell."""
        return [CompletionItem(incomplete, type="file")]

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:  # noqa: ARG002 - click's
        """Return the value; refuse an empty one, which would mean the current folder."""
        named = _named(value, param)
        return str(_at_home(named, param)) if self._home and "://" not in named else named


class ConfigName(FilesType):
    """The type of an option that names a config."""

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Offer the packaged configs, and files."""
        # Bash drops the candidates that come before a completion of files.
        return [*super().shell_complete(ctx, param, incomplete), *beginning(packaged_configs(), incomplete)]


class Setting(click.types.StringParamType):
    """The type of an option that sets a key of a config."""

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:  # noqa: ARG002 - click's
        """Offer the keys that can have a value; sections and the keys of single forms of a value are left out."""
        keys = [f"{key.dotted}=" for key in config_keys() if not key.is_section]
        return beginning([*keys, "scale="], incomplete)


def _named(value: str, param: click.Parameter | None) -> str:
    if not value.strip():
        raise InputError(f"{_shown(param)}: expected a name, got {value!r}")
    return value


def _at_home(value: str, param: click.Parameter | None) -> Path:
    try:
        return expanded(value)
    except InputError as error:
        raise InputError(f"{_shown(param)} {error}") from None


def _shown(param: click.Parameter | None) -> str:
    return "name" if param is None else param.opts[0] if isinstance(param, click.Option) else str(param.metavar)


def option_group(name: str, group: type, *options: Callable[[Callback], Callback]) -> Callable[[Callback], Callback]:
    """Return a decorator that adds options to a command and passes their values as one parameter.

    Args:
        name: the command's parameter.
        group: a dataclass with a field for the value of each option, which the parameter is an instance of.
        options: decorators made by `option`, in the order of the help.
    """
    names = [field.name for field in fields(group)]

    def decorate(command: Callback) -> Callback:
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
    type=FilesType(),
    multiple=True,
    metavar="PATH_OR_GLOB",
    help="Photographs to cut patches from: a file, folder or glob. May be repeated.",
)


set_option = partial(
    option,
    "--set",
    "settings",
    type=Setting(),
    multiple=True,
    metavar="dotted.key=value",
    help="Override a key of the config, for example camera.width_px=640. May be repeated.",
)


def map_options(use: str, note: str = "") -> Callable[[Callback], Callback]:
    """Return a decorator that adds --disparity and --png-scale, for the parameters ``disparity`` and ``png_scale``.

    In the help, ``use`` follows "Disparity maps", and ``note`` is a further sentence that ends in a space.
    """
    files = option(
        "--disparity",
        type=FilesType(),
        multiple=True,
        metavar="PATH_OR_GLOB",
        help=f"Disparity maps {use}, true or predicted: .pfm, .npy, 16-bit .png. {note}May be repeated.",
    )
    scale = option(
        "--png-scale",
        type=above_0(0xFFFF),
        default=KITTI_DISPARITY.steps,
        help="Levels of a 16-bit PNG for a disparity of one pixel.",
    )
    return lambda command: files(scale(command))


def listed_configs() -> list[str]:
    """Return a line on each packaged config."""
    return [f"{name:30}{summary}" for name, summary in summaries().items()]


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


def _needed(_: click.Context, __: click.Parameter, name: str | None) -> str:
    """Return the config's name; where none is given, raise `InputError` with a list of the packaged configs."""
    if name is None:
        lines = "".join(f"\n  {line}" for line in listed_configs())
        raise InputError(
            f"--config: name a YAML file, or a packaged config:{lines}\n`semisynth-gl configs NAME` prints one in full."
        )
    return name


scene_options = option_group(
    "scene",
    SceneOptions,
    option(
        "--config",
        "config_name",
        type=ConfigName(),
        callback=_needed,
        metavar="NAME_OR_PATH",
        help=f"A YAML file, or a packaged config: {', '.join(packaged_configs())}.  [required]",
    ),
    images_option(),
    option(
        "--models",
        type=FilesType(),
        multiple=True,
        metavar="DIR",
        help="Folder of 3D models to add to the built-in ones and the config's folders. May be repeated.",
    ),
    option("--seed", type=SEED, default=0, help="Seed of the dataset: another seed makes other pairs."),
    set_option(),
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
    overrides: list[str | tuple[str, Any]] = list(settings)
    # Passed as values: as YAML text, some file names would be read as numbers or dates.
    if images:
        overrides += [("textures.source", "images"), ("textures.images", list(images))]
    if models:
        folders = load_config(config_name, overrides).models.folders
        overrides.append(("models.folders", [*folders, *models]))
    return load_config(config_name, overrides)
