"""Painted pictures, and their elements: palettes, noise, tilings, light, and layers of colour."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from semisynth_gl.inputs.errors import InputError
from semisynth_gl.textures.crops import LUMINANCE_PARTS

SIDE_PX = 768
"""Width and height of a painted picture, pixels."""
_TILES = 4096

Field = NDArray[np.float32]
Pixels = NDArray[np.uint8]
Colour = tuple[int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class PaintedPicture:
    """A painted picture, (H, W, 3) uint8 RGB, top row first, under a name such as ``drawn/tartan``.

    Names are unique within a source. Raises InputError if the pixels have a wrong shape or type.
    """

    name: str
    pixels: NDArray[np.uint8]

    def __post_init__(self) -> None:
        shape, kind = np.shape(self.pixels), getattr(self.pixels, "dtype", None)
        if len(shape) != 3 or shape[2] != 3 or kind != np.uint8:
            raise InputError(f"picture {self.name!r}: expected an array (H, W, 3) of uint8, got {shape} {kind}")


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
    """Return five matching colours in random order, (5, 3) of 0 to 255."""
    return np.clip(rng.permutation(pick(rng, _PALETTES)) * rng.uniform(0.9, 1.08, 3), 0, 255)


def pick(rng: np.random.Generator, colours: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a random one of colours (N, 3), or of palettes (N, K, 3)."""
    chosen: NDArray[np.float64] = colours[int(rng.integers(len(colours)))]
    return chosen


def colour(values: ArrayLike) -> Colour:
    """Return a colour, (3,) levels, in Pillow's form: whole numbers, clipped to 0 to 255."""
    red, green, blue = (int(value) for value in np.clip(values, 0, 255))
    return red, green, blue


def ink_on(paper: ArrayLike, colours: NDArray[np.float64]) -> Colour:
    """Return the colour with the highest contrast to a paper; near-black or off-white if no colour is legible."""
    ground = float(np.dot(paper, LUMINANCE_PARTS))
    contrast = np.abs(colours @ LUMINANCE_PARTS - ground)
    if contrast.max() > 90:
        return colour(colours[contrast.argmax()])
    return (245, 243, 236) if ground < 128 else (24, 24, 28)


