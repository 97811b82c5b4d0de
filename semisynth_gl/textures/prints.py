"""Drawn pictures with lettering: pages, posters, packages, books, maps, screens."""

import numpy as np
from PIL import Image, ImageDraw

from semisynth_gl.textures.canvas import (
    SHEET_PX,
    SIDE_PX,
    Pixels,
    as_image,
    cells,
    colour,
    finished,
    fractal,
    ink_on,
    lit,
    mixed,
    palette,
    pick,
    reduced,
    sheet,
    step,
    toned,
    varied,
)
from semisynth_gl.textures.illustrations import (
    Box,
    around,
    chart,
    fitted,
    font,
    lettering,
    photograph,
    printed,
    word,
    words,
)

_PAPERS = np.array([[244, 240, 230], [236, 228, 208], [250, 250, 248], [226, 232, 234], [240, 226, 214]], np.float64)


def page(rng: np.random.Generator) -> Pixels:
    """A page of a newspaper or magazine: headlines, columns, pictures, charts."""
    inks = palette(rng)
    paper = pick(rng, _PAPERS)
    image = Image.new("RGB", (SIDE_PX, SIDE_PX), colour(paper))
    draw = ImageDraw.Draw(image)
    ink = (26, 26, 30)
    if rng.random() < 0.7:
        band = int(rng.integers(70, 150))
        draw.rectangle((0, 0, SIDE_PX, band), fill=colour(inks[0]))
        title = words(rng, 2).title()
        draw.text((24, 0.1 * band), title, ink_on(inks[0], inks), fitted(title, SIDE_PX - 48, int(0.72 * band)))
    else:
        band = 16
    columns = int(rng.integers(2, 5))
    width = SIDE_PX // columns
    for column in range(columns):
        y = band + 14
        left, right = column * width + 16, (column + 1) * width - 14
        while y < SIDE_PX:
            kind, high = rng.random(), int(rng.integers(110, 300))
            box = (left, y, right, y + high)
            if kind < 0.3:
                photograph(image, rng, box, palette(rng))
            elif kind < 0.45:
                chart(draw, rng, box, inks)
            elif kind < 0.6:
                size, lines = int(rng.integers(26, 58)), int(rng.integers(1, 4))
                for line in range(lines):
                    text = words(rng, 2).capitalize()
                    headline = varied(rng, pick(rng, inks) * 0.6)
                    draw.text((left, y + 1.15 * line * size), text, headline, fitted(text, right - left, size))
                high = round(1.2 * lines * size)
            else:
                size = int(rng.choice([11, 13, 15, 18]))
                if kind > 0.9:
                    draw.rectangle(box, fill=colour(0.3 * pick(rng, inks) + 0.7 * paper))
                lettering(draw, rng, (left + 6, y + 4, right - 4, y + high), size, ink)
            y += high + 14
        if rng.random() < 0.5:
            draw.line((right + 7, band + 10, right + 7, SIDE_PX), fill=(120, 116, 110), width=1)
    return printed(rng, np.asarray(image, np.float32))


def poster(rng: np.random.Generator) -> Pixels:
    """A print of overlapping shapes and large letters."""
    inks = palette(rng)
    image, draw = sheet(pick(rng, inks))
    for number in range(120):
        size = rng.uniform(0.05, 0.36) * SHEET_PX * (1 - number / 150)
        x, y = rng.uniform(-0.1, 1.1, 2) * SHEET_PX
        ink, kind = varied(rng, pick(rng, inks)), int(rng.integers(6))
        if kind == 0:
            draw.ellipse(around(x, y, size / 2), fill=ink)
        elif kind == 1:
            for ring in range(6):
                radius = size * (6 - ring) / 10
                draw.ellipse(around(x, y, radius), fill=ink if ring % 2 else colour(inks[number % 5]))
        elif kind == 2:
            start = rng.uniform(0, 360)
            draw.pieslice(around(x, y, size), start, start + rng.uniform(40, 200), fill=ink)
        elif kind == 3:
            turn = rng.uniform(0, np.pi)
            cos, sin = np.cos(turn), np.sin(turn)
            for stripe in range(-4, 5, 2):
                a, b = stripe * size / 9, (stripe + 1) * size / 9
                corners = ((-size, a), (size, a), (size, b), (-size, b))
                draw.polygon([(x + cos * u - sin * v, y + sin * u + cos * v) for u, v in corners], fill=ink)
        elif kind == 4:
            draw.polygon([(x + a, y + b) for a, b in rng.normal(0, size / 2, (3, 2))], fill=ink)
        else:
            draw.text((x, y), word(rng).upper(), ink, font(20 * int(rng.integers(3, 20))))
    return printed(rng, reduced(image), grain=5)


