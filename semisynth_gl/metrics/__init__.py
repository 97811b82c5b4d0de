"""Errors of predictions against the truth, as each benchmark counts them.

`score` compares two arrays, `evaluate` the files of a whole set.
"""

from semisynth_gl.metrics.evaluate import evaluate
from semisynth_gl.metrics.protocol import PROTOCOLS, Protocol, ProtocolName
from semisynth_gl.metrics.score import Score, pool, score

__all__ = ["PROTOCOLS", "Protocol", "ProtocolName", "Score", "evaluate", "pool", "score"]
