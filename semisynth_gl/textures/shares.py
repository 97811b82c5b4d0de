"""Decides how often each patch is used: subjects have equal shares, or smaller ones if they have few patches."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

MOST_TIMES = 4
"""A patch is used at most this many times as often as the mean patch, so subjects with few patches are used less."""


def patch_chances(subjects: Sequence[str]) -> NDArray[np.float64]:
    """Return the probability with which a surface gets each patch: (N,) float64, sum 1.

    ``subjects``, (N,), names the subject of each patch. The patches of a subject are equally likely.
    """
    counts = Counter(subjects)
    shares = equal_shares(counts)
    return np.array([shares[subject] / counts[subject] for subject in subjects])


def equal_shares(counts: Mapping[str, int]) -> dict[str, float]:
    """Return each subject's share of the surfaces, sum 1, given the subject's number of patches.

    Shares are equal, except that a subject whose patches would be used too often (see `MOST_TIMES`) has less.
    """
    patches, rest = sum(counts.values()), 1.0
    shares = {}
    # Subjects with few patches come first: the part that exceeds their limit goes to subjects with more patches.
    for place, name in enumerate(sorted(counts, key=lambda name: (counts[name], name))):
        shares[name] = min(rest / (len(counts) - place), MOST_TIMES * counts[name] / patches)
        rest -= shares[name]
    return shares
