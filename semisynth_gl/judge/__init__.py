"""Checks and reports of datasets, and scores of predictions: `verify`, `report` and `evaluate`."""

from semisynth_gl.judge.comparison import MeasureComparison, MeasuredPair
from semisynth_gl.judge.measures import MEASURES, Measure
from semisynth_gl.judge.place import ReferenceMeasures
from semisynth_gl.judge.protocol import PROTOCOLS, Protocol, ProtocolName, Truth

__all__ = [
    "MEASURES",
    "PROTOCOLS",
    "Measure",
    "MeasureComparison",
    "MeasuredPair",
    "Protocol",
    "ProtocolName",
    "ReferenceMeasures",
    "Truth",
]  # fmt: skip
