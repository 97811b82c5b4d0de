"""Drawn pictures of nature: leaves, meadows, fruit, fields from above, skies."""

import numpy as np
from numpy.typing import NDArray
from PIL import ImageDraw

from semisynth_gl.textures.canvas import (
    SHEET_PX,
    SIDE_PX,
    Pixels,
    cells,
    colour,
    direction,
    finished,
    fractal,
    grid,
    hex_colours,
    lit,
    mixed,
    palette,
    pick,
    reduced,
    relief,
    sheet,
    step,
    toned,
    varied,
    vertices,
    window,
)

_GREENS = hex_colours("26461e 426828 628836 8ca84a 345c3e a8b25c")
_AUTUMN = hex_colours("7a3418 b6541e d4842c e4b248 5c4222 96221e")
_SKIES = hex_colours("3e6ea8 5a8cc4 78a4d2 94b4cc 6c7e98 a4aab2")
_CROPS = hex_colours("7e8e3e b09e54 5c7434 c6b070 806242 466232 9caa5c d6be4a")


def _leaf(
    draw: ImageDraw.ImageDraw,
    rng: np.random.Generator,
    at: NDArray[np.float64],
    angle: float,
    length: float,
    tint: NDArray[np.float64],
) -> None:
    """Draw a leaf from its stem at ``at``: a dark edge, two halves in different light, veins."""
    wide, bend = length * rng.uniform(0.16, 0.3), rng.uniform(-0.25, 0.25)
    t = np.linspace(0, 1, 9)
    spine = np.stack([length * t, bend * length * t * (1 - t) * 2], axis=1)
    breadth = wide * np.sin(np.pi * t**0.8) * (1 + 0.06 * rng.normal(size=9))
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, sin], [-sin, cos]])

    def points(offset: NDArray[np.float64]) -> NDArray[np.float64]:
        placed: NDArray[np.float64] = (spine + np.stack([np.zeros(9), offset], axis=1)) @ turn + at
        return placed

    left, right, middle = points(breadth), points(-breadth), points(np.zeros(9))
    light = np.array([255, 255, 210])
    shadow = np.concatenate([left, right[::-1]]) + length * 0.035
    draw.polygon(vertices(shadow), fill=colour(tint * 0.3))
    draw.polygon(vertices(np.concatenate([left, middle[::-1]])), fill=colour(0.85 * tint + 0.12 * light))
    draw.polygon(vertices(np.concatenate([right, middle[::-1]])), fill=colour(tint * 0.78))
    ink = colour(0.7 * tint + 0.3 * light)
    draw.line(vertices(middle), fill=ink, width=max(1, int(length * 0.018)))
    for number in range(2, 7):
        for edge in (left, right):
            tip = 0.75 * edge[number + 1] + 0.25 * middle[number]
            draw.line(vertices(np.array([middle[number - 1], tip])), fill=ink, width=max(1, int(length * 0.008)))


def leaves(rng: np.random.Generator) -> Pixels:
    """Leaves over leaves, green or in autumn."""
    tints = _AUTUMN if rng.random() < 0.4 else _GREENS
    image, draw = sheet(tints[0] * 0.5)
    count = 620
    places = rng.uniform(-60, SHEET_PX + 60, (count, 2))
    lean = rng.uniform(0, 2 * np.pi)
    for number, at in enumerate(places):
        depth = number / count
        tint = pick(rng, tints) * (0.45 + 0.65 * depth) + rng.normal(0, 10, 3)
        _leaf(draw, rng, at, lean + rng.normal(0, 1.1), rng.uniform(80, 280), tint)
    rough = fractal(rng, coarsest_px=128)
    light = fractal(rng, coarsest_px=256, finest_px=8, persistence=0.6)
    return finished(rng, lit(reduced(image), 1 + 0.1 * rough + 0.14 * light), grain=6)


def meadow(rng: np.random.Generator) -> Pixels:
    """Grass and flowers of several sorts."""
    image, draw = sheet(np.array([34, 50, 22]))
    for number in range(1300):
        depth = number / 1300
        x, y = rng.uniform(-40, SHEET_PX + 40, 2)
        lean, length = rng.normal(0, 0.5), rng.uniform(80, 220)
        tint = varied(rng, pick(rng, _GREENS) * (0.5 + 0.6 * depth), 10)
        base, tip = rng.uniform(3, 7), (x + length * np.sin(lean), y - length * np.cos(lean))
        bend = (x + 0.4 * length * np.sin(lean * 0.6), y - 0.5 * length)
        draw.polygon([(x - base, y), (x + base, y), bend, tip], fill=tint)
    inks = palette(rng)
    for number in range(250):
        at, radius = rng.uniform(0, SHEET_PX, 2), rng.uniform(10, 42) * (1.6 if number > 215 else 1)
        ink, petals, turn = pick(rng, inks), int(rng.integers(5, 13)), rng.uniform(0, 7)
        squash = np.array([1, rng.uniform(0.5, 1)])
        for petal in range(petals):
            angle = turn + 2 * np.pi * petal / petals
            out = np.array([np.cos(angle), np.sin(angle)])
            sideways = np.array([-out[1], out[0]]) * np.sin(np.pi / petals) * 0.95
            one_side = [0.6 * out + sideways * 0.8, out + sideways * 0.4]
            other_side = [out - sideways * 0.4, 0.6 * out - sideways * 0.8]
            outline = at + radius * np.array([0 * out, *one_side, 1.05 * out, *other_side]) * squash
            draw.polygon(vertices(outline), fill=varied(rng, ink, 16))
            vein = at + radius * np.array([0.2 * out, 0.9 * out]) * squash
            draw.line(vertices(vein), fill=colour(ink * 0.72), width=2)
        heart = radius * 0.28
        box = (at[0] - heart, at[1] - heart * squash[1], at[0] + heart, at[1] + heart * squash[1])
        draw.ellipse(box, fill=varied(rng, np.array([214, 168, 52])), outline=(120, 78, 26), width=2)
    rough = fractal(rng, coarsest_px=64)
    return finished(rng, lit(reduced(image), 1 + 0.1 * rough), grain=6)


