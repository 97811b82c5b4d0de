"""The measures by which `semisynth_gl.compare` compares a dataset's pairs with photographs and maps of its place."""

from semisynth_gl.comparison.measures import MEASURES, Measure
from semisynth_gl.comparison.sides import MeasuredPlace, Side

__all__ = ["MEASURES", "Measure", "MeasuredPlace", "Side"]
