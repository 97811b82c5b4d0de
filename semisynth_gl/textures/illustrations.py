"""Parts of printed pages: lettering, pictures, charts, and the look of printed paper."""

from functools import cache
from typing import cast

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from semisynth_gl.textures.canvas import (
    Colour,
    Field,
    Pixels,
    as_image,
    colour,
    finished,
    fractal,
    lit,
    mixed,
    pick,
    step,
    toned,
    varied,
)

_SYLLABLES = """
ba be bo bra ca ce chi co cra da de di do dra el en fa fi flo ga go gri ha hi ka ki la le li lo lu ma me mi mo na ne ni
no o pa pe pi plo ra re ri ro sa se shi so sta ta te ti to tra u va ve vi wa wi xa ya yo za
"""

Box = tuple[int, int, int, int]
"""Left, top, right and bottom, pixels."""


def around(x: float, y: float, radius: float) -> tuple[float, float, float, float]:
    """Return the box, as in `Box`, around a disc at x, y."""
    return x - radius, y - radius, x + radius, y + radius


def printed(rng: np.random.Generator, image: Field, grain: float = 4.0) -> Pixels:
    """Return a print, (H, W, 3) of 0 to 255, as a camera sees it: with fibres, a few folds, stains and grain."""
    crease = np.exp(-np.abs(fractal(rng, coarsest_px=512, finest_px=2, persistence=0.45)) * 40)
    stain = step(fractal(rng, coarsest_px=256) - 1.4, 1.5)
    light = 1 - 0.12 * crease - 0.12 * stain + 0.02 * fractal(rng, coarsest_px=32)
    return finished(rng, lit(image, light), grain=grain)


def photograph(image: Image.Image, rng: np.random.Generator, box: Box, inks: NDArray[np.float64]) -> None:
    """Fill a box of an image with a small landscape or a still life of blobs, in the colours ``inks``, (5, 3)."""
    left, top, right, bottom = box
    shape = (bottom - top, right - left)
    y = np.linspace(-2, 2, shape[0], dtype=np.float32)[:, np.newaxis]
    rough = fractal(rng, shape, coarsest_px=128)
    if rng.random() < 0.6:
        inks = inks[np.argsort(-inks.sum(axis=1), kind="stable")]
        view = toned(0.8 * y + 0.25 * rough, inks[:2])
        for number in range(3):
            skyline = fractal(rng, (2, shape[1]), coarsest_px=64, persistence=0.55)[0] * 0.28
            ridge = step((y - (number * 0.55 - 0.5) - skyline) * 40)
            view = mixed(view, toned(rough, [inks[2 + number] * 0.6, inks[2 + number], inks[2 + number] * 1.2]), ridge)
    else:
        view = toned(fractal(rng, shape, coarsest_px=128, persistence=0.7), inks)
    image.paste(as_image(view), (left, top))


def chart(draw: ImageDraw.ImageDraw, rng: np.random.Generator, box: Box, inks: NDArray[np.float64]) -> None:
    """Draw a chart of bars or lines, or a pie, into a box with a title, in the colours ``inks``, (5, 3)."""
    left, top, right, bottom = box
    draw.rectangle(box, fill=colour(0.12 * inks[1] + 0.88 * np.array([250, 248, 244])), outline=(90, 90, 90))
    draw.text((left + 8, top + 4), words(rng, 3), (30, 30, 30), font(13))
    kind, count = int(rng.integers(3)), int(rng.integers(5, 14))
    for number in range(1, 5):
        level = bottom - number * (bottom - top - 30) // 5
        draw.line((left + 6, level, right - 6, level), fill=(188, 186, 180))
    at = np.linspace(left + 18, right - 18, count)
    if kind == 0:
        wide = 0.35 * (right - left - 36) / count
        for x, height in zip(at, rng.uniform(0.1, 0.8, count) * (bottom - top), strict=True):
            draw.rectangle((x - wide, bottom - height, x + wide, bottom - 4), fill=varied(rng, pick(rng, inks)))
    elif kind == 1:
        for ink in inks[:3]:
            heights = np.clip(np.cumsum(rng.normal(0, 0.14, count)) + 0.5, 0.08, 0.8) * (bottom - top)
            points = [(float(x), float(bottom - height)) for x, height in zip(at, heights, strict=True)]
            draw.line(points, fill=colour(ink), width=3)
            for x, y in points:
                draw.ellipse(around(x, y, 4), fill=colour(ink), outline=(255, 255, 255))
    else:
        radius = 0.4 * min(right - left, bottom - top - 24)
        x, y = (left + right) / 2, (top + bottom) / 2 + 10
        angle = 0.0
        for number, share in enumerate(rng.dirichlet(np.full(6, 2.0)) * 360):
            pie, ink = around(x, y, radius), colour(inks[number % 5])
            draw.pieslice(pie, angle, angle + share, fill=ink, outline=(255, 255, 255))
            angle += share


@cache
def font(size_px: int) -> ImageFont.FreeTypeFont:
    """Return Pillow's own font, Aileron (CC0), of a size in pixels."""
    return cast("ImageFont.FreeTypeFont", ImageFont.load_default(size_px))


def word(rng: np.random.Generator, syllables: int = 0) -> str:
    """Return an invented word of some number of syllables, by default a random one to four."""
    count = syllables or int(rng.choice([1, 2, 2, 3, 3, 4]))
    known = _SYLLABLES.split()
    return "".join(known[int(number)] for number in rng.integers(0, len(known), count))


def words(rng: np.random.Generator, count: int) -> str:
    """Return a line of invented words, some with a capital letter, a comma or a number."""
    found = []
    for chance in rng.random(count):
        text = word(rng)
        if chance < 0.06:
            text = str(int(rng.integers(1, 2100)))
        found.append(text.title() if chance > 0.85 else f"{text}," if chance > 0.75 else text)
    return " ".join(found)


def lettering(draw: ImageDraw.ImageDraw, rng: np.random.Generator, box: Box, size_px: int, ink: Colour) -> None:
    """Fill a box with paragraphs of invented words, cut off at its sides."""
    left, top, right, bottom = box
    letters = max(2, int((right - left) / (0.5 * size_px)))
    y, stop = top, 0
    while y + size_px < bottom:
        text = words(rng, letters // 4 + 2)[:letters]
        if stop == 0:
            text, stop = text[: int(len(text) * rng.uniform(0.3, 0.9))] + ".", int(rng.integers(3, 9))
        draw.text((left, y), text.capitalize() if stop == 1 else text, ink, font(size_px))
        stop -= 1
        y += round(1.25 * size_px)


def fitted(text: str, width_px: float, largest_px: int) -> ImageFont.FreeTypeFont:
    """Return the font in which a text is about ``width_px`` wide, 8 to ``largest_px`` pixels high."""
    return font(max(8, min(largest_px, int(20 * width_px / max(font(20).getlength(text), 1)))))
