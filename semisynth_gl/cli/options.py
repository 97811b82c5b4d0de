"""Options that several commands share."""

from collections.abc import Callable
from typing import Any

import click

from semisynth_gl.config import Config, load_config, packaged_configs
from semisynth_gl.render.context import BACKENDS

Command = Callable[..., Any]


def scene_options(command: Command) -> Command:
    """Add --config, --seed, --images, --models, --set and --backend."""
    options = [
        click.option(
            "--config",
            "config_name",
            required=True,
            metavar="NAME_OR_PATH",
            help=f"A YAML file, or a packaged config: {', '.join(packaged_configs())}.",
        ),
        click.option(
            "--images",
            multiple=True,
            metavar="PATH_OR_GLOB",
            help="Photographs to cut patches from: a file, folder or glob. May be repeated.",
        ),
        click.option(
            "--models",
            multiple=True,
            metavar="DIR",
            help="A folder of 3D models to add to those that are built in. May be repeated.",
        ),
        click.option(
            "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Another seed, another dataset."
        ),
        click.option(
            "--set",
            "settings",
            multiple=True,
            metavar="dotted.key=value",
            help="Override a key of the config, for example camera.width_px=640. May be repeated.",
        ),
        click.option(
            "--backend",
            type=click.Choice(BACKENDS),
            default="auto",
            show_default=True,
            help="egl: a GPU, or llvmpipe; osmesa: Mesa's off-screen renderer; auto: the first that works.",
        ),
    ]
    for option in reversed(options):
        command = option(command)
    return command


def read_config(
    config_name: str, images: tuple[str, ...], models: tuple[str, ...], settings: tuple[str, ...]
) -> Config:
    """Load the config that the options describe."""
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
