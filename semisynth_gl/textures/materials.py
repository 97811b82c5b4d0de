"""Drawn pictures of materials: wood, stone, tiles, paint, plaster."""

import numpy as np

from semisynth_gl.textures.canvas import (
    SIDE_PX,
    Pixels,
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
    resized,
    step,
    toned,
)

_WOODS = hex_colours("""
3a2214 704628 9e6c42 be8e5e   60341c 965c34 c48a54 e2b47c   785c3e a88862 ccb08a e4ceac
361410 682a1c 8e422a b06242   46423e 706a62 969086 b6b0a6
""").reshape(-1, 4, 3)


def wood(rng: np.random.Generator) -> Pixels:
    """Planks with growth rings, fibres, knots and gaps."""
    y, x = grid()
    width = int(rng.integers(150, 330))
    plank = ((x + rng.uniform(0, width)) // width).astype(np.int32)
    shift = rng.uniform(0, 4000, 12)[plank].astype(np.float32)
    # Fields of a few rows are stretched along the fibres.
    sway = resized(fractal(rng, (96, SIDE_PX), coarsest_px=64, finest_px=4, persistence=0.5), (SIDE_PX, SIDE_PX))
    fibres = resized(fractal(rng, (48, SIDE_PX), coarsest_px=16, persistence=1.0), (SIDE_PX, SIDE_PX))
    across = x + 34 * sway + shift
    for _ in range(int(rng.integers(3, 8))):
        cy, cx, radius = rng.uniform(0, SIDE_PX), rng.uniform(0, SIDE_PX), rng.uniform(8, 26)
        near = np.exp(-(np.square((y - cy) / 3.2) + np.square(x - cx)) / (radius**2 * 2))
        across += near * rng.uniform(40, 90)
    turns = across * (1 / rng.uniform(18, 44))
    rings = 2 * np.abs(turns - np.floor(turns) - 0.35) - 0.4
    field = 1.5 * rings + 0.4 * fibres + 0.4 * sway
    image = toned(field, pick(rng, _WOODS))
    image = lit(image, rng.uniform(0.78, 1.18, (12, 3)).mean(axis=1)[plank].astype(np.float32))
    gap = np.abs((x + 0.5) % width - width / 2)
    ends = np.abs((y + rng.uniform(0, 900, 12)[plank]) % 900 - 450).astype(np.float32)
    seam = np.maximum(step(2.5 - np.abs(gap - gap.min()), 1.5), step(2.5 - ends, 1.5))
    return finished(rng, mixed(image, (22, 14, 10), 0.9 * seam), grain=6)


def marble(rng: np.random.Generator) -> Pixels:
    """Polished stone with clouds and veins."""
    colours = palette(rng)
    base = pick(rng, colours)
    pale = 0.35 * base + 0.65 * np.array([232, 228, 220]) if rng.random() < 0.6 else 0.55 * base + 12
    cloud = fractal(rng, persistence=0.8)
    image = toned(cloud, [0.6 * pale, 0.9 * pale, 0.8 * pale + 0.2 * pick(rng, colours), np.minimum(1.15 * pale, 250)])
    for number, ink in enumerate(rng.permutation(colours)[:4]):
        ridge = np.abs(fractal(rng, coarsest_px=256, persistence=rng.uniform(0.5, 0.62)) + 0.15 * cloud)
        vein = np.exp(-ridge * rng.uniform(10, 34)) * step(cloud * (1 - 2 * (number % 2)) + 1.2, 1.5)
        image = mixed(image, 0.55 * ink + 10 if number else (250, 248, 240), 0.85 * vein)
    return finished(rng, image, grain=5)


def terrazzo(rng: np.random.Generator) -> Pixels:
    """Chips of stone of many sizes and colours in cement."""
    colours = palette(rng)
    image = toned(fractal(rng, coarsest_px=32), [[176, 168, 158], [206, 200, 190], [232, 228, 220]])
    for size, share in ((26, 0.5), (64, 0.5), (128, 0.45)):
        number, border, points = cells(rng, size)
        shown = rng.random(len(points)) < share
        shrink = rng.uniform(0.08, 0.3, len(points)).astype(np.float32) * size
        ragged = border - shrink[number] + 0.04 * size * fractal(rng, coarsest_px=16, persistence=0.7)
        mask = step(ragged) * shown[number]
        tints = np.array([pick(rng, colours) * rng.uniform(0.75, 1.2) for _ in points], np.float32)
        chips = lit(tints[number], 1 + 0.12 * fractal(rng, coarsest_px=32))
        image = mixed(image, chips, mask)
    return finished(rng, image, grain=6)


def cobbles(rng: np.random.Generator) -> Pixels:
    """Round stones in mortar, lit from the side."""
    size = int(rng.integers(44, 110))
    number, border, points = cells(rng, size, 0.8)
    sway = fractal(rng, coarsest_px=64, persistence=0.8)
    dome = np.sqrt(np.clip(border - 0.05 * size + 1.2 * sway, 0, None))
    colours = palette(rng)
    stones = np.array([[126, 116, 106], [154, 142, 126], [98, 96, 98], *(0.4 * colours + 70)])
    tints = stones[rng.integers(0, len(stones), len(points))] * rng.uniform(0.75, 1.25, (len(points), 1))
    rough = fractal(rng, coarsest_px=64, persistence=1.0)
    image = lit(tints.astype(np.float32)[number], 1 + 0.16 * rough)
    image *= lit(relief(2.2 * dome + 0.5 * rough, 0.3), 0.55 + 0.45 * step(dome, 3))
    mortar = toned(fractal(rng, coarsest_px=16), [[66, 58, 50], [104, 94, 82], [134, 124, 110]])
    return finished(rng, mixed(mortar, image, step(dome)), grain=5)


def bricks(rng: np.random.Generator) -> Pixels:
    """A wall of bricks, with paint sprayed over it."""
    y, x = grid()
    height = int(rng.integers(46, 76))
    width = round(2.6 * height)
    sway = fractal(rng, coarsest_px=64, persistence=0.8)
    row = np.floor((y + sway) / height).astype(np.int32)
    along = x + sway + 0.5 * width * (row % 2)
    number = row * 64 + np.floor(along / width).astype(np.int32)
    up, left = (y + sway) % height, along % width
    inside = np.minimum(np.minimum(up, height - up), np.minimum(left, width - left))
    base = np.array([[158, 82, 58], [178, 104, 72], [136, 66, 52], [190, 128, 92], [112, 62, 56]])
    tints = base[rng.integers(0, 5, 4096)] * rng.uniform(0.8, 1.2, (4096, 1))
    rough = fractal(rng, coarsest_px=32, persistence=1.0)
    image = lit(tints.astype(np.float32)[number % 4096], 1 + 0.15 * rough)
    for ink in palette(rng)[: int(rng.integers(1, 5))]:
        blot = fractal(rng, coarsest_px=512, finest_px=4, persistence=0.55)
        worn = step(blot - rng.uniform(0.5, 1.1), 0.08) * step(rough + 1.7, 0.3)
        image = mixed(image, ink * rng.uniform(0.9, 1.1), 0.85 * worn) * relief(rough, 0.02)
    mortar = toned(fractal(rng, coarsest_px=16), [[150, 142, 132], [182, 174, 162], [206, 200, 190]])
    edge = step(inside - 4, 2)
    return finished(rng, mixed(mortar, image, edge) * relief(3 * step(inside - 3, 4) + 0.4 * rough, 0.16), grain=5)


def peeling(rng: np.random.Generator) -> Pixels:
    """Coats of old paint that peel off rust."""
    rust = [[48, 26, 20], [112, 56, 30], [164, 86, 40], [196, 124, 62], [90, 62, 50]]
    image = toned(fractal(rng, persistence=1.0), rust)
    for coat in palette(rng)[:4]:
        edge = fractal(rng, coarsest_px=256, persistence=0.78) - rng.uniform(-0.35, 0.35)
        mask = step(edge, 0.05)
        rim = np.exp(-np.square(edge) * 60)
        paint = lit(coat, 1 + 0.06 * fractal(rng, coarsest_px=64))
        image = mixed(lit(image, 1 - 0.45 * rim), paint, mask) * relief(2 * step(edge, 0.12), 0.22)
    streaks = resized(fractal(rng, (64, SIDE_PX), coarsest_px=32), (SIDE_PX, SIDE_PX))
    return finished(rng, mixed(image, (92, 48, 26), 0.5 * step(streaks - 1.1, 0.8)), grain=6)


def tiles(rng: np.random.Generator) -> Pixels:
    """Painted tiles with different ornaments."""
    size = int(rng.choice([128, 171, 205]))
    y, x = grid()
    row, column = (np.floor(at / size).astype(np.int32) for at in (y, x))
    v, u = ((at % size) / np.float32(size) - 0.5 for at in (y, x))
    number = row * 16 + column
    colours = palette(rng)
    colours[0] = 0.15 * colours[0] + 0.85 * np.array([240, 236, 226])
    radius, angle = np.hypot(u, v), direction(v, u)
    one, two, three = (rng.permutation(np.arange(256) % kinds) for kinds in (4, 3, 5))
    petals = np.array([4, 8, 6, 12])[one][number]
    flower = radius - 0.3 - np.float32(0.1) * np.cos(petals * angle)
    star = np.abs(u) + np.abs(v) - np.array([0.22, 0.3, 0.16], np.float32)[two][number]
    corner = np.hypot(np.abs(u) - 0.5, np.abs(v) - 0.5) - 0.2
    pixel = 1.2 / size
    image = np.ones((*u.shape, 3), np.float32) * colours[0].astype(np.float32)
    for shape, shift in ((flower, 0), (star, 1), (corner, 2), (np.abs(flower) - 0.022, 3), (np.abs(corner) - 0.018, 1)):
        tints = colours[1 + (three + shift) % 4].astype(np.float32)[number]
        image = mixed(image, tints, step(-shape, pixel))
    image = lit(image, rng.normal(1, 0.05, 256).astype(np.float32)[number])
    image = lit(image, 1 + 0.05 * fractal(rng, coarsest_px=64))
    edge = (0.5 - np.maximum(np.abs(u), np.abs(v))) * size
    crackle = step(np.abs(fractal(rng, coarsest_px=64, persistence=0.6)), 0.035)
    image = mixed(image, (112, 100, 84), 0.3 * (1 - crackle))
    image = mixed(image, (178, 140, 108), step(fractal(rng, coarsest_px=128) - 1.5, 0.1))
    return finished(rng, mixed((120, 112, 102), image, step(edge - 2, 1.5)) * relief(2 * step(edge, 6), 0.2), grain=5)


def painted(rng: np.random.Generator) -> Pixels:
    """A painted wall, nearly of one colour or of two, one above the other, with scuffs and the grain of a roller."""
    y, x = grid()
    colours = palette(rng)
    upper, lower = (pick(rng, colours) * share + (1 - share) * 226 for share in rng.uniform(0.08, 0.4, 2))
    edge = rng.uniform(0.3, 2) * SIDE_PX + 3 * fractal(rng, coarsest_px=64)
    image = mixed(upper, lower, step(y - edge, 3))
    for _ in range(int(rng.integers(2, 7))):
        turn, at = rng.uniform(0, np.pi), rng.uniform(0, SIDE_PX, 2)
        along, away = np.cos(turn), np.sin(turn)
        across = np.abs((y - at[0]) * along - (x - at[1]) * away)
        beside = (y - at[0]) * away + (x - at[1]) * along
        line = step(rng.uniform(1, 5) - across, 2) * step(rng.uniform(20, 160) - np.abs(beside), 40)
        image = mixed(image, pick(rng, colours) * 0.6, rng.uniform(0.1, 0.35) * line)
    return finished(rng, image * relief(fractal(rng, coarsest_px=8), 0.012), grain=1.5, light=0.12)


def plaster(rng: np.random.Generator) -> Pixels:
    """Plaster in pale colours, with strokes of a trowel, stains and hairline cracks."""
    pale = 0.25 * pick(rng, palette(rng)) + 0.75 * np.array([216, 208, 194])
    strokes = resized(fractal(rng, (192, SIDE_PX), coarsest_px=64, persistence=0.8), (SIDE_PX, SIDE_PX))
    image = lit(np.ones((SIDE_PX, SIDE_PX, 3)) * pale, 1 + 0.03 * strokes)
    image = mixed(image, 0.8 * pale, 0.3 * step(fractal(rng, coarsest_px=256, persistence=0.7) - 1, 0.6))
    ridge = np.abs(fractal(rng, coarsest_px=256, persistence=0.6))
    cracks = step(0.02 - ridge, 0.02) * step(fractal(rng, coarsest_px=256, finest_px=16) - 0.6, 0.5)
    image = mixed(image, 0.55 * pale, 0.6 * cracks)
    return finished(rng, image * relief(0.5 * strokes + 0.2 * fractal(rng, coarsest_px=16), 0.06), grain=2, light=0.1)
