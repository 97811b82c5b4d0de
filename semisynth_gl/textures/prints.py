"""Drawn pictures of printed matter: pages, posters, packages, books."""

import numpy as np
from PIL import Image, ImageDraw

from semisynth_gl.textures.canvas import (
    SHEET_PX,
    SIDE_PX,
    Pixels,
    colour,
    finished,
    fitted,
    font,
    fractal,
    ink_on,
    lettering,
    palette,
    pick,
    reduced,
    sheet,
    varied,
    word,
    words,
)
from semisynth_gl.textures.illustrations import Box, around, chart, photograph, printed

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
                size = int(rng.integers(26, 58))
                lines = int(rng.integers(1, 4))
                for line in range(lines):
                    text = words(rng, 2).capitalize()
                    draw.text(
                        (left, y + 1.15 * line * size),
                        text,
                        varied(rng, pick(rng, inks) * 0.6),
                        fitted(text, right - left, size),
                    )
                high = round(1.2 * lines * size)
            else:
                size = int(rng.choice([11, 13, 15, 18]))
                if kind > 0.9:
                    ground = 0.3 * pick(rng, inks) + 0.7 * paper
                    draw.rectangle(box, fill=colour(ground))
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
            draw.ellipse((x - size / 2, y - size / 2, x + size / 2, y + size / 2), fill=ink)
        elif kind == 1:
            for ring in range(6):
                radius = size * (6 - ring) / 10
                draw.ellipse(around(x, y, radius), fill=ink if ring % 2 else colour(inks[number % 5]))
        elif kind == 2:
            start = rng.uniform(0, 360)
            draw.pieslice((x - size, y - size, x + size, y + size), start, start + rng.uniform(40, 200), fill=ink)
        elif kind == 3:
            turn = rng.uniform(0, np.pi)
            cos, sin = np.cos(turn), np.sin(turn)
            for stripe in range(-4, 5, 2):
                a, b = stripe * size / 9, (stripe + 1) * size / 9
                draw.polygon(
                    [
                        (x + cos * u - sin * v, y + sin * u + cos * v)
                        for u, v in ((-size, a), (size, a), (size, b), (-size, b))
                    ],
                    fill=ink,
                )
        elif kind == 4:
            draw.polygon([(x + a, y + b) for a, b in rng.normal(0, size / 2, (3, 2))], fill=ink)
        else:
            text = word(rng).upper()
            draw.text((x, y), text, ink, font(20 * int(rng.integers(3, 20))))
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
        draw.polygon(
            [(left, bottom), (left, top + 0.5 * high), (right, top + rng.uniform(0.3, 0.7) * high), (right, bottom)],
            fill=colour(inks[1]),
        )
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
    wooden = np.array([[120, 82, 52], [84, 60, 44], [172, 132, 90]])[int(rng.integers(3))]
    while top < SIDE_PX:
        high, left = int(rng.integers(230, 320)), 0
        while left < SIDE_PX:
            wide, tall = int(rng.integers(20, 62)), int(high * rng.uniform(0.72, 0.97))
            image.paste(_spine(rng, wide, tall), (left, top + high - tall))
            left += wide + int(rng.random() < 0.06) * int(rng.integers(4, 24))
        ImageDraw.Draw(image).rectangle((0, top + high, SIDE_PX, top + high + 18), fill=colour(wooden))
        top += high + 18
    rough = fractal(rng, coarsest_px=64)
    return finished(
        rng, np.asarray(image, np.float32) * (1 + np.float32(0.06) * rough)[..., np.newaxis], grain=5, light=0.12
    )


def _spine(rng: np.random.Generator, wide: int, tall: int) -> Image.Image:
    """Return the spine of a book, its title along it."""
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
    # Round: dark at its sides.
    across = np.linspace(-1, 1, wide)[:, np.newaxis, np.newaxis]
    lit = np.asarray(lying, np.float64) * (1.12 - 0.55 * across**4 - 0.12 * across)
    return Image.fromarray(np.clip(lit, 0, 255).astype(np.uint8)).transpose(Image.Transpose.ROTATE_270)
