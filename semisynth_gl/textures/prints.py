"""Paints pictures of many marks: prints, packages, books, maps, screens, leaves, flowers."""

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from semisynth_gl.textures import marks
from semisynth_gl.textures.canvas import (
    SIDE_PX,
    Pixels,
    cells,
    colour,
    finished,
    fractal,
    hex_colours,
    ink_on,
    lit,
    mixed,
    palette,
    pick,
    step,
    toned,
    veins,
)

_GREENS = hex_colours("26461e 426828 628836 8ca84a 345c3e a8b25c")
_AUTUMN = hex_colours("7a3418 b6541e d4842c e4b248 5c4222 96221e")
_PAPERS = hex_colours("f4f0e6 ece4d0 fafaf8 e2e8ea f0e2d6")
_WINDOWS = hex_colours("1e202a 1e202a f8f8fa")
_SHELVES = hex_colours("785234 543c2c ac845a")


def _scattered(rng: np.random.Generator, count: int) -> list[tuple[NDArray[np.float64], float]]:
    """Return random points of a sheet, (2,) x and y, with numbers that rise from 0 to 1."""
    return list(zip(rng.uniform(-60, marks.SHEET_PX + 60, (count, 2)), np.linspace(0, 1, count), strict=True))


def leaves(rng: np.random.Generator) -> Pixels:
    """Leaves over leaves, green or in autumn."""
    tints, lean = _AUTUMN if rng.random() < 0.4 else _GREENS, rng.uniform(0, 7)
    image, pen = marks.blank(tints[0] * 0.5)
    for at, above in _scattered(rng, 620):
        tint = pick(rng, tints) * (0.45 + 0.65 * above) + rng.normal(0, 10, 3)
        marks.leaf(pen, rng, at, lean + rng.normal(0, 1.1), rng.uniform(80, 280), rng.uniform(0.16, 0.3), tint)
    light = 0.1 * fractal(rng, coarsest_px=128) + 0.14 * fractal(rng, finest_px=8, persistence=0.6)
    return finished(rng, lit(image.reduce(2), 1 + light), grain=6)


def meadow(rng: np.random.Generator) -> Pixels:
    """Grass and flowers of several sorts."""
    inks, (image, pen) = palette(rng), marks.blank((34, 50, 22))
    for at, above in _scattered(rng, 900):
        tint = pick(rng, _GREENS) * (0.45 + 0.5 * above)
        marks.leaf(pen, rng, at, rng.normal(-np.pi / 2, 0.5), rng.uniform(80, 220), 0.05, tint)
    for at, _ in _scattered(rng, 220):
        marks.flower(pen, rng, at, 10 + 50 * rng.random() ** 2, pick(rng, inks), np.array([214, 168, 52]))
    return finished(rng, lit(image.reduce(2), 1 + 0.1 * fractal(rng, coarsest_px=64)), grain=6)


def flowered(rng: np.random.Generator) -> Pixels:
    """Cloth printed with flowers."""
    ground, *inks = palette(rng)
    image, pen = marks.blank(ground)
    for at, above in _scattered(rng, 170):
        petal, heart = rng.permutation(inks)[:2]
        marks.flower(pen, rng, at, rng.uniform(30, 90) * (1.8 if above < 0.15 else 1), petal, heart)
    folds = 0.07 * fractal(rng, coarsest_px=4) + 0.08 * fractal(rng, finest_px=16, persistence=0.5)
    return finished(rng, lit(image.reduce(2), 1 + folds), grain=6)


def _printed(rng: np.random.Generator, image: Image.Image) -> Pixels:
    """Add fibres, folds, stains and grain to a print."""
    folds = 0.12 * veins(rng, 40, 512, 0.45) + 0.12 * step(fractal(rng) - 1.4, 1.5)
    return finished(rng, lit(image, 1 - folds + 0.02 * fractal(rng, coarsest_px=32)), grain=4)


def poster(rng: np.random.Generator) -> Pixels:
    """A print of overlapping shapes and large letters."""
    inks = palette(rng)
    image, pen = marks.blank(inks[0])
    for (x, y), above in _scattered(rng, 120):
        marks.shape(pen, rng, x, y, rng.uniform(77, 550) * (1 - 0.8 * above), inks + rng.normal(0, 14))
    return _printed(rng, image.reduce(2))


def page(rng: np.random.Generator) -> Pixels:
    """A page of a newspaper or magazine: a title and columns of text, headlines, pictures, charts."""
    inks, paper, title = palette(rng), pick(rng, _PAPERS), marks.words(rng, 2).title()
    image, pen = marks.blank(paper, SIDE_PX, SIDE_PX)
    band, wide = int(rng.integers(20, 150)), SIDE_PX // int(rng.integers(2, 5))
    pen.rectangle((0, 0, SIDE_PX, band), fill=colour(inks[0]))
    pen.text((24, 0.1 * band), title, ink_on(inks[0], inks), marks.fitting_font(title, SIDE_PX - 48, int(0.72 * band)))
    for left in range(16, SIDE_PX, wide):
        top = band + 14
        while top < SIDE_PX:
            bottom = top + int(rng.integers(90, 300))
            marks.block(image, rng, (left, top, left + wide - 30, bottom), paper)
            top = bottom + 14
    return _printed(rng, image)


