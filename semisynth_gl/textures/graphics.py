"""Drawn pictures of graphics: maps, screens, circuit boards, comics, confetti."""

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from semisynth_gl.textures.canvas import (
    SHEET_PX,
    SIDE_PX,
    Pixels,
    cells,
    colour,
    finished,
    fitted,
    font,
    fractal,
    grid,
    ink_on,
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
    word,
    words,
)
from semisynth_gl.textures.illustrations import around, chart, printed


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


def circuit(rng: np.random.Generator) -> Pixels:
    """A circuit board: tracks, vias, chips, resistors, printed names."""
    boards = np.array([[20, 84, 52], [18, 54, 100], [120, 24, 30], [30, 30, 34], [88, 40, 110]])
    board = pick(rng, boards.astype(np.float64))
    image, draw = sheet(board)
    track, pad = colour(board * 1.45 + 16), (212, 186, 110)
    step_px = 32
    for _ in range(250):
        x, y = (rng.integers(0, SHEET_PX // step_px, 2) * step_px).tolist()
        points = [(x, y)]
        turn = int(rng.integers(8))
        for _ in range(int(rng.integers(1, 6))):
            turn = (turn + int(rng.integers(-1, 2))) % 8
            length = int(rng.integers(1, 9)) * step_px
            x, y = x + round(np.cos(turn * np.pi / 4)) * length, y + round(np.sin(turn * np.pi / 4)) * length
            points.append((x, y))
        draw.line(points, fill=track, width=int(rng.choice([6, 8, 8, 14])), joint="curve")
        for x, y in (points[0], points[-1]):
            draw.ellipse(around(x, y, 12), fill=pad)
            draw.ellipse(around(x, y, 5), fill=(16, 18, 18))
    for _ in range(90):
        x, y = (rng.integers(0, SHEET_PX // step_px, 2) * step_px).tolist()
        kind = rng.random()
        if kind < 0.16:
            _chip(draw, rng, x, y)
        elif kind < 0.32:
            radius = int(rng.integers(30, 80))
            draw.ellipse(around(x + 8, y + 10, radius), fill=(8, 10, 10))
            draw.ellipse(around(x, y, radius), fill=(186, 188, 192), outline=(60, 64, 90), width=8)
            draw.pieslice(around(x, y, radius - 8), 40, 140, fill=(44, 48, 76))
        else:
            long, broad = int(rng.choice([48, 64, 96])), int(rng.choice([26, 34]))
            wide, high = (long, broad) if rng.random() < 0.5 else (broad, long)
            draw.rectangle((x, y, x + wide, y + high), fill=(206, 204, 198))
            body = varied(
                rng, np.array([[60, 44, 36], [196, 160, 110], [30, 30, 32], [70, 96, 140]])[int(rng.integers(4))]
            )
            inset = 12
            draw.rectangle(
                (
                    x + (inset if wide > high else 0),
                    y + (0 if wide > high else inset),
                    x + wide - (inset if wide > high else 0),
                    y + high - (0 if wide > high else inset),
                ),
                fill=body,
            )
            draw.text((x, y - 30), f"{word(rng, 1)[0].upper()}{int(rng.integers(1, 99))}", (236, 238, 232), font(24))
    rough = fractal(rng, coarsest_px=64)
    whole = reduced(image)
    return finished(
        rng, whole * (1 + np.float32(0.07) * rough)[..., np.newaxis] * relief(whole.mean(axis=2) / 60, 0.07), grain=5
    )


def _chip(draw: ImageDraw.ImageDraw, rng: np.random.Generator, x: int, y: int) -> None:
    wide, high = (int(size) for size in rng.integers(4, 12, 2) * 32)
    for at in range(x + 10, x + wide - 8, 32):
        draw.rectangle((at, y - 16, at + 14, y + high + 16), fill=(202, 202, 200))
    for at in range(y + 10, y + high - 8, 32):
        draw.rectangle((x - 16, at, x + wide + 16, at + 14), fill=(202, 202, 200))
    draw.rectangle(
        (x, y, x + wide, y + high), fill=varied(rng, np.array([38, 38, 42]), 6), outline=(74, 74, 80), width=4
    )
    draw.ellipse((x + 14, y + 14, x + 30, y + 30), fill=(70, 70, 74))
    for line in range(3):
        text = f"{word(rng, 2).upper()}{int(rng.integers(10, 9999))}"
        draw.text((x + 36, y + 14 + 42 * line), text, (196, 198, 200), fitted(text, wide - 50, 38))


def comic(rng: np.random.Generator) -> Pixels:
    """Panels of a comic: figures, speed lines, dots, speech."""
    image, draw = sheet(np.array([250, 248, 240]))
    top = 24
    while top < SHEET_PX:
        high, left = int(rng.integers(420, 760)), 24
        while left < SHEET_PX:
            wide = int(rng.integers(420, 900))
            own = image.crop((left, top, left + wide, top + high))
            _panel(own, rng)
            image.paste(own, (left, top))
            draw.rectangle((left, top, left + wide, top + high), outline=(16, 16, 18), width=9)
            left += wide + 24
        top += high + 24
    return printed(rng, reduced(image))


def _panel(own: Image.Image, rng: np.random.Generator) -> None:
    wide, high = own.size
    draw = ImageDraw.Draw(own)
    inks = palette(rng)
    draw.rectangle((0, 0, wide, high), fill=colour(inks[0]))
    centre = rng.uniform(0.2, 0.8, 2) * own.size
    if rng.random() < 0.5:
        for angle in np.sort(rng.uniform(0, 2 * np.pi, 46)):
            reach, broad = 1400, rng.uniform(0.01, 0.05)
            ends = [
                (centre[0] + reach * np.cos(a), centre[1] + reach * np.sin(a)) for a in (angle - broad, angle + broad)
            ]
            draw.polygon([tuple(centre), *ends], fill=colour(inks[1]))
    else:
        pitch = int(rng.integers(22, 40))
        for x in range(0, wide, pitch):
            for y in range(0, high, pitch):
                away = float(np.hypot(x - centre[0], y - centre[1]))
                draw.ellipse(around(x, y, 0.45 * pitch * away / wide), fill=colour(inks[1]))
    for number in range(int(rng.integers(4, 11))):
        points = centre + rng.normal(0, 0.2, 2) * wide + _blob(rng, rng.uniform(50, 190))
        draw.polygon(
            vertices(points),
            fill=varied(rng, inks[2 + number % 3]),
            outline=(16, 16, 18),
            width=7,
        )
    for _ in range(int(rng.integers(1, 3))):
        left, top = rng.uniform(0, 0.6) * wide, rng.uniform(0, 0.7) * high
        broad, tall = rng.uniform(220, 380), rng.uniform(110, 200)
        tail = [(left + 0.3 * broad, top + 0.8 * tall), (left + 0.5 * broad, top + 0.8 * tall), tuple(centre)]
        draw.polygon(tail, fill=(252, 252, 250), outline=(16, 16, 18), width=6)
        draw.ellipse((left, top, left + broad, top + tall), fill=(252, 252, 250), outline=(16, 16, 18), width=6)
        for line in range(2):
            text = words(rng, 3).upper()
            at = (left + 0.16 * broad, top + (0.22 + 0.28 * line) * tall)
            draw.text(at, text, (20, 20, 22), fitted(text, 0.7 * broad, 44))


def _blob(rng: np.random.Generator, radius: float) -> NDArray[np.float64]:
    angles = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    reach = np.full(40, radius)
    for k in range(1, 6):
        reach += radius * rng.normal(0, 0.3 / k) * np.cos(k * angles + rng.uniform(0, 7))
    outline: NDArray[np.float64] = np.stack([np.cos(angles), np.sin(angles)], axis=1) * reach[:, np.newaxis]
    return outline


def confetti(rng: np.random.Generator) -> Pixels:
    """Bits of coloured paper with shadows, over each other."""
    inks = palette(rng)
    image, draw = sheet(pick(rng, inks))
    for number in range(1750):
        size = rng.uniform(12, 44) * (2 if number < 400 else 1)
        x, y = rng.uniform(-20, SHEET_PX + 20, 2)
        turn, squash = rng.uniform(0, np.pi), rng.uniform(0.3, 1)
        corners = 4 if number % 3 else 12
        angles = turn + np.linspace(0, 2 * np.pi, corners, endpoint=False)
        outline = np.stack([np.cos(angles), squash * np.sin(angles)], axis=1) * size + (x, y)
        draw.polygon(vertices(outline + np.array([5, 7])), fill=(26, 24, 28))
        draw.polygon(vertices(outline), fill=varied(rng, pick(rng, inks), 24))
    y_px = grid()[0]
    rough = fractal(rng, coarsest_px=32) + np.float32(0.2) * np.sin(y_px / 90)
    return finished(rng, reduced(image) * (1 + np.float32(0.05) * rough)[..., np.newaxis], grain=6)
