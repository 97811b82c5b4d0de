"""Judges of datasets and predictions: `verify`, `report` and `evaluate`."""

from semisynth_gl.judge.comparison import Comparison, MeasuredPlace, Row, Side
from semisynth_gl.judge.measures import MEASURES, Measure

__all__ = ["MEASURES", "Comparison", "Measure", "MeasuredPlace", "Row", "Side"]
