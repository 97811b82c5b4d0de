"""How often surfaces wear each patch: images have an equal say however many patches they have."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

MOST_TIMES = 4
"""A patch is worn at most this many times as often as the mean one, so an image with few patches has a smaller say."""


def patch_chances(sources: Sequence[str], flat: NDArray[np.bool_], flat_share: float) -> NDArray[np.float64]:
    """Return the chance of each patch, by which a surface wears it: (N,) float64, sum 1.

    Args:
        sources: (N,) the image that each patch is from; the patches of an image share its chance evenly.
        flat: (N,) bool, the patches nearly without texture.
        flat_share: the chance of all flat patches together, where there are both sorts; 0 makes no difference between
            them. Within each sort images have an equal say.
    """
    if not flat_share or flat.all() or not flat.any():
        return _equal_say(sources)
    chances = np.empty(len(sources))
    for sort, share in ((flat, flat_share), (~flat, 1 - flat_share)):
        chances[sort] = share * _equal_say([sources[k] for k in np.flatnonzero(sort).tolist()])
    return chances


def _equal_say(sources: Sequence[str]) -> NDArray[np.float64]:
    counts = Counter(sources)
    shares = equal_shares(counts)
    return np.array([shares[source] / counts[source] for source in sources])


def equal_shares(counts: Mapping[str, int]) -> dict[str, float]:
    """Share out surfaces among images.

    Args:
        counts: number of patches by image, each at least 1.

    Returns:
        The share of each image, sum 1: the same for all but those whose patches would be worn too often.
    """
    patches, rest = sum(counts.values()), 1.0
    shares = {}
    # From few patches to many: what one image cannot take goes to the others.
    for place, name in enumerate(sorted(counts, key=lambda name: (counts[name], name))):
        shares[name] = min(rest / (len(counts) - place), MOST_TIMES * counts[name] / patches)
        rest -= shares[name]
    return shares
