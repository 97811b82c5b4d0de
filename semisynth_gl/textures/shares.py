"""How often surfaces wear each patch: subjects have equal shares, or less where they have few patches."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

MOST_TIMES = 4
"""A patch is worn at most this many times as often as the mean patch, so subjects with few patches have less share."""


def patch_chances(subjects: Sequence[str]) -> NDArray[np.float64]:
    """Return the chance of each patch to be worn by a surface: (N,) float64, sum 1.

    ``subjects``, (N,), names the subject that each patch shows; the patches of a subject share its chance evenly.
    """
    counts = Counter(subjects)
    shares = equal_shares(counts)
    return np.array([shares[subject] / counts[subject] for subject in subjects])


def equal_shares(counts: Mapping[str, int]) -> dict[str, float]:
    """Return each subject's share of the surfaces, sum 1, given the number of its patches.

    Shares are equal, except that a subject whose patches would be worn too often (see `MOST_TIMES`) has less.
    """
    patches, rest = sum(counts.values()), 1.0
    shares = {}
    # From few patches to many: what a subject cannot take goes to those with more patches.
    for place, name in enumerate(sorted(counts, key=lambda name: (counts[name], name))):
        shares[name] = min(rest / (len(counts) - place), MOST_TIMES * counts[name] / patches)
        rest -= shares[name]
    return shares
