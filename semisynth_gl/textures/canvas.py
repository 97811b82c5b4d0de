"""Tools for drawing pictures: colours that go together, noise, relief, cells."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw

from semisynth_gl.textures.crops import LUMINANCE_PARTS

SIDE_PX = 768
"""Width and height of a drawn picture, pixels."""

# Shapes are drawn at this multiple of their size and reduced, since Pillow draws hard edges.
_FINE = 2
SHEET_PX = _FINE * SIDE_PX
"""Width and height of the image that shapes are drawn on, pixels."""

Field = NDArray[np.float32]
Pixels = NDArray[np.uint8]
Colour = tuple[int, int, int]


def hex_colours(codes: str) -> NDArray[np.float64]:
    """Return the colours of hexadecimal codes such as ``264653``, separated by blanks; (N, 3) of 0 to 255."""
    return np.array([list(bytes.fromhex(code)) for code in codes.split()], np.float64)


# Palettes of five colours, chosen by eye; most run from dark to light.
_PALETTES = hex_colours("""
264653 2a9d8f e9c46a f4a261 e76f51   1d3557 457b9d a8dadc f1faee e63946   3d405b 81b29a f2cc8f e07a5f f4f1de
003049 d62828 f77f00 fcbf49 eae2b7   606c38 283618 fefae0 dda15e bc6c25   5f0f40 9a031e fb8b24 e36414 0f4c5c
2b2d42 8d99ae edf2f4 ef233c d90429   132a13 31572c 4f772d 90a955 ecf39e   10002b 5a189a 9d4edd e0aaff ff9e00
335c67 fff3b0 e09f3e 9e2a2b 540b0e   0b132b 1c2541 3a506b 5bc0be f5f5f0   6b2d5c f0386b ff5376 f8c0c8 f5e6c8
22577a 38a3a5 57cc99 80ed99 faf3dd   4a2c2a 8c5e3c c19a6b e8d5b5 2f4858   233d4d fe7f2d fcca46 a1c181 619b8a
386641 6a994e a7c957 f2e8cf bc4749   33202a 6d4c5b c97b84 a85751 f0d9c0   073b4c 118ab2 06d6a0 ffd166 ef476f
2d2424 5c3d2e b85c38 e0c097 f6efe2   27476e 006992 eaf8bf ffb703 d1495b   1b4332 40916c b7e4c7 f9c74f f3722c
""").reshape(-1, 5, 3)


def palette(rng: np.random.Generator) -> NDArray[np.float64]:
    """Return five colours that go together, in random order, (5, 3) of 0 to 255."""
    return np.clip(rng.permutation(pick(rng, _PALETTES)) * rng.uniform(0.9, 1.08, 3), 0, 255)


def colour(values: NDArray[Any]) -> Colour:
    """Return a colour, (3,) levels, as Pillow takes it: whole numbers, clipped to 0 to 255."""
    red, green, blue = (int(value) for value in np.clip(values, 0, 255))
    return red, green, blue


def varied(rng: np.random.Generator, values: NDArray[Any], spread: float = 14.0) -> Colour:
    """Return a colour near a given colour: lighter or darker, and a little different in hue.

    ``spread`` is the standard deviation of the lightness, in levels.
    """
    return colour(values + rng.normal(0, spread) + rng.normal(0, spread / 3, 3))


def pick(rng: np.random.Generator, colours: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a random colour out of several, (N, 3), or a random palette out of several, (N, K, 3)."""
    chosen: NDArray[np.float64] = colours[int(rng.integers(len(colours)))]
    return chosen


def luminance(values: NDArray[Any]) -> float:
    """Return the luminance of a colour, 0 to 255."""
    return float(np.dot(values, LUMINANCE_PARTS))


def ink_on(paper: NDArray[Any], colours: NDArray[np.float64]) -> Colour:
    """Return the colour in which text is easiest to read on a paper; near-black or off-white where none is legible."""
    best = max(colours, key=lambda ink: abs(luminance(ink) - luminance(paper)))
    if abs(luminance(best) - luminance(paper)) > 90:
        return colour(best)
    return (245, 243, 236) if luminance(paper) < 128 else (24, 24, 28)


