"""Shares of wrong pixels against their limits: of few pixels, more may be wrong by chance."""

from math import sqrt

DEVIATIONS = 5.0
"""So many standard deviations are not left by chance, in millions of pairs."""
# Of a pixel and its neighbours, which see the same thin thing, all are wrong or none.
_TOGETHER = 9


def most_share(limit: float, pixels: int) -> float:
    """Return up to which share of pixels may be wrong: the limit, and what chance adds to it.

    Args:
        limit: the share that may be wrong in any number of pixels.
        pixels: how many are judged, 1 or more. Of eleven, all may be wrong where the limit is 5 %.
    """
    return limit + DEVIATIONS * sqrt(limit * (1 - limit) * _TOGETHER / pixels)
