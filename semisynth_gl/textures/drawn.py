"""The pictures that the program draws itself: one of each kind, different for each seed."""

from collections.abc import Callable, Iterator

import numpy as np

from semisynth_gl.textures import cloths, materials, nature, prints
from semisynth_gl.textures.canvas import Pixels
from semisynth_gl.textures.pictures import Picture

PLAIN: tuple[Callable[[np.random.Generator], Pixels], ...] = (materials.painted, materials.plaster, nature.sky)
"""The kinds with little contrast."""

KINDS: tuple[Callable[[np.random.Generator], Pixels], ...] = (
    *(cloths.flowered, cloths.knitting, cloths.rug, cloths.tartan),
    *(materials.bricks, materials.cobbles, materials.marble, materials.peeling),
    *(materials.terrazzo, materials.tiles, materials.wood),
    *(nature.fields, nature.fruit, nature.leaves, nature.meadow),
    *(prints.city_map, prints.screen),
    *(prints.books, prints.labels, prints.page, prints.poster),
    *PLAIN,
)
"""The kinds of pictures: each function draws one, (`SIDE_PX`, `SIDE_PX`, 3) uint8, with no input but the generator."""


def drawn_pictures(rng: np.random.Generator) -> Iterator[Picture]:
    """Draw a picture of each kind, in random order, named like ``drawn/tartan``."""
    for number in rng.permutation(len(KINDS)):
        kind = KINDS[int(number)]
        yield Picture(f"drawn/{kind.__name__.replace('_', '-')}", kind(rng))
