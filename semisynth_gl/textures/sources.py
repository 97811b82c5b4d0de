"""The sources that a config may take its patches from, and all that differs between them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

from semisynth_gl.config.scene_sections import TEXTURE_SOURCES, TexturesSection
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.plugins import Plugin
from semisynth_gl.textures.drawn import drawn_pictures
from semisynth_gl.textures.foreign import find_source, plugin_pictures
from semisynth_gl.textures.image_files import builtin_licences, builtin_photographs, find_images
from semisynth_gl.textures.pictures import PictureSource


@dataclass(frozen=True, slots=True, kw_only=True)
class TextureSource:
    """A source of patches.

    Attributes:
        noun: what patches are cut from, as a card of a dataset calls it.
        patches: what its patches are.
        files: returns the files that patches are cut from, sorted; raises `InputError` without any.
        pictures: draws the pictures that patches are cut from, or None.
        licences: returns the licences of its files by their names.
        licence: the licence of all else: the config's, this program's, or none.
        plugin: the plug-in that it is of.
    """

    noun: Literal["photograph", "picture", "pattern"]
    patches: str
    files: Callable[[TexturesSection], Sequence[Path]] = lambda _: ()
    pictures: PictureSource | None = None
    licences: Callable[[], Mapping[str, str]] = dict
    licence: Literal["config", "own", "none"] = "config"
    plugin: Plugin | None = None


def _of_the_user(section: TexturesSection) -> Sequence[Path]:
    if not section.images:
        raise InputError("textures.source is images, but there are none: name them in `textures.images`")
    return find_images(section.images)


def _packaged(_: TexturesSection) -> Sequence[Path]:
    return sorted(builtin_photographs(), key=Path.as_posix)


SOURCES: dict[str, TextureSource] = {
    "images": TextureSource(noun="photograph", patches="patches of photographs", files=_of_the_user),
    "builtin": TextureSource(
        noun="picture",
        patches="patches of drawn pictures and photographs",
        files=_packaged,
        pictures=drawn_pictures,
        licences=builtin_licences,
        licence="own",
    ),
    "photographs": TextureSource(
        noun="photograph", patches="patches of photographs", files=_packaged, licences=builtin_licences
    ),
    "procedural": TextureSource(noun="pattern", patches="procedural patterns", licence="none"),
}
"""The sources of the program itself, by their names in a config."""

_OF_PLUGIN = TextureSource(noun="picture", patches="patches of pictures")


def describe_source(name: str) -> TextureSource:
    """Return a source by its name in a config; that of a plug-in is not imported, and draws nothing."""
    return SOURCES.get(name, _OF_PLUGIN)


def open_source(name: str) -> TextureSource:
    """Return a source by its name in a config.

    Raises:
        InputError: where no source has the name, or a plug-in cannot be used.
    """
    plugin = find_source(name, TEXTURE_SOURCES)
    if plugin is None:
        return SOURCES[name]
    return replace(_OF_PLUGIN, pictures=partial(plugin_pictures, plugin), plugin=plugin)
