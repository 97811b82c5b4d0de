"""Paints patches without photographs: noise, stripes, checks, gradients and dots in random colours."""

from collections.abc import Callable
from itertools import cycle, islice

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.textures.atlas import Atlas, atlas_from_arrays
from semisynth_gl.textures.canvas import Field, fractal, grid, toned
from semisynth_gl.textures.crops import texture_measure

# Minimum texture of a patch, 8-bit levels: above the usual threshold for photographs.
_MIN_TEXTURE = 5.0


def procedural_atlas(rng: np.random.Generator, count: int, patch_px: int) -> Atlas:
    """Make an atlas of ``count`` procedural patches; like `build_atlas`, but without photographs.

    Kinds alternate. Each patch is a pattern of random size and direction in random colours, under fine noise. A patch
    with less texture than 5 levels (see `texture_measure`) is painted again. Sources have names such as
    ``procedural/stripes/00006``. ``patch_px`` is 16 or more.
    """
    kinds = list(islice(cycle(_KINDS.items()), count))
    patches = [_textured(rng, kind, patch_px) for _, kind in kinds]
    return atlas_from_arrays(patches, [f"procedural/{name}/{i:05d}" for i, (name, _) in enumerate(kinds)])


def _textured(
    rng: np.random.Generator, kind: Callable[[np.random.Generator, int], Field], side_px: int
) -> NDArray[np.uint8]:
    while True:
        image = toned(kind(rng, side_px), rng.uniform(16, 240, (int(rng.integers(2, 6)), 3)))
        # Mostly brightness, a little hue, as on stone or cloth.
        grain = rng.uniform(6, 16) * _clouds(rng, side_px, 16)[..., np.newaxis] * rng.uniform(0.6, 1.0, 3)
        patch: NDArray[np.uint8] = np.clip(np.rint(image + grain), 0, 255).astype(np.uint8)
        if texture_measure(patch) >= _MIN_TEXTURE:
            return patch


def _clouds(rng: np.random.Generator, side_px: int, coarsest_px: int = 64) -> Field:
    return fractal(rng, (side_px, side_px), coarsest_px=coarsest_px, finest_px=2, persistence=rng.uniform(0.55, 0.95))


def _axes(rng: np.random.Generator, side_px: int) -> tuple[Field, Field]:
    """Return pixel coordinates (P, P) along two axes at right angles in a random direction."""
    (y, x), angle_rad = grid(side_px), rng.uniform(0, np.pi)
    return x * np.cos(angle_rad) + y * np.sin(angle_rad), y * np.cos(angle_rad) - x * np.sin(angle_rad)


# Each kind returns a field (P, P) of about -2 to 2, see `toned`.
def _noise(rng: np.random.Generator, side_px: int) -> Field:
    field = _clouds(rng, side_px)
    return 2 * np.abs(field) - 2 if rng.random() < 0.4 else field


def _stripes(rng: np.random.Generator, side_px: int) -> Field:
    along = _axes(rng, side_px)[0] / rng.uniform(4, max(8, side_px / 6))
    wave = 2 * np.sin(2 * np.pi * (along + rng.uniform(0, 0.3) * _clouds(rng, side_px)))
    return 2 * np.sign(wave) if rng.random() < 0.5 else wave


def _checks(rng: np.random.Generator, side_px: int) -> Field:
    cell_px = rng.uniform(4, max(8, side_px / 6))
    rows, columns = (np.floor(axis / cell_px).astype(np.int64) for axis in _axes(rng, side_px))
    # Every check has its own level: a plain chess board repeats, and a matcher cannot distinguish its cells.
    levels = rng.uniform(-2, 0, (256, 256))[rows % 256, columns % 256]
    return np.asarray(2 * ((rows + columns) % 2) + levels, np.float32)


def _gradient(rng: np.random.Generator, side_px: int) -> Field:
    along, across = _axes(rng, side_px)
    along = np.hypot(along, across - rng.uniform(0, side_px)) if rng.random() < 0.5 else along
    share = (along - along.min()) / np.ptp(along)
    levels = rng.uniform(-0.6, 0.6, int(rng.integers(6, 40)))
    return np.asarray(2.8 * share - 1.4 + levels[(share * (len(levels) - 1)).astype(int)], np.float32)


def _dots(rng: np.random.Generator, side_px: int) -> Field:
    (y, x), largest_px = grid(side_px), rng.uniform(3, max(4, side_px / 10))
    field = np.full((side_px, side_px), rng.uniform(-2, 2), np.float32)
    for row, column in rng.uniform(0, side_px, (min(2000, int(1.5 * (side_px / largest_px) ** 2)), 2)):
        radius_px = rng.uniform(0.3, 1.0) * largest_px
        near = tuple(slice(max(0, int(at - radius_px)), int(at + radius_px) + 2) for at in (row, column))
        field[near][np.hypot(x[near] - column, y[near] - row) <= radius_px] = rng.uniform(-2, 2)
    return field


_KINDS = {"noise": _noise, "stripes": _stripes, "checks": _checks, "gradient": _gradient, "dots": _dots}