def labels(rng: np.random.Generator) -> Pixels:
    """Packages on a shelf: brands, stripes, badges, small print, barcodes."""
    image = Image.new("RGB", (SIDE_PX, SIDE_PX), (40, 38, 40))
    draw = ImageDraw.Draw(image)
    top = 0
    while top < SIDE_PX:
        high, left = int(rng.integers(170, 330)), -int(rng.integers(0, 60))
        while left < SIDE_PX:
            wide = int(rng.integers(110, 280))
            _package(draw, rng, (left, top + int(rng.integers(0, 40)), left + wide - 3, top + high - 8))
            left += wide
        draw.rectangle((0, top + high - 8, SIDE_PX, top + high + 14), fill=(196, 190, 178))
        for x in range(0, SIDE_PX, 150):
            draw.rectangle((x + 20, top + high - 6, x + 92, top + high + 12), fill=(250, 246, 220))
            draw.text((x + 26, top + high - 7), f"{rng.uniform(0.5, 30):.2f}", (160, 20, 24), font(16))
        top += high + 14
    return finished(rng, np.asarray(image, np.float32), grain=5, light=0.1)


def _package(draw: ImageDraw.ImageDraw, rng: np.random.Generator, box: Box) -> None:
    left, top, right, bottom = box
    wide, high = right - left, bottom - top
    inks = palette(rng)
    draw.rectangle(box, fill=colour(inks[0]), outline=colour(inks[0] * 0.5), width=2)
    kind = int(rng.integers(4))
    if kind == 0:
        for stripe in range(left, right, int(rng.integers(14, 40))):
            draw.rectangle((stripe, top, min(stripe + 7, right), bottom), fill=colour(inks[1]))
    elif kind == 1:
        slope = [(left, top + 0.5 * high), (right, top + rng.uniform(0.3, 0.7) * high)]
        draw.polygon([(left, bottom), *slope, (right, bottom)], fill=colour(inks[1]))
    elif kind == 2:
        for _ in range(30):
            dot = around(rng.uniform(left + 12, right - 12), rng.uniform(top + 12, bottom - 12), rng.uniform(3, 12))
            draw.ellipse(dot, fill=varied(rng, inks[int(rng.integers(1, 4))]))
    else:
        radius = 0.4 * min(wide, high)
        ring = around((left + right) / 2, top + 0.6 * high, radius)
        draw.ellipse(ring, fill=colour(inks[1]), outline=colour(inks[2]), width=5)
    brand = word(rng).title()
    band = top + int(rng.uniform(0.08, 0.4) * high)
    letters = fitted(brand, wide - 20, int(0.3 * high))
    size = int(letters.size)
    draw.rectangle((left, band, right, band + 1.35 * size), fill=colour(inks[2]))
    draw.text((left + 10, band + 0.05 * size), brand, ink_on(inks[2], inks), letters)
    draw.text((left + 10, band + 1.4 * size), words(rng, 3), ink_on(inks[0], inks), font(14))
    lettering(draw, rng, (left + 8, bottom - 54, left + wide // 2, bottom - 4), 10, ink_on(inks[0], inks))
    draw.rectangle((right - 70, bottom - 46, right - 8, bottom - 8), fill=(252, 252, 252))
    for x in range(right - 66, right - 12, 3):
        draw.line((x, bottom - 43, x, bottom - 12), fill=(10, 10, 10), width=int(rng.integers(1, 3)))
    draw.ellipse(around(right - 34, top + 34, 26), fill=colour(inks[3]), outline=colour(inks[4]), width=3)
    draw.text((right - 51, top + 22), str(int(rng.integers(10, 99))), ink_on(inks[3], inks), font(26))


def books(rng: np.random.Generator) -> Pixels:
    """Spines of books on shelves."""
    image = Image.new("RGB", (SIDE_PX, SIDE_PX), (30, 24, 20))
    top = -int(rng.integers(0, 80))
    wooden = pick(rng, np.array([[120, 82, 52], [84, 60, 44], [172, 132, 90]], np.float64))
    while top < SIDE_PX:
        high, left = int(rng.integers(230, 320)), 0
        while left < SIDE_PX:
            wide, tall = int(rng.integers(20, 62)), int(high * rng.uniform(0.72, 0.97))
            image.paste(_spine(rng, wide, tall), (left, top + high - tall))
            left += wide + int(rng.random() < 0.06) * int(rng.integers(4, 24))
        ImageDraw.Draw(image).rectangle((0, top + high, SIDE_PX, top + high + 18), fill=colour(wooden))
        top += high + 18
    rough = fractal(rng, coarsest_px=64)
    return finished(rng, lit(np.asarray(image, np.float32), 1 + 0.06 * rough), grain=5, light=0.12)


def _spine(rng: np.random.Generator, wide: int, tall: int) -> Image.Image:
    """Return the spine of a book, with the title along it."""
    inks = palette(rng)
    lying = Image.new("RGB", (tall, wide), varied(rng, inks[0]))
    draw = ImageDraw.Draw(lying)
    ink = ink_on(inks[0], inks)
    for place in rng.uniform(0.02, 0.98, int(rng.integers(1, 5))):
        broad = int(rng.integers(2, 16))
        draw.rectangle((place * tall, 0, place * tall + broad, wide), fill=varied(rng, inks[int(rng.integers(1, 5))]))
    if rng.random() < 0.3:
        draw.rectangle((0.2 * tall, 0, 0.75 * tall, wide), fill=colour(inks[1]))
        ink = ink_on(inks[1], inks)
    title, author = words(rng, int(rng.integers(2, 5))).title(), f"{word(rng)} {word(rng)}".upper()
    draw.text((0.08 * tall, 0.16 * wide), title, ink, fitted(title, 0.62 * tall, int(0.62 * wide)))
    draw.text((0.74 * tall, 0.3 * wide), author, ink, fitted(author, 0.24 * tall, int(0.36 * wide)))
    # A spine is round, so its sides are darker.
    across = np.linspace(-1, 1, wide)[:, np.newaxis]
    shaded = lit(np.asarray(lying, np.float64), 1.12 - 0.55 * across**4 - 0.12 * across)
    return as_image(shaded).transpose(Image.Transpose.ROTATE_270)


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
    for width, road in ((7, (110, 96, 92)), (5, tuple(0.3 * inks[1] + (168, 160, 120)))):
        image = mixed(image, road, step(width - broad) * (water < 0.02))
    drawn = as_image(image)
    draw = ImageDraw.Draw(drawn)
    for _ in range(50):
        x, y = rng.uniform(-20, SIDE_PX - 40, 2)
        size = int(rng.choice([13, 15, 18, 24, 36], p=[0.35, 0.3, 0.2, 0.1, 0.05]))
        text = word(rng).title() if size < 30 else word(rng, 3).upper()
        wet = water[int(np.clip(y, 0, SIDE_PX - 1)), int(np.clip(x, 0, SIDE_PX - 1))] > 0
        ink = (40, 84, 140) if wet else (40, 36, 34)
        draw.text((x, y), text, ink, font(size), stroke_width=2, stroke_fill=(246, 242, 230))
        draw.ellipse((x - 9, y + 5, x - 3, y + 11), fill=(190, 50, 44), outline=(40, 30, 30))
    for line in range(0, SIDE_PX, 171):
        draw.line((line, 0, line, SIDE_PX), fill=(120, 140, 170))
        draw.line((0, line, SIDE_PX, line), fill=(120, 140, 170))
    return printed(rng, np.asarray(drawn, np.float32))


def screen(rng: np.random.Generator) -> Pixels:
    """Windows on a screen: code in colours, tables, charts."""
    inks = palette(rng)
    image = as_image(toned(fractal(rng, coarsest_px=512, persistence=0.7), inks))
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
