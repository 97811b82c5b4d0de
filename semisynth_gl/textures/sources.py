"""The sources of patches that a config may name: the program's own and plug-ins."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Literal

import numpy as np

from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.plugins import find_plugin
from semisynth_gl.textures import prints, surfaces
from semisynth_gl.textures.canvas import PaintedPicture, Pixels
from semisynth_gl.textures.image_files import builtin_licences, builtin_photographs, find_images

# Maximum number of pictures of a plug-in, which may yield pictures for ever, none of them good enough for a patch.
_MOST_PICTURES = 10_000

PLAIN: tuple[Callable[[np.random.Generator], Pixels], ...] = (surfaces.painted, surfaces.plaster, surfaces.sky)
"""The kinds with little contrast."""

KINDS: tuple[Callable[[np.random.Generator], Pixels], ...] = (
    *(surfaces.bricks, surfaces.cobbles, surfaces.fields, surfaces.fruit, surfaces.knitting, surfaces.marble),
    *(surfaces.peeling, surfaces.rug, surfaces.tartan, surfaces.terrazzo, surfaces.tiles, surfaces.wood),
    *(prints.books, prints.city_map, prints.flowered, prints.labels, prints.leaves, prints.meadow),
    *(prints.page, prints.poster, prints.screen, *PLAIN),
)
"""The kinds of pictures: each function paints a picture, (`SIDE_PX`, `SIDE_PX`, 3) uint8, given only a generator."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TextureSource:
    """A source of patches.

    Attributes:
        files: returns the files from which patches are cut, sorted; empty for a source without files. Raises
            `InputError` where files are missing.
        pictures: paints the pictures from which patches are cut, one at a time, until there are enough patches. None
            for a source that paints nothing.
        licences: returns the licences of its files by file name; empty if unknown.
        licence: licence of all other images: the config's ``licences.images``, this program's own, or none stated.
    """

    files: Callable[[TexturesSection], Sequence[Path]] = lambda _: ()
    pictures: Callable[[np.random.Generator], Iterable[PaintedPicture]] | None = None
    licences: Callable[[], Mapping[str, str]] = dict
    licence: Literal["config", "own", "none"] = "config"


def painted_pictures(rng: np.random.Generator) -> Iterator[PaintedPicture]:
    """Paint a picture of each kind, in random order, named like ``drawn/tartan``."""
    for number in rng.permutation(len(KINDS)):
        kind = KINDS[int(number)]
        yield PaintedPicture(f"drawn/{kind.__name__.replace('_', '-')}", kind(rng))


def _of_the_user(section: TexturesSection) -> Sequence[Path]:
    if not section.images:
        raise InputError("textures.source is images, but textures.images is empty: set it to your photographs")
    try:
        return find_images(section.images)
    except InputError as error:
        raise InputError(f"textures.images: {error}") from None


_PACKAGED = TextureSource(
    files=lambda _: builtin_photographs(), pictures=painted_pictures, licences=builtin_licences, licence="own"
)

SOURCES: dict[str, TextureSource] = {
    "images": TextureSource(files=_of_the_user),
    "builtin": _PACKAGED,
    "photographs": replace(_PACKAGED, pictures=None),
    "procedural": TextureSource(licence="none"),
}
"""The program's own sources, by their names in a config."""


def describe_source(name: str) -> TextureSource:
    """Return a source by its name in a config, or an empty source for a plug-in's name: no plug-in is imported."""
    return SOURCES.get(name, TextureSource())


def open_source(name: str) -> TextureSource:
    """Return a source by its name in a config; raises InputError if there is no such source."""
    if name in SOURCES:
        return SOURCES[name]
    return TextureSource(pictures=partial(_plugin_pictures, name, find_plugin("textures", name).value))


def _plugin_pictures(
    name: str, paint: Callable[[np.random.Generator], Iterable[Pixels]], rng: np.random.Generator
) -> Iterator[PaintedPicture]:
    """Yield the pictures of a plug-in, one at a time, with names such as ``prints/00003``."""
    for number, pixels in enumerate(islice(paint(rng), _MOST_PICTURES)):
        # A copy: the plug-in may paint the next picture into the same array.
        yield PaintedPicture(f"{name}/{number:05d}", np.array(pixels, order="C"))