def screen(rng: np.random.Generator) -> Pixels:
    """Windows on a screen: programs in colours, charts."""
    inks = palette(rng)
    image = marks.as_image(toned(fractal(rng, coarsest_px=512, persistence=0.7), inks))
    pen = ImageDraw.Draw(image)
    for left, top in rng.integers(-120, 560, (10, 2)).tolist():
        right, bottom = left + int(rng.integers(300, 560)), top + int(rng.integers(260, 480))
        paper, bar = pick(rng, _WINDOWS), pick(rng, inks)
        pen.rectangle((left + 5, top + 6, right + 7, bottom + 8), fill=(14, 14, 18))
        pen.rectangle((left, top, right, bottom), fill=colour(paper), outline=(96, 96, 104))
        pen.rectangle((left, top, right, top + 26), fill=colour(bar))
        pen.text((left + 64, top + 3), marks.words(rng, 2).title(), ink_on(bar, inks), marks.font(16))
        marks.block(image, rng, (left + 12, top + 36, right - 12, bottom - 12), paper)
    return finished(rng, np.asarray(image), grain=4, light=0.04)


def _shelves(rng: np.random.Generator, wide: tuple[int, int], *, upright: bool) -> Pixels:
    """Paint shelves full of packages of random widths; with ``upright``, the lettering runs along their height."""
    image, pen = marks.blank((30, 24, 20), SIDE_PX, SIDE_PX)
    board, top = colour(pick(rng, _SHELVES)), -int(rng.integers(0, 80))
    while top < SIDE_PX:
        left, foot = -int(rng.integers(0, 60)), top + int(rng.integers(220, 320))
        while left < SIDE_PX:
            width, height = int(rng.integers(*wide)), int((foot - top) * rng.uniform(0.75, 0.97))
            package = _package(rng, *((height, width) if upright else (width, height)))
            package = package.transpose(Image.Transpose.ROTATE_270) if upright else package
            across = np.linspace(-1, 1, width)
            package = marks.as_image(lit(package, 1.08 - 0.4 * across**4 - 0.1 * across))
            image.paste(package, (left, foot - height))
            left += width + int(20 * rng.random() ** 6)
        pen.rectangle((0, foot, SIDE_PX, foot + 18), fill=board)
        top = foot + 18
    return finished(rng, lit(image, 1 + 0.06 * fractal(rng, coarsest_px=64)), light=0.12)


def labels(rng: np.random.Generator) -> Pixels:
    """Packages on shelves: brands, ornaments, small print, barcodes."""
    return _shelves(rng, (110, 280), upright=False)


def books(rng: np.random.Generator) -> Pixels:
    """Spines of books on shelves."""
    return _shelves(rng, (20, 62), upright=True)


def _package(rng: np.random.Generator, wide: int, high: int) -> Image.Image:
    inks, brand = palette(rng), marks.words(rng, 1 + wide // (2 * high)).title()
    image, pen = marks.blank(inks[0], wide, high)
    for x, y, size in rng.uniform((0, 0, 0.1 * high), (wide, high, 0.4 * high), (int(rng.integers(1, 12)), 3)):
        marks.shape(pen, rng, x, y, size, inks[1:3])
    letters, top = marks.fitting_font(brand, 0.7 * wide, int(min(0.6 * high, 75))), int(rng.uniform(0.05, 0.35) * high)
    below = top + int(1.35 * letters.size)
    pen.rectangle((0, top, wide, below), fill=colour(inks[3]))
    pen.text((10, top), brand, ink_on(inks[3], inks), letters)
    marks.lettering(pen, rng, (8, below, wide - 74, high), int(rng.integers(10, 15)), [ink_on(inks[0], inks)])
    if wide > 2 * high:
        return image
    pen.rectangle((wide - 70, high - 46, wide - 8, high - 8), fill=(252, 252, 252))
    for x in range(wide - 66, wide - 12, 3):
        pen.line((x, high - 43, x, high - 12), fill=(10, 10, 10), width=int(rng.integers(1, 3)))
    return image


def city_map(rng: np.random.Generator) -> Pixels:
    """A map: heights, water, roads, houses, names."""
    height = fractal(rng, coarsest_px=512, finest_px=2, persistence=0.52)
    quarters, houses = cells(rng, 205, 0.8), cells(rng, 13, 0.8)
    image = toned(height, [(170, 196, 150), (196, 214, 164), (240, 234, 216), (232, 214, 178), (214, 184, 146)])
    contour = np.abs(height * 9 % 1 - 0.5) / (np.hypot(*np.gradient(height)) * 9 + 1e-3)
    image = mixed(image, (164, 118, 78), 0.75 * step(0.7 - contour, 0.8))
    built = step(houses.border - 2.2) * (houses.uniform(rng, 0, 1) < 0.5) * step(0.5 - np.abs(height - 0.2), 0.1)
    image = mixed(image, 0.4 * palette(rng)[0] + 85, built)
    for width, road in ((7, (110, 96, 92)), (5, (228, 212, 150))):
        image = mixed(image, road, step(width - quarters.border))
    image = mixed(image, (146, 187, 216), step(-height - 0.95, 0.02))
    drawn = marks.as_image(image)
    pen = ImageDraw.Draw(drawn)
    for x, y in rng.uniform(-20, SIDE_PX - 40, (50, 2)):
        size, halo = int(12 + 24 * rng.random() ** 4), (246, 242, 230)
        pen.text((x, y), marks.words(rng).title(), (40, 36, 34), marks.font(size), stroke_width=2, stroke_fill=halo)
        pen.ellipse(marks.around(x - 6, y + 8, 3), fill=(190, 50, 44), outline=(40, 30, 30))
    return _printed(rng, drawn)
