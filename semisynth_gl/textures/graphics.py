"""Drawn pictures of graphics: maps and screens."""

import numpy as np
from PIL import Image, ImageDraw

from semisynth_gl.textures.canvas import (
    SIDE_PX,
    Pixels,
    cells,
    colour,
    finished,
    font,
    fractal,
    ink_on,
    mixed,
    palette,
    pick,
    step,
    toned,
    varied,
    word,
    words,
)
from semisynth_gl.textures.illustrations import chart, printed


def city_map(rng: np.random.Generator) -> Pixels:
    """A map: heights, water, roads, houses, names."""
    height = fractal(rng, coarsest_px=512, finest_px=2, persistence=0.52)
    tints = np.array([(170, 196, 150), (196, 214, 164), (240, 234, 216), (232, 214, 178), (214, 184, 146)])
    image = toned(height, tints)
    levels = height * 9
    contour = step(0.7 - np.abs(levels - np.rint(levels)) / (np.hypot(*np.gradient(levels)) + 1e-3), 0.8)
    image = mixed(image, (164, 118, 78), 0.75 * contour)
    water = -0.95 - height
    image = mixed(image, toned(height * 3 + 3, [[124, 170, 206], [168, 204, 226]]), step(water, 0.01))
    image = mixed(image, (60, 104, 150), step(1.2 - np.abs(water) / 0.012, 0.6))
    blocks, border, points = cells(rng, int(rng.integers(44, 72)), 0.75)
    inks = palette(rng)
    built = (rng.random(len(points)) < 0.45)[blocks] & (water < -0.03) & (np.abs(height) < 0.9)
    image = mixed(image, (222, 206, 196), step(border - 3) * built)
    houses, inside, _ = cells(rng, 13, 0.5)
    image = mixed(image, 0.4 * inks[0] + (90, 84, 80), step(inside - 2.2) * built * (border > 6) * (houses % 4 > 0))
    broad = np.maximum(cells(rng, 205, 0.9)[1], 0)
    for width, ink in ((7, (110, 96, 92)), (5, tuple(0.3 * inks[1] + (168, 160, 120)))):
        image = mixed(image, ink, step(width - broad) * (water < 0.02))
    drawn = Image.fromarray(np.clip(image, 0, 255).astype(np.uint8))
    draw = ImageDraw.Draw(drawn)
    for _ in range(50):
        x, y = rng.uniform(-20, SIDE_PX - 40, 2)
        size = int(rng.choice([13, 15, 18, 24, 36], p=[0.35, 0.3, 0.2, 0.1, 0.05]))
        text = word(rng).title() if size < 30 else word(rng, 3).upper()
        wet = water[int(np.clip(y, 0, SIDE_PX - 1)), int(np.clip(x, 0, SIDE_PX - 1))] > 0
        draw.text(
            (x, y),
            text,
            (40, 84, 140) if wet else (40, 36, 34),
            font(size),
            stroke_width=2,
            stroke_fill=(246, 242, 230),
        )
        draw.ellipse((x - 9, y + 5, x - 3, y + 11), fill=(190, 50, 44), outline=(40, 30, 30))
    for line in range(0, SIDE_PX, 171):
        draw.line((line, 0, line, SIDE_PX), fill=(120, 140, 170))
        draw.line((0, line, SIDE_PX, line), fill=(120, 140, 170))
    return printed(rng, np.asarray(drawn, np.float32))


def screen(rng: np.random.Generator) -> Pixels:
    """Windows on a screen: code in colours, tables, charts."""
    inks = palette(rng)
    back = np.asarray(toned(fractal(rng, coarsest_px=512, persistence=0.7), inks))
    image = Image.fromarray(np.clip(back, 0, 255).astype(np.uint8))
    draw = ImageDraw.Draw(image)
    for _ in range(10):
        left, top = (int(at) for at in rng.integers(-120, 560, 2))
        right, bottom = left + int(rng.integers(300, 560)), top + int(rng.integers(260, 480))
        dark = rng.random() < 0.5
        paper = np.array([30, 32, 42]) if dark else np.array([248, 248, 250])
        draw.rectangle((left + 5, top + 6, right + 7, bottom + 8), fill=(14, 14, 18))
        draw.rectangle((left, top, right, bottom), fill=colour(paper), outline=(96, 96, 104))
        bar = varied(rng, pick(rng, inks))
        draw.rectangle((left, top, right, top + 26), fill=bar)
        draw.text((left + 64, top + 3), words(rng, 2), ink_on(np.array(bar), inks), font(16))
        for number, light in enumerate(((236, 96, 88), (244, 190, 80), (98, 196, 96))):
            draw.ellipse((left + 8 + 17 * number, top + 8, left + 19 + 17 * number, top + 19), fill=light)
        if rng.random() < 0.25:
            chart(draw, rng, (left + 12, top + 36, right - 12, bottom - 12), inks)
            continue
        size = int(rng.choice([12, 14, 16]))
        vivid = [colour(0.45 * ink + (135 if dark else 0)) for ink in palette(rng)]
        y, indent = top + 32, 0
        while y + size < bottom:
            x = float(left + 34 + 22 * indent)
            draw.text((left + 6, y), str((y - top) // size), (128, 128, 138), font(size))
            for _ in range(int(rng.integers(0, 7))):
                text = word(rng) + str(rng.choice(["", "(", ") ", " = ", ".", ", ", ": ", "[0]", " + "]))
                if x + font(size).getlength(text) > right - 6:
                    break
                draw.text((x, y), text, vivid[int(rng.integers(5))], font(size))
                x += font(size).getlength(text) + 4
            indent = int(np.clip(indent + rng.integers(-1, 2), 0, 5))
            y += round(1.3 * size)
    return finished(rng, np.asarray(image, np.float32), grain=4, light=0.04)