def fruit(rng: np.random.Generator) -> Pixels:
    """Fruit, sweets or beads in a heap, each a ball with its own light."""
    colours = palette(rng)
    y, x = grid()
    image = np.full((SIDE_PX, SIDE_PX, 3), 24, np.float32)
    speckle = fractal(rng, coarsest_px=32)
    largest = rng.uniform(34, 84)
    count = int(2.4 * (SIDE_PX / largest) ** 2)
    for number in range(count):
        cy, cx = rng.uniform(0, SIDE_PX, 2)
        radius = largest * rng.uniform(0.5, 1)
        inside = window(cy, cx, 1.2 * radius)
        v, u = (y[inside] - np.float32(cy)) / radius, (x[inside] - np.float32(cx)) / radius
        squared = v * v + u * u
        tint = pick(rng, colours) * rng.uniform(0.8, 1.15) + rng.normal(0, 8, 3)
        other = pick(rng, colours)
        blush = step(u * rng.normal() + v * rng.normal() + 0.3 * speckle[inside], 0.9)
        ball = mixed(tint, 0.55 * tint + 0.45 * other, 0.7 * blush)
        if number % 3 == 0:
            angle = direction(v, u) + 2.0 * np.sqrt(squared)
            ball = mixed(ball, (244, 240, 232), step(np.sin(angle * 5 + number) - 0.3, 0.3))
        z = np.sqrt(np.clip(1 - squared, 0, 1))
        shade = 0.32 + 0.8 * np.clip(0.75 * z - 0.4 * v - 0.35 * u, 0, 1) + 0.06 * speckle[inside]
        gleam = step(0.05 - np.square(u + 0.36) - np.square(v + 0.42), 0.05)
        ball = mixed(lit(ball, shade), (255, 252, 244), 0.75 * gleam)
        below = lit(image[inside], 1 - 0.6 * step(1.35 - squared, 0.5))
        image[inside] = mixed(below, ball, step((1 - np.sqrt(squared)) * radius, 1.2))
    return finished(rng, image, grain=5)


def fields(rng: np.random.Generator) -> Pixels:
    """Farmland from above: crops in rows, hedges, paths, trees."""
    number, border, points = cells(rng, int(rng.integers(130, 230)), 1.0)
    angles, periods = rng.uniform(0, np.pi, len(points)), rng.uniform(5, 16, len(points))
    y, x = grid()
    rough = fractal(rng)
    along = x * np.cos(angles).astype(np.float32)[number] + y * np.sin(angles).astype(np.float32)[number]
    rows = np.sin((along + 2 * rough) * (2 * np.pi / periods).astype(np.float32)[number])
    strength = rng.uniform(0.03, 0.2, len(points)).astype(np.float32)[number]
    tints = _CROPS[rng.integers(0, len(_CROPS), len(points))] * rng.uniform(0.8, 1.15, (len(points), 1))
    image = lit(tints.astype(np.float32)[number], 1 + strength * rows + 0.12 * rough)
    hedge = step(4 + 2.5 * rough - border)
    image = mixed(image, toned(fractal(rng, coarsest_px=8), [[24, 40, 20], [50, 74, 34], [86, 106, 52]]), hedge)
    image = mixed(image, (206, 192, 166), step(2.2 - np.abs(border - 8)) * (number % 3 == 0))
    flow = fractal(rng, coarsest_px=512, finest_px=4, persistence=0.5)
    water = np.abs(flow) - 0.05
    image = mixed(image, (58, 86, 96), step(-water, 0.02))
    trees, distance, middles = cells(rng, 24, 1.0)
    wood = (flow[tuple(np.clip(middles.T, 0, SIDE_PX - 1).astype(np.int32))] > 0.9) | (rng.random(len(middles)) < 0.05)
    crown = np.sqrt(np.clip(distance - 1, 0, None))
    mask = step(crown) * wood[trees]
    canopy = toned(rough, [[30, 52, 26], [58, 86, 40], [96, 118, 56]]) * relief(2 * crown + 0.4 * rough, 0.3)
    image = mixed(lit(image, 1 - 0.4 * np.roll(mask, (5, 5), (0, 1))), canopy, mask)
    return finished(rng, image, grain=5)


def sky(rng: np.random.Generator) -> Pixels:
    """A sky that is paler below, with or without clouds."""
    y, _ = grid()
    zenith = pick(rng, _SKIES)
    image = mixed(zenith, 0.3 * zenith + 0.7 * np.array([232, 234, 236]), (y / SIDE_PX) ** rng.uniform(0.7, 2))
    clouds = fractal(rng, coarsest_px=512, persistence=rng.uniform(0.5, 0.6)) - rng.uniform(-0.3, 2)
    shade = 0.85 + 0.12 * step(fractal(rng, coarsest_px=128, persistence=0.6) + 1, 2)
    image = mixed(image, lit(np.array([244, 244, 246]), shade), step(clouds, 1.2))
    return finished(rng, image, grain=1.5, light=0.03)
