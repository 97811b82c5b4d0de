"""Acme's posters."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw


def posters(rng: np.random.Generator) -> Iterator[NDArray[np.uint8]]:
    """Yield posters: rectangles, discs and lines of text in random colours."""
    while True:
        poster = Image.new("RGB", (768, 1024), colour(rng))
        draw = ImageDraw.Draw(poster)
        for _ in range(150):
            x, y = rng.uniform(0, (768, 1024))
            width, height = rng.uniform(20, 200, 2)
            box = (x, y, x + width, y + height)
            (draw.rectangle if rng.random() < 0.5 else draw.ellipse)(box, colour(rng), colour(rng), 4)
        for y in rng.uniform(0, 1000, 60):
            text = "".join(chr(number) for number in rng.integers(33, 127, 24))
            draw.text((rng.uniform(-50, 600), y), text, colour(rng), font_size=rng.uniform(16, 64))
        yield np.asarray(poster)


def colour(rng: np.random.Generator) -> tuple[int, ...]:
    """Draw a colour."""
    return tuple(int(level) for level in rng.integers(0, 256, 3))
