"""Painted pictures of surfaces: cloth, stone, wood, walls, fruit, farmland, sky."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from semisynth_gl.textures.canvas import (
    SIDE_PX,
    Field,
    PatternTiles,
    Pixels,
    bond,
    cells,
    direction,
    finished,
    fractal,
    grid,
    hex_colours,
    lit,
    mixed,
    palette,
    pick,
    relief,
    step,
    toned,
    veins,
)

_WOODS = hex_colours("""
3a2214 704628 9e6c42 be8e5e   60341c 965c34 c48a54 e2b47c   785c3e a88862 ccb08a e4ceac
361410 682a1c 8e422a b06242   46423e 706a62 969086 b6b0a6
""").reshape(-1, 4, 3)
_SKIES = hex_colours("3e6ea8 5a8cc4 78a4d2 94b4cc 6c7e98 a4aab2")
_CROPS = hex_colours("7e8e3e b09e54 5c7434 c6b070 806242 466232 9caa5c d6be4a")
_BRICKS = hex_colours("9e523a b26848 884234 be805c 703e38")
_STONES = hex_colours("7e746a 9a8e7e 626062")
_RUST = hex_colours("301a14 70381e a45628 c47c3e 5a3e32")


def _woven(rng: np.random.Generator, tints: NDArray[np.float64], depth: float, lean: float = 0.0) -> Pixels:
    """Paint cloth of stitches in colours (rows, columns, 3); ``depth`` makes the borders of stitches darker.

    With ``lean``, a stitch has two slanted legs, as in knitting; their ends differ by ``lean`` / 2 stitches in height.
    """
    y, x = grid()
    sway = fractal(rng, finest_px=8, persistence=0.6)
    rows, columns = tints.shape[:2]
    u, v = (x + 3 * sway) * (columns / SIDE_PX), (y + 3 * sway) * (rows / SIDE_PX)
    side = np.abs(u % 1 - 0.5)
    v = v + lean * (0.6 - side)
    inside = np.minimum(0.5 - np.abs(v % 1 - 0.5), np.minimum(side, 0.5 - side) * 2 if lean else 0.5 - side)
    yarn = np.sqrt(2 * inside) - 0.6 + 0.12 * np.sin(v * 5 + side * 26) * bool(lean)
    light = 1 + depth * yarn + 0.08 * fractal(rng, coarsest_px=8) + 0.08 * fractal(rng, finest_px=16, persistence=0.5)
    uneven = (tints * rng.normal(1, 0.06, (rows, columns, 1))).astype(np.float32)
    return finished(rng, lit(uneven[np.floor(v).astype(int) % rows, np.floor(u).astype(int) % columns], light))


def tartan(rng: np.random.Generator) -> Pixels:
    """Twill of coloured threads that cross."""
    colours = palette(rng) * [[0.45], [1], [1], [1], [1]]
    count = SIDE_PX // int(rng.integers(3, 6))

    def threads() -> NDArray[np.float64]:
        stripes = np.repeat(rng.choice(5, 12, p=[0.35, 0.25, 0.2, 0.1, 0.1]), rng.choice([1, 2, 3, 6, 10, 16], 12))
        return colours[np.resize([*stripes, *stripes[::-1]], count)]

    warp = threads()
    weft = threads() if rng.random() < 0.4 else warp
    over = np.add.outer(range(count), range(count)) % 4 < 2
    return _woven(rng, np.where(over[..., np.newaxis], warp, weft[:, np.newaxis]), 0.5)


def rug(rng: np.random.Generator) -> Pixels:
    """A knotted rug: lozenges and squares of random sizes on each other, and a border."""
    v, u = np.mgrid[:96, :96]
    pattern, edge = np.zeros((96, 96)), 95 - np.maximum(v, u)
    for number in range(26):
        down, right = np.abs(np.array([v, u]) - (rng.uniform(0, 96, (2, 1, 1)) * rng.integers(0, 2, (2, 1, 1))))
        distance = down + right if rng.random() < 0.6 else np.maximum(down, right)
        rings = (distance + 2 * ((v + u) // 3 % 2)) // rng.integers(3, 8) + number
        pattern = np.where(distance < rng.uniform(6, 70 if number < 8 else 26), rings, pattern)
    motif = (np.abs(np.minimum(v, u) % 22 - 9) + np.abs(edge - 15)) // 2.5
    pattern = np.where(edge < 26, np.where(np.isin(edge, (0, 4, 25)), 4, motif), pattern)
    return _woven(rng, palette(rng)[np.pad(pattern.astype(int) % 5, ((96, 0), (96, 0)), "symmetric")], 0.25)


def knitting(rng: np.random.Generator) -> Pixels:
    """Stitches in rows, with bands of ornament."""
    columns = int(rng.integers(33, 54))
    bands = list[NDArray[np.integer]]()
    while sum(map(len, bands)) < 1.25 * columns:
        motif = rng.random((int(rng.integers(2, 13)), int(rng.integers(4, 15)))) < 0.45 * (rng.random() < 0.7)
        repeated = np.tile(motif | motif[:, ::-1], columns)[:, :columns]
        # Change some stitches, so that no two parts of the picture look alike.
        repeated ^= rng.random(repeated.shape) < 0.25 * np.abs(np.sin(rng.uniform(0, 7) + np.arange(columns) / 8))
        bands.append(np.where(repeated, *rng.permutation(5)[:2].tolist()))
    return _woven(rng, palette(rng)[np.concatenate(bands)], 1.1, lean=1.5)


def _paved(
    rng: np.random.Generator, tiled: PatternTiles, image: Field, dome: Field, gap: ArrayLike, rough: float
) -> Field:
    """Return tiles, (H, W, 3), with relief of height ``dome``, (H, W) px, and joints of the colour ``gap``."""
    grit = rough * fractal(rng, coarsest_px=64, persistence=1.0)
    light = relief(dome + grit, 0.3) * (1 + 0.3 * grit) * tiled.uniform(rng, 0.8, 1.2)
    return mixed(lit(gap, 1 + 0.18 * fractal(rng, coarsest_px=16)), lit(image, light), step(tiled.border, 1.5))


def cobbles(rng: np.random.Generator) -> Pixels:
    """Round stones in mortar, lit from the side."""
    size = int(rng.integers(44, 110))
    stones = cells(rng, size, 0.8)
    stones = stones._replace(border=stones.border - 0.05 * size + 1.2 * fractal(rng, coarsest_px=64, persistence=0.8))
    dome = np.asarray(np.sqrt(np.maximum(stones.border, 0)), np.float32)
    image = lit(stones.one_of(rng, [*_STONES, *(0.4 * palette(rng) + 70)]), 0.55 + 0.45 * step(dome, 3))
    return finished(rng, _paved(rng, stones, image, 2.4 * dome, (100, 90, 78), 0.5))


def bricks(rng: np.random.Generator) -> Pixels:
    """A wall of bricks, with paint sprayed over it."""
    high, rough = int(rng.integers(46, 76)), fractal(rng, coarsest_px=32, persistence=1.0)
    wall = bond(high, 2.6 * high, fractal(rng, coarsest_px=64, persistence=0.8), 0.5)
    image = wall.one_of(rng, _BRICKS)
    for ink in palette(rng)[: int(rng.integers(1, 5))]:
        blot = fractal(rng, coarsest_px=512, finest_px=4, persistence=0.55) - rng.uniform(0.5, 1.1)
        image = mixed(image, ink, 0.85 * step(blot, 0.08) * step(rough + 1.7, 0.3))
    wall = wall._replace(border=wall.border - 4)
    return finished(rng, _paved(rng, wall, image, step(wall.border, 4), (182, 174, 162), 0.4))


def tiles(rng: np.random.Generator) -> Pixels:
    """Glazed tiles with different ornaments, some with cracks and stains."""
    size = int(rng.choice([128, 171, 205]))
    floor, (paper, *inks) = bond(size, size), palette(rng)
    v, u = floor.down / np.float32(size), floor.right / np.float32(size)
    flower = np.hypot(u, v) - 0.3 - 0.1 * np.cos(floor.one_of(rng, (4, 6, 8, 12)) * direction(v, u))
    star = np.abs(u) + np.abs(v) - floor.one_of(rng, (0.16, 0.22, 0.3))
    corner = np.hypot(np.abs(u) - 0.5, np.abs(v) - 0.5) - 0.2
    image = lit(0.15 * paper + 205, np.ones_like(u))
    for outline in (flower, star, corner, np.abs(flower) - 0.022, np.abs(corner) - 0.018):
        image = mixed(image, floor.one_of(rng, inks), step(-outline, 1.2 / size))
    image = mixed(image, (112, 100, 84), 0.3 * veins(rng, 40, 64))
    image = mixed(image, (178, 140, 108), step(fractal(rng, coarsest_px=128) - 1.5, 0.1))
    floor = floor._replace(border=floor.border - 2)
    return finished(rng, _paved(rng, floor, image, step(floor.border, 6), (120, 112, 102), 0.1))


def terrazzo(rng: np.random.Generator) -> Pixels:
    """Chips of stone of many sizes and colours in cement."""
    colours, image = palette(rng), lit((206, 200, 190), 1 + 0.1 * fractal(rng, coarsest_px=32))
    for size in (26, 64, 128):
        chips, ragged = cells(rng, size), 0.04 * fractal(rng, coarsest_px=16, persistence=0.7)
        stone = lit(chips.one_of(rng, colours), chips.uniform(rng, 0.75, 1.2) + 0.1 * fractal(rng, coarsest_px=32))
        inside = chips.border + size * (ragged - chips.uniform(rng, 0.08, 0.3))
        image = mixed(image, stone, step(inside) * (chips.uniform(rng, 0, 1) < 0.5))
    return finished(rng, image, grain=6)


def wood(rng: np.random.Generator) -> Pixels:
    """Planks with growth rings, fibres, knots and gaps."""
    y, x = grid()
    planks = bond(int(rng.integers(150, 330)), 900, rng.uniform(0, 300), 0.5)
    sway = fractal(rng, coarsest_px=64, finest_px=4, persistence=0.5, stretch=8)
    fibres = fractal(rng, coarsest_px=16, persistence=1.0, stretch=16)
    across = y + 34 * sway + planks.uniform(rng, 0, 4000)
    for row, column, radius in rng.uniform((0, 0, 8), (SIDE_PX, SIDE_PX, 26), (int(rng.integers(3, 8)), 3)):
        across += 65 * np.exp(-(np.square(y - row) + np.square((x - column) / 3.2)) / (2 * radius**2))
    rings = 3 * np.abs(across / rng.uniform(18, 44) % 1 - 0.35) - 0.6
    image = lit(toned(rings + 0.4 * fibres + 0.4 * sway, pick(rng, _WOODS)), planks.uniform(rng, 0.85, 1.15))
    image = mixed(image, (22, 14, 10), 0.9 * step(2.5 - planks.border, 1.5))
    return finished(rng, image.swapaxes(0, int(rng.integers(2))), grain=6)


def marble(rng: np.random.Generator) -> Pixels:
    """Polished stone with clouds and veins."""
    colours, cloud = palette(rng), fractal(rng, persistence=0.8)
    pale = 0.35 * colours[0] + 150 if rng.random() < 0.6 else 0.55 * colours[0] + 12
    image = toned(cloud, [0.6 * pale, 0.9 * pale, 0.8 * pale + 0.2 * colours[1], np.minimum(1.15 * pale, 250)])
    for side, ink in zip((1, -1, 1, -1), ((250, 248, 240), *(0.55 * colours[2:] + 10)), strict=True):
        vein = veins(rng, rng.uniform(10, 34), persistence=rng.uniform(0.5, 0.62))
        image = mixed(image, ink, 0.85 * vein * step(side * cloud + 1.2, 1.5))
    return finished(rng, image)


def peeling(rng: np.random.Generator) -> Pixels:
    """Coats of old paint that peel off rust."""
    image = toned(fractal(rng, persistence=1.0), _RUST)
    for coat in palette(rng)[:4]:
        edge = fractal(rng, persistence=0.78) - rng.uniform(-0.35, 0.35)
        paint = lit(coat, 1 + 0.06 * fractal(rng, coarsest_px=64))
        image = mixed(lit(image, 1 - 0.45 * np.exp(-np.square(edge) * 60)), paint, step(edge, 0.05))
        image = lit(image, relief(2 * step(edge, 0.12), 0.22))
    streaks = fractal(rng, coarsest_px=32, stretch=12).T
    return finished(rng, mixed(image, (92, 48, 26), 0.5 * step(streaks - 1.1, 0.8)), grain=6)


def painted(rng: np.random.Generator) -> Pixels:
    """A painted wall of one colour or of two, one above the other, with scuffs and the grain of a roller."""
    y, x = grid()
    upper, lower, ink = palette(rng)[:3] * rng.uniform(0.08, 0.4, (3, 1))
    edge = rng.uniform(0.3, 2) * SIDE_PX + 3 * fractal(rng, coarsest_px=64)
    image = mixed(upper + 170, lower + 170, step(y - edge, 3))
    for row, column, turn in rng.uniform(0, (SIDE_PX, SIDE_PX, np.pi), (int(rng.integers(2, 7)), 3)):
        across = np.abs((y - row) * np.cos(turn) - (x - column) * np.sin(turn))
        image = mixed(image, ink, 0.25 * step(3 - across, 2) * step(120 - np.hypot(y - row, x - column), 40))
    return finished(rng, lit(image, relief(fractal(rng, coarsest_px=8), 0.012)), grain=1.5, light=0.12)


def plaster(rng: np.random.Generator) -> Pixels:
    """Plaster in pale colours, with strokes of a trowel, stains and hairline cracks."""
    pale, strokes = 0.25 * palette(rng)[0] + 154, fractal(rng, coarsest_px=64, persistence=0.8, stretch=4).T
    image = mixed(lit(pale, 1 + 0.03 * strokes), 0.8 * pale, 0.3 * step(fractal(rng, persistence=0.7) - 1, 0.6))
    cracks = step(veins(rng, 34) - 0.3, 0.5) * step(fractal(rng, finest_px=16) - 0.6, 0.5)
    image = mixed(image, 0.55 * pale, 0.6 * cracks)
    rough = relief(0.5 * strokes + 0.2 * fractal(rng, coarsest_px=16), 0.06)
    return finished(rng, lit(image, rough), grain=2, light=0.1)


def sky(rng: np.random.Generator) -> Pixels:
    """A sky that is paler below, with or without clouds."""
    zenith = pick(rng, _SKIES)
    image = mixed(zenith, 0.3 * zenith + 163, (grid()[0] / SIDE_PX) ** rng.uniform(0.7, 2))
    clouds = fractal(rng, coarsest_px=512, persistence=rng.uniform(0.5, 0.6)) - rng.uniform(-0.3, 2)
    shade = 0.85 + 0.12 * step(fractal(rng, coarsest_px=128, persistence=0.6) + 1, 2)
    return finished(rng, mixed(image, lit((244, 244, 246), shade), step(clouds, 1.2)), grain=1.5, light=0.03)


def fields(rng: np.random.Generator) -> Pixels:
    """Farmland from above: crops in rows, hedges, paths, water, trees."""
    y, x = grid()
    farm, trees = cells(rng, int(rng.integers(130, 230)), 1.0), cells(rng, 24, 1.0)
    rough, flow = fractal(rng), fractal(rng, coarsest_px=512, finest_px=4, persistence=0.5)
    angle, period = farm.uniform(rng, 0, np.pi), farm.uniform(rng, 5, 16)
    rows = np.sin((x * np.cos(angle) + y * np.sin(angle) + 2 * rough) * (2 * np.pi / period))
    light = farm.uniform(rng, 0.8, 1.15) + farm.uniform(rng, 0.03, 0.2) * rows + 0.12 * rough
    image = lit(farm.one_of(rng, _CROPS), light)
    image = mixed(image, lit((50, 74, 34), 1 + 0.35 * fractal(rng, coarsest_px=8)), step(4 + 2.5 * rough - farm.border))
    image = mixed(image, (206, 192, 166), step(2.2 - np.abs(farm.border - 8)) * (farm.uniform(rng, 0, 1) < 0.33))
    image = mixed(image, (58, 86, 96), step(0.05 - np.abs(flow), 0.02))
    crown = np.sqrt(np.clip(trees.border - 1, 0, None))
    mask = step(crown) * np.maximum(
        (trees.uniform(rng, 0, 1) < 0.05), (trees.uniform(rng, 0, 1) < 0.8) * step(flow - 0.9, 0.01)
    )
    canopy = lit(toned(rough, [(30, 52, 26), (58, 86, 40), (96, 118, 56)]), relief(2 * crown + 0.4 * rough, 0.3))
    return finished(rng, mixed(lit(image, 1 - 0.4 * np.roll(mask, (5, 5), (0, 1))), canopy, mask))


def fruit(rng: np.random.Generator) -> Pixels:
    """A heap of fruit, sweets or beads, each a lit ball."""
    colours, image = palette(rng), lit((24, 24, 24), np.ones((SIDE_PX, SIDE_PX)))
    size, speckle = rng.uniform(60, 140), fractal(rng, coarsest_px=32)
    for _ in range(4):
        heap = cells(rng, size)
        radius = size * heap.uniform(rng, 0.3, 0.6)
        v, u = heap.down / radius, heap.right / radius
        far = v * v + u * u
        blush = step(u * heap.uniform(rng, -1, 1) + v * heap.uniform(rng, -1, 1) + 0.3 * speckle, 0.9)
        swirl = step(np.sin(5 * direction(v, u) + 10 * np.sqrt(far)) - 0.3, 0.3) * (heap.uniform(rng, 0, 1) < 0.33)
        ball = mixed(mixed(heap.one_of(rng, colours), heap.one_of(rng, colours), 0.35 * blush), (244, 240, 232), swirl)
        level = 0.75 * np.sqrt(np.clip(1 - far, 0, 1)) - 0.4 * v - 0.35 * u
        ball = lit(ball, 0.32 + 0.8 * np.clip(level, 0, 1) + 0.06 * speckle)
        ball = mixed(ball, (255, 252, 244), 0.75 * step(0.05 - np.square(u + 0.36) - np.square(v + 0.42), 0.05))
        image = mixed(lit(image, 1 - 0.6 * step(1.35 - far, 0.5)), ball, step((1 - np.sqrt(far)) * radius, 1.2))
    return finished(rng, image)
