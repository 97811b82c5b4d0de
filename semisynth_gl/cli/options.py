"""Options that several commands share."""

from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import Any

import click

from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.config import Config, load_config, packaged_configs
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.render import BACKENDS

Callback = Callable[..., Any]

option = partial(click.option, show_default=True)


def options(*decorators: Callable[[Callback], Callback]) -> Callable[[Callback], Callback]:
    """Return a decorator that adds options to a command, whose help lists them in this order."""
    return lambda command: reduce(lambda below, decorate: decorate(below), reversed(decorators), command)


_MOST = 10_000_000
NATURAL = click.IntRange(min=0, max=_MOST)
COUNT = click.IntRange(min=1, max=_MOST)
MOST_WORKERS = 1024
# Datasets have the seed in JSON, and readers in other languages may hold whole numbers in 64 bits.
_SEED = click.IntRange(min=0, max=(1 << 63) - 1)


class Command(click.Command):
    """A command that names an option where an error of the library names an argument."""

    def invoke(self, ctx: click.Context) -> Any:  # noqa: ANN401 - click's signature
        """Run the command."""
        try:
            return super().invoke(ctx)
        except InputError as error:
            options = {each.name: max(each.opts, key=len) for each in self.params if isinstance(each, click.Option)}
            error.argument = options.get(error.argument, error.argument)
            raise


def split(item: Any) -> Callable[..., tuple[Any, ...] | None]:  # noqa: ANN401 - a type of click's
    """Return a callback that converts an option's text, such as "a,b", to a tuple of values of a type of click's."""

    def convert(ctx: click.Context, param: click.Parameter, text: str | None) -> tuple[Any, ...] | None:
        return None if text is None else tuple(item.convert(each.strip(), param, ctx) for each in text.split(","))

    return convert


images_option = partial(
    option,
    "--images",
    multiple=True,
    metavar="PATH_OR_GLOB",
    help="Photographs to cut patches from: a file, folder or glob. May be repeated.",
)

run_options = options(
    option("--seed", type=_SEED, default=0, help="Seed of the pairs; each seed makes different pairs."),
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

map_options = options(
    option(
        "--disparity",
        multiple=True,
        metavar="PATH_OR_GLOB",
        help="Disparity maps, true or predicted, of the place where the network will work: .pfm, .npy, 16-bit .png. If "
        "a map is not as wide as the images, its disparities are scaled by the ratio of the widths. May be repeated.",
    ),
    option(
        "--png-scale",
        type=click.FloatRange(min=0, min_open=True, max=0xFFFF),
        default=KITTI_DISPARITY.steps,
        help="Levels per pixel of disparity in a 16-bit PNG.",
    ),
)


scene_options = options(
    option(
        "--config",
        "config_name",
        type=click.Path(),
        required=True,
        metavar="NAME_OR_PATH",
        help=f"A YAML file, or a packaged config: {', '.join(packaged_configs())}.",
    ),
    images_option(),
    option(
        "--models",
        multiple=True,
        metavar="DIR",
        help="Folder of 3D models to add to the built-in ones and the config's folders. May be repeated.",
    ),
    run_options,
)


def scene_config(
    config_name: str, images: Sequence[str], models: Sequence[str], settings: Sequence[str], *further: str
) -> Config:
    """Load the config that `scene_options` describe, with further settings."""
    overrides: list[str | tuple[str, Any]] = [*settings, *further]
    # Pass values instead of YAML text, in which some file names would be numbers or dates.
    if images:
        overrides += [("textures.source", "images"), ("textures.images", list(images))]
    if models:
        folders = load_config(config_name, overrides).models.folders
        overrides.append(("models.folders", [*folders, *models]))
    return load_config(config_name, overrides)
