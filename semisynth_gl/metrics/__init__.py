"""Errors of predictions against the truth, by the definitions of each benchmark.

`score` compares two arrays, and `evaluate` compares the files of a whole set. `unconfirmed` and `evaluate_views` need
no truth.
"""

from semisynth_gl.metrics.confirmation import evaluate_views, unconfirmed
from semisynth_gl.metrics.evaluate import evaluate
from semisynth_gl.metrics.protocol import PROTOCOLS, Protocol, ProtocolName
from semisynth_gl.metrics.score import Score, pool, score

__all__ = [
    "PROTOCOLS",
    "Protocol",
    "ProtocolName",
    "Score",
    "evaluate",
    "evaluate_views",
    "pool",
    "score",
    "unconfirmed",
]