def fractal(
    rng: np.random.Generator,
    shape: tuple[int, int] = (SIDE_PX, SIDE_PX),
    *,
    coarsest_px: int = 256,
    finest_px: int = 1,
    persistence: float = 0.9,
) -> Field:
    """Return noise (H, W) with a mean of about 0 and a standard deviation of about 1.

    Its largest and smallest blobs have the given sizes, both powers of two. Each octave has the contrast of the next
    coarser octave times ``persistence``, which is about 1 in photographs.
    """
    cell, amplitude = coarsest_px, 1.0
    field: Field | None = None
    while cell >= finest_px:
        size = (-(-shape[0] // cell) + 1, -(-shape[1] // cell) + 1)
        octave = rng.standard_normal(size, np.float32) * np.float32(amplitude)
        if field is not None:
            octave += resized(field, (2 * field.shape[0], 2 * field.shape[1]))[: size[0], : size[1]]
        field, cell, amplitude = octave, cell // 2, amplitude * persistence
    assert field is not None  # noqa: S101 - coarsest_px is at least finest_px
    if finest_px > 1:
        field = resized(field, (field.shape[0] * finest_px, field.shape[1] * finest_px))
    field = field[: shape[0], : shape[1]]
    some = field[::4, ::4].astype(np.float64)
    scaled: Field = (field - np.float32(some.mean())) * np.float32(1 / some.std())
    return scaled


def resized(field: Field, shape: tuple[int, int]) -> Field:
    """Return a field (H, W) at another size, smoothly interpolated."""
    return np.asarray(Image.fromarray(field).resize((shape[1], shape[0]), Image.Resampling.BICUBIC))


def grid() -> tuple[Field, Field]:
    """Return the row and the column of each pixel of a picture, (H, W) float32 each."""
    rows, columns = np.mgrid[:SIDE_PX, :SIDE_PX].astype(np.float32)
    return rows, columns


def window(y: float, x: float, radius: float) -> tuple[slice, slice]:
    """Return the rows and columns of a picture that a disc may touch."""
    return slice(max(0, int(y - radius)), int(y + radius) + 2), slice(max(0, int(x - radius)), int(x + radius) + 2)


def direction(down: Field, right: Field) -> Field:
    """Return the angle around a centre of points that lie ``down`` and ``right`` of it, rad.

    It is computed in float64: NumPy's float32 arctan2 depends on the processor, and so would the patches of a dataset.
    """
    return np.arctan2(down.astype(np.float64), right.astype(np.float64)).astype(np.float32)


def step(field: NDArray[Any], width: float = 1.0) -> Field:
    """Return an edge: 0 where a field is below 0, 1 where it is above ``width``, and a linear ramp between."""
    return np.asarray(np.clip(field / np.float32(width), 0, 1), np.float32)


def toned(field: NDArray[Any], colours: ArrayLike) -> Field:
    """Colour a field (H, W): values from -2 to 2 run through the colours, (N, 3), in their order; (H, W, 3)."""
    stops = np.asarray(colours, np.float64)
    at = np.linspace(0, len(stops) - 1, 1024)
    table = np.stack([np.interp(at, np.arange(len(stops)), stops[:, channel]) for channel in range(3)], axis=1)
    index = np.clip((field + 2) * (1023 / 4), 0, 1023).astype(np.int16)
    return table.astype(np.float32)[index]


def mixed(below: ArrayLike, above: ArrayLike, mask: NDArray[Any]) -> Field:
    """Lay pixels or a colour over the pixels or the colour ``below`` where a mask (H, W) is 1; (H, W, 3)."""
    low, high = np.asarray(below, np.float32), np.asarray(above, np.float32)
    return np.asarray(low + (high - low) * mask[..., np.newaxis], np.float32)


def lit(pixels: NDArray[Any], light: NDArray[Any]) -> NDArray[Any]:
    """Multiply pixels (H, W, 3), or a colour, by a light (H, W); a light of 1 changes nothing."""
    shaded: NDArray[Any] = pixels * light[..., np.newaxis]
    return shaded


def relief(height: NDArray[Any], strength: float) -> Field:
    """Return the light on a surface lit from the upper left, 1 where it is level; (H, W, 1).

    ``height`` is (H, W) in pixels; ``strength`` is the change of the light per pixel of slope.
    """
    slope = np.diff(height, axis=0, prepend=height[:1]) + np.diff(height, axis=1, prepend=height[:, :1])
    return np.asarray(np.clip(1 + strength * slope, 0.35, 1.7), np.float32)[..., np.newaxis]


def bent(pixels: NDArray[Any], rows: NDArray[Any], columns: NDArray[Any]) -> NDArray[Any]:
    """Return for each pixel the one that lies ``rows`` down and ``columns`` right of it, mirrored at the borders."""
    y, x = grid()
    places = []
    for at, extent in ((y + rows, pixels.shape[0]), (x + columns, pixels.shape[1])):
        around = np.rint(at).astype(np.int32) % (2 * extent)
        places.append(np.minimum(around, 2 * extent - 1 - around))
    moved: NDArray[Any] = pixels[places[0], places[1]]
    return moved


def cells(
    rng: np.random.Generator, cell_px: int, irregular: float = 0.9
) -> tuple[NDArray[np.int32], Field, NDArray[np.float32]]:
    """Divide a picture into cells around random points.

    Args:
        rng: source of the points.
        cell_px: mean distance of neighbouring points.
        irregular: how far points move from a square grid, from 0, where the cells are squares, to 1.

    Returns:
        The number of each pixel's cell, (H, W); the pixel's distance from the border of its cell, pixels, (H, W); and
        the cells' points, (N, 2), row and column.
    """
    count = -(-SIDE_PX // cell_px)
    side = count * cell_px
    centres = (np.mgrid[-1 : count + 1, -1 : count + 1] + 0.5) * cell_px
    points = (centres + rng.uniform(-0.5, 0.5, centres.shape) * irregular * cell_px).astype(np.float32)
    y = np.arange(side, dtype=np.float32).reshape(count, cell_px, 1, 1)
    x = np.arange(side, dtype=np.float32).reshape(1, 1, count, cell_px)
    nearest = np.full((count, cell_px, count, cell_px), np.inf, np.float32)
    second = nearest.copy()
    number = np.zeros(nearest.shape, np.int32)
    every = np.arange((count + 2) ** 2, dtype=np.int32).reshape(count + 2, count + 2)
    for down in range(3):
        for right in range(3):
            window = np.s_[down : down + count, right : right + count]
            py, px, own = (values[window][:, np.newaxis, :, np.newaxis] for values in (*points, every))
            distance = np.square(y - py) + np.square(x - px)
            closer = distance < nearest
            second = np.minimum(second, np.maximum(distance, nearest))
            number = np.where(closer, own, number)
            nearest = np.minimum(nearest, distance)
    border = ((np.sqrt(second) - np.sqrt(nearest)) / 2).astype(np.float32)
    cut = np.s_[:SIDE_PX, :SIDE_PX]
    return number.reshape(side, side)[cut], border.reshape(side, side)[cut], points.reshape(2, -1).T


def sheet(paper: NDArray[Any]) -> tuple[Image.Image, ImageDraw.ImageDraw]:
    """Return an image of one colour to draw shapes on, `SHEET_PX` along both sides, and its drawing interface."""
    image = Image.new("RGB", (SHEET_PX, SHEET_PX), colour(paper))
    return image, ImageDraw.Draw(image)


def vertices(points: NDArray[np.float64]) -> list[tuple[float, float]]:
    """Return points (N, 2), x and y, as Pillow takes them."""
    return [(float(x), float(y)) for x, y in points]


def reduced(image: Image.Image) -> Field:
    """Return a `sheet` at the size of a picture, (H, W, 3)."""
    return np.asarray(image.reduce(_FINE), np.float32)


def finished(rng: np.random.Generator, image: NDArray[Any], grain: float = 5.0, light: float = 0.06) -> Pixels:
    """Return a picture as 8-bit RGB, (H, W, 3), with grain and uneven light, as in any photograph.

    Args:
        rng: source of the grain and the light.
        image: the picture, (H, W, 3), 0 to 255.
        grain: standard deviation of the grain, levels.
        light: standard deviation of the light, whose mean is 1.
    """
    shade = 1 + light * fractal(rng, coarsest_px=512, finest_px=64, persistence=0.5)
    noise = grain * fractal(rng, coarsest_px=16, persistence=1.0)
    levels: Pixels = np.clip(np.rint(lit(image, shade) + noise[..., np.newaxis]), 0, 255).astype(np.uint8)
    return levels


def as_image(levels: NDArray[Any]) -> Image.Image:
    """Return levels (H, W, 3) as an image to draw on, clipped to 0 to 255 and truncated to whole numbers."""
    return Image.fromarray(np.clip(levels, 0, 255).astype(np.uint8))
