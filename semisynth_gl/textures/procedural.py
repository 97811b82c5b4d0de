"""Patches that need no photograph: noise, stripes, checks, gradients and dots in random colours."""

from collections.abc import Callable
from itertools import cycle, islice

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.textures.atlas import Atlas, atlas_from_arrays
from semisynth_gl.textures.canvas import window
from semisynth_gl.textures.crops import texture_measure

_Field = NDArray[np.float64]
_Kind = Callable[[np.random.Generator, int], _Field]

# Least texture of a patch, 8-bit levels: above the usual threshold for photographs.
_MIN_TEXTURE = 5.0
_FINEST_NOISE_PX = 2


def procedural_atlas(rng: np.random.Generator, count: int, patch_px: int) -> Atlas:
    """Make an atlas of ``count`` procedural patches, the counterpart of `build_atlas` where there are no photographs.

    Kinds take turns: noise, stripes, checks, gradient, dots. Each patch is a pattern of random size and direction,
    coloured by a random palette. A fine noise of several octaves lies over it, since a matcher would find nothing
    between the edges of a plain stripe or gradient. A patch with less texture than 5 levels (see `texture_measure`) is
    painted again. Sources are named like ``procedural/stripes/00006``. ``patch_px`` is 16 or more.
    """
    kinds = list(islice(cycle(_KINDS.items()), count))
    patches = [_textured(rng, kind, patch_px) for _, kind in kinds]
    return atlas_from_arrays(patches, [f"procedural/{name}/{i:05d}" for i, (name, _) in enumerate(kinds)])


def _textured(rng: np.random.Generator, kind: _Kind, side_px: int) -> NDArray[np.uint8]:
    while True:
        image = _coloured(rng, kind(rng, side_px))
        if texture_measure(image) >= _MIN_TEXTURE:
            return image


def _coloured(rng: np.random.Generator, field: _Field) -> NDArray[np.uint8]:
    """Colour a field (P, P) in [0, 1] by a random palette and lay fine noise over it: (P, P, 3) uint8."""
    stops = int(rng.integers(2, 6))
    palette = rng.uniform(16, 240, (stops, 3))
    at = np.linspace(0.0, 1.0, stops)
    image = np.stack([np.interp(field, at, palette[:, channel]) for channel in range(3)], axis=-1)
    grain = _value_noise(rng, field.shape[0], coarsest_px=16) - 0.5
    # Mostly brightness, a little hue, as on stone or cloth.
    tint = rng.uniform(0.6, 1.0, 3)
    image += rng.uniform(40, 110) * grain[..., np.newaxis] * tint
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _value_noise(rng: np.random.Generator, side_px: int, coarsest_px: int = 64) -> _Field:
    """Add octaves of smoothly interpolated random grids: (P, P) in [0, 1], stretched to that range."""
    field = np.zeros((side_px, side_px))
    persistence = rng.uniform(0.55, 0.95)
    cell_px, amplitude = float(min(coarsest_px, side_px)), 1.0
    while cell_px >= _FINEST_NOISE_PX:
        cells = int(np.ceil(side_px / cell_px)) + 1
        weights = _smooth_weights(side_px, cell_px, cells + 1)
        field += amplitude * (weights @ rng.random((cells + 1, cells + 1)) @ weights.T)
        cell_px, amplitude = cell_px / 2, amplitude * persistence
    stretched: _Field = (field - field.min()) / np.ptp(field)
    return stretched


def _smooth_weights(side_px: int, cell_px: float, nodes: int) -> _Field:
    """Return the weight of each grid node for each pixel, (side_px, nodes), with an S-shaped transition."""
    at = np.arange(side_px) / cell_px
    node = np.floor(at).astype(np.int64)
    step = at - node
    next_part = step * step * (3 - 2 * step)
    weights = np.zeros((side_px, nodes))
    pixels = np.arange(side_px)
    weights[pixels, node] = 1 - next_part
    weights[pixels, node + 1] += next_part
    return weights


def _turned_axes(rng: np.random.Generator, side_px: int) -> tuple[_Field, _Field]:
    """Return pixel coordinates (P, P) along two axes at right angles in a random direction."""
    angle_rad = rng.uniform(0, np.pi)
    y, x = np.mgrid[:side_px, :side_px].astype(np.float64)
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return x * cos + y * sin, y * cos - x * sin


def _noise(rng: np.random.Generator, side_px: int) -> _Field:
    field = _value_noise(rng, side_px)
    # Some fields are clouds, some are folded into veins.
    return np.abs(2 * field - 1) if rng.random() < 0.4 else field


def _stripes(rng: np.random.Generator, side_px: int) -> _Field:
    along, _ = _turned_axes(rng, side_px)
    period_px = rng.uniform(4, max(8, side_px / 6))
    warp = rng.uniform(0, 1.5) * _value_noise(rng, side_px)
    wave = 0.5 + 0.5 * np.sin(2 * np.pi * (along / period_px + warp))
    return np.round(wave) if rng.random() < 0.5 else wave


def _checks(rng: np.random.Generator, side_px: int) -> _Field:
    along, across = _turned_axes(rng, side_px)
    cell_px = rng.uniform(4, max(8, side_px / 6))
    rows, columns = (np.floor(axis / cell_px).astype(np.int64) for axis in (along, across))
    # Every check has its own level: a plain chess board repeats, and a matcher cannot tell its cells apart.
    levels = rng.random((256, 256))[rows % 256, columns % 256]
    return 0.5 * ((rows + columns) % 2) + 0.5 * levels


def _gradient(rng: np.random.Generator, side_px: int) -> _Field:
    along, across = _turned_axes(rng, side_px)
    if rng.random() < 0.5:
        centre = rng.uniform(-0.2, 1.2, 2) * side_px
        along = np.hypot(along - centre[0], across - centre[1])
    field = (along - along.min()) / np.ptp(along)
    bands = int(rng.integers(6, 40))
    banded = np.floor(field * bands)
    levels = rng.random(bands + 1)
    mixed: _Field = 0.7 * field + 0.3 * levels[banded.astype(np.int64)]
    return mixed


def _dots(rng: np.random.Generator, side_px: int) -> _Field:
    y, x = np.mgrid[:side_px, :side_px].astype(np.float64)
    field = np.full((side_px, side_px), rng.random())
    largest_px = rng.uniform(3, max(4, side_px / 10))
    count = min(2000, int(1.5 * (side_px / largest_px) ** 2))
    centres = rng.uniform(0, side_px, (count, 2))
    radii_px = rng.uniform(0.3, 1.0, count) * largest_px
    for (cx, cy), radius_px, level in zip(centres, radii_px, rng.random(count), strict=True):
        near = window(cy, cx, radius_px)
        inside = np.hypot(x[near] - cx, y[near] - cy) <= radius_px
        field[near][inside] = level
    return field


_KINDS: dict[str, _Kind] = {
    "noise": _noise,
    "stripes": _stripes,
    "checks": _checks,
    "gradient": _gradient,
    "dots": _dots,
}
