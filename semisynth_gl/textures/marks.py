"""Paints marks on pictures with Pillow: shapes, plants, lettering."""

from collections.abc import Callable
from functools import cache
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

from semisynth_gl.textures.canvas import SIDE_PX, colour, fractal, palette, pick, toned

_SYLLABLES = str.split("""
ba be bo bra ca ce chi co cra da de di do dra el en fa fi flo ga go gri ha hi ka ki la le li lo lu ma me mi mo na ne ni
no o pa pe pi plo ra re ri ro sa se shi so sta ta te ti to tra u va ve vi wa wi xa ya yo za
""")
SHEET_PX = 2 * SIDE_PX
"""Sides of the image on which shapes are painted, px. It is reduced afterwards, since Pillow paints hard edges."""

Colours = NDArray[np.float64]
"""Colours of 0 to 255, (N, 3) or (3,)."""
Point = NDArray[np.float64]
"""x and y, px, (2,)."""
Box = tuple[int, int, int, int]
"""Left, top, right and bottom, pixels."""
Pen = ImageDraw.ImageDraw

font = cache(cast("Callable[[int], ImageFont.FreeTypeFont]", ImageFont.load_default))
"""Returns Pillow's font, Aileron (CC0), in a size in pixels."""


def blank(paper: ArrayLike, wide: int = SHEET_PX, high: int = SHEET_PX) -> tuple[Image.Image, Pen]:
    """Return an image of one colour, and the pen that paints on it."""
    image = Image.new("RGB", (wide, high), colour(paper))
    return image, ImageDraw.Draw(image)


def as_image(levels: ArrayLike) -> Image.Image:
    """Return levels (H, W, 3) as an image, clipped to 0 to 255 and truncated to whole numbers."""
    return Image.fromarray(np.clip(levels, 0, 255).astype(np.uint8))


def around(x: float, y: float, radius: float) -> tuple[float, float, float, float]:
    """Return left, top, right and bottom of the box around a disc at x, y."""
    return x - radius, y - radius, x + radius, y + radius


def polygon(pen: Pen, points: ArrayLike, fill: ArrayLike) -> None:
    """Fill a polygon of points (N, 2), x and y."""
    pen.polygon([(float(x), float(y)) for x, y in np.asarray(points)], fill=colour(fill))


def _line(pen: Pen, points: ArrayLike, fill: ArrayLike, width: float) -> None:
    pen.line([(float(x), float(y)) for x, y in np.asarray(points)], fill=colour(fill), width=max(1, int(width)))


def _turned(angle_rad: float) -> NDArray[np.float64]:
    return np.array([[np.cos(angle_rad), np.sin(angle_rad)], [-np.sin(angle_rad), np.cos(angle_rad)]])


def shape(pen: Pen, rng: np.random.Generator, x: float, y: float, size: float, inks: Colours) -> None:
    """Paint a shape of a random kind around a point: a disc, rings, a slice, bars, a triangle or a word."""
    kind, ink, other = int(rng.integers(6)), colour(pick(rng, inks)), colour(pick(rng, inks))
    if kind == 0:
        pen.ellipse(around(x, y, size / 2), fill=ink)
    elif kind == 1:
        for ring in range(6):
            pen.ellipse(around(x, y, size * (6 - ring) / 10), fill=ink if ring % 2 else other)
    elif kind == 2:
        start = rng.uniform(0, 360)
        pen.pieslice(around(x, y, size), start, start + rng.uniform(40, 200), fill=ink)
    elif kind == 3:
        turn, bar = _turned(rng.uniform(0, np.pi)), size / 9 * np.array([(-9, 0), (9, 0), (9, 1), (-9, 1)])
        for stripe in range(-4, 5, 2):
            polygon(pen, (bar + stripe * np.array([0, size / 9])) @ turn + (x, y), ink)
    elif kind == 4:
        polygon(pen, rng.normal((x, y), size / 2, (3, 2)), ink)
    else:
        pen.text((x, y), words(rng).upper(), ink, font(max(8, int(0.75 * size))))


