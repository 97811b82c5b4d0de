"""Texture sources of plug-ins: a function from a generator to pictures each."""

from collections.abc import Iterator
from itertools import count
from typing import Any

import numpy as np

from semisynth_gl.inputs.errors import InputError
from semisynth_gl.plugins import Plugin, find_plugin, refuse_clash
from semisynth_gl.textures.pictures import Picture

_FUNCTION = "a function from a numpy.random.Generator to pictures, arrays (H, W, 3) of uint8"
# A source may yield pictures without end, and none of them with a patch that can be used.
_MOST_PICTURES = 10_000


def find_source(name: str, built_in: tuple[str, ...]) -> Plugin | None:
    """Return the plug-in of a texture source; None for one of the program's own.

    Args:
        name: the source's name.
        built_in: the names of the program's own.

    Raises:
        InputError: where there is no such source, the plug-in cannot be imported or is no function, or where one has a
            name of the program's own.
    """
    if name in built_in:
        refuse_clash("textures", name)
        return None
    plugin = find_plugin("textures", name, built_in)
    if not callable(plugin.value):
        raise plugin.fault(f"expected {_FUNCTION}, got {type(plugin.value).__name__}")
    return plugin


def plugin_pictures(plugin: Plugin, rng: np.random.Generator) -> Iterator[Picture]:
    """Yield the pictures of a plug-in, one at a time, named like ``prints/00003``.

    Args:
        plugin: as `find_source` returns it.
        rng: source of every random choice.

    Raises:
        InputError: where the plug-in fails, or yields anything but pictures.
    """
    with plugin.blamed("fails"):
        drawn: Any = plugin.value(rng)
        if isinstance(drawn, np.ndarray) or not hasattr(drawn, "__iter__"):
            raise InputError(f"expected {_FUNCTION}, got {type(drawn).__name__}")
        pictures = iter(drawn)
    for number in count():
        if number == _MOST_PICTURES:
            return
        with plugin.blamed(f"fails at picture {number}"):
            try:
                pixels = next(pictures)
            except StopIteration:
                return
            # A copy: the plug-in may draw the next picture into the same array.
            picture = Picture(f"{plugin.name}/{number:05d}", np.array(pixels, order="C"))
        yield picture
