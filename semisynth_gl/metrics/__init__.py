"""Errors of predictions against the truth, as each benchmark counts them.

`score` compares two arrays. The other modules find the files of a whole set, and show the results.
"""

from semisynth_gl.metrics.protocol import PROTOCOLS, Protocol, ProtocolName
from semisynth_gl.metrics.score import Score, pool, score

__all__ = ["PROTOCOLS", "Protocol", "ProtocolName", "Score", "pool", "score"]
