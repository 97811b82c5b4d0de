"""The pictures that the program paints itself: one of each kind, different for each seed."""

from collections.abc import Callable, Iterator

import numpy as np

from semisynth_gl.textures import prints, surfaces
from semisynth_gl.textures.canvas import Pixels
from semisynth_gl.textures.pictures import PaintedPicture

PLAIN: tuple[Callable[[np.random.Generator], Pixels], ...] = (surfaces.painted, surfaces.plaster, surfaces.sky)
"""The kinds with little contrast."""

KINDS: tuple[Callable[[np.random.Generator], Pixels], ...] = (
    *(surfaces.bricks, surfaces.cobbles, surfaces.fields, surfaces.fruit, surfaces.knitting, surfaces.marble),
    *(surfaces.peeling, surfaces.rug, surfaces.tartan, surfaces.terrazzo, surfaces.tiles, surfaces.wood),
    *(prints.books, prints.city_map, prints.flowered, prints.labels, prints.leaves, prints.meadow),
    *(prints.page, prints.poster, prints.screen, *PLAIN),
)
"""The kinds of pictures: each function paints a picture, (`SIDE_PX`, `SIDE_PX`, 3) uint8, given only a generator."""


def drawn_pictures(rng: np.random.Generator) -> Iterator[PaintedPicture]:
    """Paint a picture of each kind, in random order, named like ``drawn/tartan``."""
    for number in rng.permutation(len(KINDS)):
        kind = KINDS[int(number)]
        yield PaintedPicture(f"drawn/{kind.__name__.replace('_', '-')}", kind(rng))