def fractal(
    rng: np.random.Generator,
    shape: tuple[int, int] = (SIDE_PX, SIDE_PX),
    *,
    coarsest_px: int = 256,
    finest_px: int = 1,
    persistence: float = 0.9,
    stretch: int = 1,
) -> Field:
    """Return noise (H, W) with a mean of about 0 and a standard deviation of about 1.

    ``coarsest_px`` and ``finest_px``, the heights of its largest and smallest blobs, must be powers of two. Blobs are
    ``stretch`` times as wide as high. Each octave has ``persistence`` times the contrast of the next coarser octave; in
    photographs, this is about 1.
    """
    high, wide = shape[0], -(-shape[1] // stretch)
    cell, amplitude = coarsest_px, 1.0
    field = np.zeros((1, 1), np.float32)
    while cell >= finest_px:
        size = (-(-high // cell) + 1, -(-wide // cell) + 1)
        octave = rng.standard_normal(size, np.float32) * np.float32(amplitude)
        if cell < coarsest_px:
            octave += _enlarged(field, 2, 2)[: size[0], : size[1]]
        field, cell, amplitude = octave, cell // 2, amplitude * persistence
    if finest_px * stretch > 1:
        field = _enlarged(field, finest_px, finest_px * stretch)
    field = field[: shape[0], : shape[1]]
    some = field[::4, ::4].astype(np.float64)
    scaled: Field = (field - np.float32(some.mean())) * np.float32(1 / some.std())
    return scaled


def _enlarged(field: Field, down: int, right: int) -> Field:
    size = (field.shape[1] * right, field.shape[0] * down)
    return np.asarray(Image.fromarray(field).resize(size, Image.Resampling.BICUBIC))


def grid(side_px: int = SIDE_PX) -> tuple[Field, Field]:
    """Return the row and the column of each pixel of a picture, (H, W) float32 each."""
    rows, columns = np.mgrid[:side_px, :side_px].astype(np.float32)
    return rows, columns


def direction(down: Field, right: Field) -> Field:
    """Return the angle, rad, about a centre, of points at the offsets ``down`` and ``right`` from it.

    It is computed in float64, since NumPy's float32 arctan2 gives different results on different processors.
    """
    return np.arctan2(down.astype(np.float64), right.astype(np.float64)).astype(np.float32)


class PatternTiles(NamedTuple):
    """For each pixel, (H, W): its tile's number, approximate distance to its border, offset from its centre."""

    number: NDArray[np.int64]
    border: Field
    down: Field
    right: Field

    def uniform(self, rng: np.random.Generator, low: float, high: float) -> Field:
        """Sample a number from ``low`` to ``high`` for each tile, and return it for each pixel, (H, W)."""
        return rng.uniform(low, high, _TILES).astype(np.float32)[self.number]

    def one_of(self, rng: np.random.Generator, values: ArrayLike) -> Field:
        """Choose one of values (N, ...) for each tile, and return it for each pixel, (H, W, ...)."""
        return rng.permutation(np.resize(values, (_TILES, *np.shape(values)[1:]))).astype(np.float32)[self.number]


def bond(high: float, wide: float, sway: Field | float = 0.0, shift: float = 0.0) -> PatternTiles:
    """Arrange tiles of one size in rows, like bricks; ``shift`` moves every second row by that part of a tile.

    ``sway``, px, moves each pixel along both axes; noise makes the borders uneven.
    """
    y, x = grid()
    row = np.floor((y + sway) / high)
    across = x + sway + shift * wide * (row % 2)
    column = np.floor(across / wide)
    down, right = y + sway - (row + 0.5) * high, across - (column + 0.5) * wide
    border = np.minimum(high / 2 - np.abs(down), wide / 2 - np.abs(right))
    number = (row * 64 + column).astype(np.int64) % _TILES
    return PatternTiles(number, *(np.asarray(field, np.float32) for field in (border, down, right)))


def cells(rng: np.random.Generator, size_px: float, irregular: float = 0.9) -> PatternTiles:
    """Divide a picture into cells around points about ``size_px`` apart, on a grid (``irregular`` 0) or random (1)."""
    y, x = grid()
    count = int(SIDE_PX / size_px) + 3
    centres = np.mgrid[:count, :count] - 0.5 + rng.uniform(-0.5, 0.5, (2, count, count)) * irregular
    rows, columns = (centres * size_px).astype(np.float32).reshape(2, -1)
    first = (y // size_px).astype(np.int64) * count + (x // size_px).astype(np.int64)
    nearest, second, number = np.full(y.shape, np.inf, np.float32), np.full(y.shape, np.inf, np.float32), first
    for beside in range(9):
        candidate = first + beside // 3 * count + beside % 3
        distance = np.square(y - rows[candidate]) + np.square(x - columns[candidate])
        second = np.minimum(second, np.maximum(distance, nearest))
        number = np.where(distance < nearest, candidate, number)
        nearest = np.minimum(nearest, distance)
    border = np.asarray((np.sqrt(second) - np.sqrt(nearest)) / 2, np.float32)
    return PatternTiles(number % _TILES, border, y - rows[number], x - columns[number])


def step(field: NDArray[Any], width: float = 1.0) -> Field:
    """Return a step: 0 where a field is below 0, 1 where it is above ``width``, and a linear ramp between."""
    return np.asarray(np.clip(field / np.float32(width), 0, 1), np.float32)


def toned(field: NDArray[Any], colours: ArrayLike) -> Field:
    """Return the colours (H, W, 3) of a field (H, W): values from -2 to 2 run through ``colours``, (N, 3), in order."""
    stops = np.asarray(colours, np.float64)
    at = np.linspace(0, len(stops) - 1, 1024)
    table = np.stack([np.interp(at, np.arange(len(stops)), stops[:, channel]) for channel in range(3)], axis=1)
    index = np.clip((field + 2) * (1023 / 4), 0, 1023).astype(np.int16)
    return table.astype(np.float32)[index]


def mixed(below: ArrayLike, above: ArrayLike, mask: NDArray[Any]) -> Field:
    """Blend ``above`` over ``below`` by a mask (H, W), where 1 shows ``above``; return pixels (H, W, 3).

    ``above`` and ``below`` are pixels (H, W, 3), or one colour (3,).
    """
    low, high = np.asarray(below, np.float32), np.asarray(above, np.float32)
    return np.asarray(low + (high - low) * mask[..., np.newaxis], np.float32)


def lit(pixels: ArrayLike | Image.Image, light: NDArray[Any]) -> Field:
    """Multiply pixels (H, W, 3), or a colour, by a light (H, W)."""
    return np.asarray(np.asarray(pixels) * light[..., np.newaxis], np.float32)


def relief(height: NDArray[Any], strength: float) -> Field:
    """Shade a height field (H, W), px, lit from the upper left: 1 + strength x slope, from 0.35 to 1.7."""
    slope = np.diff(height, axis=0, prepend=height[:1]) + np.diff(height, axis=1, prepend=height[:, :1])
    return np.asarray(np.clip(1 + strength * slope, 0.35, 1.7), np.float32)


def veins(rng: np.random.Generator, sharpness: float, coarsest_px: int = 256, persistence: float = 0.6) -> Field:
    """Return fine winding lines, (H, W): 1 on a line; a higher ``sharpness`` makes lines narrower."""
    noise = fractal(rng, coarsest_px=coarsest_px, persistence=persistence)
    return np.exp(-np.abs(noise).astype(np.float64) * sharpness).astype(np.float32)


def finished(rng: np.random.Generator, image: NDArray[Any], grain: float = 5.0, light: float = 0.06) -> Pixels:
    """Add grain and uneven light, as in photographs, to a picture (H, W, 3) of 0 to 255; return it as 8-bit RGB.

    ``grain`` is the standard deviation of the grain, levels; ``light`` is the standard deviation of the light around 1.
    """
    shade = 1 + light * fractal(rng, coarsest_px=512, finest_px=64, persistence=0.5)
    noise = grain * fractal(rng, coarsest_px=16, persistence=1.0)
    levels: Pixels = np.clip(np.rint(lit(image, shade) + noise[..., np.newaxis]), 0, 255).astype(np.uint8)
    return levels
