"""Checks and reports of datasets, and scores of predictions: `verify`, `report` and `evaluate`."""

from semisynth_gl.judge.comparison import MeasuredPair, Row
from semisynth_gl.judge.measures import MEASURES, Measure
from semisynth_gl.judge.place import ReferenceMeasures
from semisynth_gl.judge.protocol import PROTOCOLS, Protocol, ProtocolName, Truth

__all__ = [
    "MEASURES", "PROTOCOLS", "Measure", "MeasuredPair", "Protocol", "ProtocolName", "ReferenceMeasures", "Row", "Truth",
]  # fmt: skip
