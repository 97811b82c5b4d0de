"""Random generators, one per purpose so that purposes do not affect each other, and evenly spaced numbers."""

import zlib
from enum import IntEnum, unique

import numpy as np

LARGEST_NUMBER = 2**53
"""Maximum number of a pair: beyond it, float64 cannot hold every whole number."""


@unique
class Purpose(IntEnum):
    """The purpose of a stream of random numbers. Datasets depend on the values, so never renumber them."""

    ATLAS = 0
    MODELS = 1
    CAMERA = 2
    BACKGROUND = 3
    PARTICLES = 4
    SHAPE = 5
    TEXTURE = 6
    IMPERFECTIONS = 7
    SPLIT = 8
    PILOTS = 9
    COUNTS = 10
    STRUCTURES = 11
    SWAY = 12
    CROP = 13
    PICTURES = 14
    RECIPES = 15
    LARGE_PATCHES = 17
    RESTING = 18
    RIG = 19
    SKY = 20
    AUGMENTATION = 21
    LENS = 22
    PROJECTOR = 23


def generator(seed: int, purpose: Purpose, *keys: int | str) -> np.random.Generator:
    """Return a new generator of random numbers for a purpose; equal arguments give equal numbers.

    Args:
        seed: the seed of the dataset, or of a split, see `Split.seed`.
        purpose: see `Purpose`.
        keys: distinguish the streams of a purpose: numbers of 0 or more, such as a sequence's, or names.
    """
    # The keys are NumPy's spawn key: as entropy, [1, 2] and [1, 2, 0] would give the same stream.
    numbers = (zlib.crc32(key.encode()) if isinstance(key, str) else key for key in keys)
    sequence = np.random.SeedSequence(seed, spawn_key=(int(purpose), *numbers))
    return np.random.Generator(np.random.PCG64(sequence))


def centres(count: int, parts: int) -> list[int]:
    """Return the middle number of each of ``parts`` equal parts of ``range(count)``; with few numbers, some repeat."""
    return [(2 * part + 1) * count // (2 * parts) for part in range(parts)]


def spread(count: int, wanted: int) -> list[int]:
    """Return ``wanted`` evenly spaced numbers of ``range(count)``, or all if there are fewer."""
    return centres(count, min(count, wanted))