def leaf(
    pen: Pen, rng: np.random.Generator, at: Point, angle_rad: float, length: float, wide: float, tint: Colours
) -> None:
    """Paint a leaf or a petal from its stem: a shadow, two halves, veins; ``wide`` is its width over its length."""
    t, turn = np.linspace(0, 1, 8), length * _turned(angle_rad)
    spine = np.stack([t, rng.uniform(-0.5, 0.5) * t * (1 - t)], axis=1)
    breadth = np.outer(wide * np.sin(np.pi * t**0.8), (0, 1))
    left, right, middle = (line @ turn + at for line in (spine + breadth, spine - breadth, spine))
    polygon(pen, np.concatenate([left, right[::-1]]) + 0.035 * length, tint * 0.3)
    pale = 0.7 * tint + (76, 76, 63)
    for edge, half in ((left, 0.85 * tint + (30, 30, 25)), (right, 0.78 * tint)):
        polygon(pen, np.concatenate([edge, middle[::-1]]), half)
        for number in range(1, 5 if wide > 0.1 else 1):
            _line(pen, [middle[number], 0.8 * edge[number + 2] + 0.2 * middle[number]], pale, 0.008 * length)
    _line(pen, middle, pale, 0.018 * length)


def flower(pen: Pen, rng: np.random.Generator, at: Point, radius: float, ink: Colours, heart: Colours) -> None:
    """Paint a flower with petals of the colour ``ink``."""
    petals, turn = int(rng.integers(4, 13)), rng.uniform(0, 7)
    for angle in turn + np.linspace(0, 2 * np.pi, petals, endpoint=False):
        leaf(pen, rng, at, angle, radius, 2 / petals, ink + rng.normal(0, 16))
    pen.ellipse(around(at[0], at[1], 0.28 * radius), fill=colour(heart), outline=colour(heart * 0.56), width=2)


def fitting_font(text: str, width_px: float, largest_px: int) -> ImageFont.FreeTypeFont:
    """Return the font in which a text is about ``width_px`` wide; its size is 8 to ``largest_px`` px."""
    return font(max(8, min(largest_px, int(20 * width_px / max(font(20).getlength(text), 1)))))


def words(rng: np.random.Generator, count: int = 1) -> str:
    """Return invented words of one to four syllables."""
    return " ".join("".join(rng.choice(_SYLLABLES, int(rng.choice([1, 2, 2, 3, 3, 4])))) for _ in range(count))


def lettering(
    pen: Pen, rng: np.random.Generator, box: Box, size_px: int, inks: ArrayLike, *, indented: bool = False
) -> None:
    """Fill a box with lines of invented words and numbers, each in a random one of the colours ``inks``, (N, 3).

    Most lines are as wide as the box. With ``indented``, lines begin and end anywhere, as in a program's source.
    """
    left, top, right, bottom = box
    letters, fills = font(size_px), [colour(ink) for ink in np.asarray(inks)]
    for y in range(top, bottom - size_px, round(1.28 * size_px)):
        x, end = float(left), float(right)
        if indented or rng.random() < 0.15:
            x, end = np.sort(rng.uniform(left, right, 2)) if indented else (x, rng.uniform(left, right))
        for chance in rng.random(100):
            text = words(rng) if chance > 0.06 else str(int(2000 * rng.random()))
            text += str(rng.choice((",", " =", "(", ")", "."))) if chance < 0.2 else ""
            if x + letters.getlength(text) > end:
                break
            pen.text((x, y), text.title() if chance > 0.85 else text, fills[int(rng.integers(len(fills)))], letters)
            x += letters.getlength(text) + 0.28 * size_px


def block(image: Image.Image, rng: np.random.Generator, box: Box, paper: Colours) -> None:
    """Fill a box of an image with a picture of clouds and shapes, a headline, or text.

    On dark paper, the text looks like a program's source.
    """
    left, top, right, bottom = box
    wide, high, kind, inks, is_dark = right - left, bottom - top, rng.random(), palette(rng), paper.mean() < 128
    if kind < 0.25:
        part = as_image(toned(fractal(rng, (high, wide), coarsest_px=128), inks))
        for x, y, size in rng.uniform((0, 0, 20), (wide, high, 140), (int(rng.integers(14)), 3)):
            shape(ImageDraw.Draw(part), rng, x, y, size, inks)
        image.paste(part, (left, top))
        return
    size = int(rng.integers(26, 58) if kind < 0.4 else rng.integers(11, 18))
    fills = 0.45 * inks + 135 * is_dark if is_dark or size > 20 else [(26, 26, 30)]
    lettering(ImageDraw.Draw(image), rng, box, size, fills, indented=bool(is_dark))
