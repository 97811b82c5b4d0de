"""Random generators, one per purpose: a further draw for one purpose shifts no draw for another purpose."""

from enum import IntEnum

import numpy as np


class Purpose(IntEnum):
    """The purpose of a stream of random numbers. Datasets depend on the values: never renumber them."""

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


def generator(seed: int, purpose: Purpose, *numbers: int) -> np.random.Generator:
    """Return the generator of a purpose.

    Args:
        seed: 0 or more.
        purpose: the purpose.
        numbers: further keys, such as sequence and generation, 0 or more.
    """
    # As entropy instead of spawn keys, [1, 2] and [1, 2, 0] would give the same stream.
    key = np.random.SeedSequence(seed, spawn_key=(int(purpose), *numbers))
    return np.random.Generator(np.random.PCG64(key))
