"""The pictures that the program draws itself: one each of many kinds, others for each seed."""

from collections.abc import Callable, Iterator

import numpy as np

from semisynth_gl.textures import cloths, graphics, materials, nature, prints
from semisynth_gl.textures.canvas import Pixels
from semisynth_gl.textures.pictures import Picture

PICTURES = 24
"""How many kinds a dataset has pictures of; the others are for other seeds and splits."""

KINDS: tuple[Callable[[np.random.Generator], Pixels], ...] = (
    *(cloths.flowered, cloths.knitting, cloths.quilt, cloths.rug, cloths.sequins, cloths.tartan, cloths.weave),
    *(materials.bricks, materials.cobbles, materials.marble, materials.mosaic, materials.peeling),
    *(materials.stained_glass, materials.terrazzo, materials.tiles, materials.wood),
    *(nature.fields, nature.fruit, nature.leaves, nature.marbled, nature.meadow, nature.pebbles, nature.strokes),
    *(graphics.circuit, graphics.city_map, graphics.comic, graphics.confetti, graphics.screen),
    *(prints.books, prints.labels, prints.page, prints.poster, prints.stamps),
)
"""The kinds: each draws a picture of `canvas.SIDE_PX` pixels along both sides, all of it from the generator."""


def drawn_pictures(rng: np.random.Generator) -> Iterator[Picture]:
    """Draw pictures of `PICTURES` kinds in random order, named like ``drawn/tartan``."""
    for number in rng.permutation(len(KINDS))[:PICTURES]:
        kind = KINDS[int(number)]
        yield Picture(f"drawn/{kind.__name__.replace('_', '-')}", kind(rng))
