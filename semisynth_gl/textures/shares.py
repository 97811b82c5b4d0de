"""How often surfaces wear each patch: subjects have an equal say however many images and patches they have."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

MOST_TIMES = 4
"""A patch is worn at most this many times as often as the mean one, so a subject with few patches has a smaller say."""


def patch_chances(subjects: Sequence[str], flat: NDArray[np.bool_], flat_share: float) -> NDArray[np.float64]:
    """Return the chance of each patch, by which a surface wears it: (N,) float64, sum 1.

    Args:
        subjects: (N,) the subject that each patch shows, an image or several; the patches of one share its chance
            evenly.
        flat: (N,) bool, the patches nearly without texture.
        flat_share: the chance of all flat patches together, where there are both sorts; 0 makes no difference between
            them. Within each sort subjects have an equal say.
    """
    if not flat_share or flat.all() or not flat.any():
        return _equal_say(subjects)
    chances = np.empty(len(subjects))
    for sort, share in ((flat, flat_share), (~flat, 1 - flat_share)):
        chances[sort] = share * _equal_say([subjects[k] for k in np.flatnonzero(sort).tolist()])
    return chances


def _equal_say(subjects: Sequence[str]) -> NDArray[np.float64]:
    counts = Counter(subjects)
    shares = equal_shares(counts)
    return np.array([shares[subject] / counts[subject] for subject in subjects])


def equal_shares(counts: Mapping[str, int]) -> dict[str, float]:
    """Share out surfaces among subjects, given the number of patches of each: shares of sum 1.

    They are the same for all subjects but the ones whose patches would be worn too often.
    """
    patches, rest = sum(counts.values()), 1.0
    shares = {}
    # From few patches to many: what one subject cannot take goes to the others.
    for place, name in enumerate(sorted(counts, key=lambda name: (counts[name], name))):
        shares[name] = min(rest / (len(counts) - place), MOST_TIMES * counts[name] / patches)
        rest -= shares[name]
    return shares
