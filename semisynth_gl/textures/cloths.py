"""Drawn pictures of cloth: tartan, rugs, knitting, printed flowers."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.textures.canvas import (
    SIDE_PX,
    Field,
    Pixels,
    bent,
    direction,
    finished,
    fractal,
    grid,
    lit,
    mixed,
    palette,
    pick,
    resized,
    step,
    window,
)


def tartan(rng: np.random.Generator) -> Pixels:
    """Twill of coloured threads that cross."""
    colours = palette(rng)
    colours[0] *= 0.45
    pitch = int(rng.integers(3, 6))
    threads = SIDE_PX // pitch + 2

    def sett() -> NDArray[np.float32]:
        widths = rng.choice([1, 2, 3, 6, 10, 16], 12)
        stripes = np.repeat(rng.choice(5, 12, p=[0.35, 0.25, 0.2, 0.1, 0.1]), widths)
        mirrored = np.concatenate([stripes, stripes[::-1]])
        numbers = np.resize(mirrored, threads)
        shades = rng.normal(1, 0.06, (threads, 1))
        return (colours[numbers] * shades).astype(np.float32)

    warp = sett()
    weft = sett() if rng.random() < 0.4 else warp
    y, x = grid()
    sway = 2.5 * fractal(rng, coarsest_px=512, finest_px=16, persistence=0.6)
    v, u = (y + sway) / pitch, (x - sway) / pitch
    row, column = (np.clip(np.floor(at), 0, threads - 1).astype(np.int32) for at in (v, u))
    over = (row + column) % 4 < 2
    image = np.where(over[..., np.newaxis], warp[column], weft[row])
    round_thread = np.where(over, np.abs(u % 1 - 0.5), np.abs(v % 1 - 0.5))
    fibre = fractal(rng, coarsest_px=4)
    image = lit(image, 1.18 - 0.75 * round_thread + 0.09 * fibre)
    folds = fractal(rng, coarsest_px=256, finest_px=16, persistence=0.5)
    return finished(rng, lit(image, 1 + 0.1 * folds), grain=5)


def rug(rng: np.random.Generator) -> Pixels:
    """A knotted rug: medallions and borders, drawn in knots that each differ a little."""
    knot = 4
    count = SIDE_PX // knot
    colours = palette(rng)
    half = count // 2
    v, u = np.mgrid[:half, :half].astype(np.float32)
    pattern = np.zeros((half, half), np.int32)
    # Lozenges, squares and stars of random sizes lie on each other, the first in the middle.
    for number in range(26):
        cy, cx = rng.choice([0, 0, half * rng.random(), half * rng.random()], 2) if number else (0, 0)
        radius = rng.uniform(6, 70 if number < 8 else 26)
        shapes = (
            np.abs(v - cy) + np.abs(u - cx),
            np.maximum(np.abs(v - cy), np.abs(u - cx)),
            np.minimum(np.abs(v - cy) + 0.4 * np.abs(u - cx), np.abs(u - cx) + 0.4 * np.abs(v - cy)) * 1.5,
        )
        distance = shapes[int(rng.integers(3))]
        teeth = 2 * ((v + u) // 3 % 2)
        ring = ((distance + teeth) // rng.integers(3, 8)).astype(np.int32)
        pattern = np.where(distance < radius, (ring + number) % 5, pattern)
    edge = half - 1 - np.maximum(v, u)
    along = np.minimum(v, u)
    for near, far in ((0, 6), (8, 26), (28, 34)):
        motif = (np.abs(along % (far - near + 4) - (far - near) / 2) + np.abs(edge - (near + far) / 2)) // 2.5
        pattern = np.where((edge >= near) & (edge < far), motif.astype(np.int32) % 5, pattern)
        pattern = np.where((edge == near) | (edge == far), 4, pattern)
    whole = np.block([[pattern[::-1, ::-1], pattern[::-1]], [pattern[:, ::-1], pattern]])
    # Wool is dyed in lots, so bands of rows differ in colour.
    lots = 1 + 0.06 * resized(rng.standard_normal((count // 8, 1)).astype(np.float32), (count, 1))
    tints = lit(colours[whole], lots) * rng.normal(1, 0.07, (count, count, 1))
    tints += rng.normal(0, 5, (count, count, 3))
    image = np.repeat(np.repeat(tints.astype(np.float32), knot, 0), knot, 1)
    y, x = grid()
    sway = fractal(rng, coarsest_px=128, finest_px=4, persistence=0.6)
    image = bent(image, 3 * sway, 2 * fractal(rng, coarsest_px=64, finest_px=4, persistence=0.6))
    pile = 1.1 - 0.09 * ((y % knot) == 0) - 0.07 * ((x % knot) == 0) + 0.08 * fractal(rng, coarsest_px=8)
    worn = step(fractal(rng, coarsest_px=256) - 1.2, 1.2)
    image = lit(mixed(image, (176, 160, 138), 0.45 * worn), pile.astype(np.float32))
    return finished(rng, image, grain=6)


def knitting(rng: np.random.Generator) -> Pixels:
    """Stitches in rows, with bands of ornament."""
    wide = int(rng.integers(14, 24))
    high = round(0.8 * wide)
    columns, rows = SIDE_PX // wide + 2, SIDE_PX // high + 3
    colours = palette(rng)
    pattern = np.zeros((rows, columns), np.int32)
    at = 0
    while at < rows:
        band, period = int(rng.integers(2, 13)), int(rng.integers(4, 15))
        motif = rng.random((band, period)) < 0.45
        motif = np.logical_or(motif, motif[:, ::-1])
        back, front = rng.choice(5, 2, replace=False)
        stitches = np.where(np.tile(motif, (1, columns // period + 1))[:, :columns], front, back)
        stitches = np.full_like(stitches, back) if rng.random() < 0.3 else stitches
        pattern[at : at + band] = stitches[: rows - at]
        at += band
    tints = (colours[pattern] * rng.normal(1, 0.06, (rows, columns, 1))).astype(np.float32)
    y, x = grid()
    sway = fractal(rng, coarsest_px=256, finest_px=8, persistence=0.6)
    u = (x + 3 * sway) / wide
    side = np.abs(u % 1 - 0.5)
    v = (y + 3 * sway) / high + 1.1 - 1.6 * side
    row = np.clip(np.floor(v), 0, rows - 1).astype(np.int32)
    column = np.clip(np.floor(u), 0, columns - 1).astype(np.int32)
    bulge = (0.5 - np.abs(v % 1 - 0.5)) * np.minimum(side, 0.5 - side)
    yarn = np.minimum(1, 1.7 * np.sqrt(np.clip(bulge * 4, 0, 1)))
    twist = np.sin((v * 5 + np.where(u % 1 < 0.5, 1, -1) * side * 26).astype(np.float32))
    fluff = fractal(rng, coarsest_px=8)
    image = lit(tints[row, column], 0.38 + 0.68 * yarn + 0.07 * twist + 0.07 * fluff)
    return finished(rng, image.astype(np.float32), grain=5)


def flowered(rng: np.random.Generator) -> Pixels:
    """Cloth printed with flowers, each a little different."""
    y, x = grid()
    colours = palette(rng)
    ground = pick(rng, colours)
    image = np.ones((SIDE_PX, SIDE_PX, 3), np.float32) * ground.astype(np.float32)
    for size, count in ((64, 80), (128, 36), (205, 16)):
        for _ in range(count):
            cy, cx = rng.uniform(-20, SIDE_PX + 20, 2)
            radius = size * rng.uniform(0.28, 0.5)
            inside = window(cy, cx, radius)
            v, u = y[inside] - np.float32(cy), x[inside] - np.float32(cx)
            if v.size:
                image[inside] = _flower(rng, image[inside], v, u, radius, colours)
    threads = 0.05 * (np.sin(x * 1.6) * np.sin(y * 1.6)) + 0.05 * fractal(rng, coarsest_px=4)
    folds = fractal(rng, coarsest_px=256, finest_px=16, persistence=0.5)
    return finished(rng, lit(image, (1 + threads + 0.08 * folds).astype(np.float32)), grain=6)


def _flower(
    rng: np.random.Generator, below: Field, v: Field, u: Field, radius: float, colours: NDArray[np.float64]
) -> Field:
    distance, angle = np.hypot(v, u), direction(v, u) + rng.uniform(0, 7)
    petals = int(rng.integers(4, 10))
    inks = rng.permutation(colours)
    # In float64, for the reason given in `direction`.
    lobes = np.abs(np.cos(angle * petals / 2)).astype(np.float64) ** rng.uniform(0.3, 1.5)
    reach = radius * (0.45 + 0.5 * lobes)
    veins = 0.85 + 0.25 * distance / radius + 0.08 * np.sin(angle * petals * 4)
    image = mixed(below, inks[0] * 0.55, step(reach - distance + 2, 1.5))
    petal = lit(inks[1].astype(np.float32), veins.astype(np.float32))
    image = mixed(image, petal, step(reach - distance, 1.5))
    image = mixed(image, inks[2], step(0.55 * reach - distance, 1.5) * 0.8)
    return mixed(image, inks[3], step(0.2 * radius - distance + np.sin(angle * 14), 1.5))
