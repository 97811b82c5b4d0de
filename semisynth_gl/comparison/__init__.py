"""What `semisynth_gl.compare` measures in a dataset's pairs, and in photographs and disparity maps of its place."""

from semisynth_gl.comparison.measures import MEASURES, Measure
from semisynth_gl.comparison.sides import MeasuredPlace, Side

__all__ = ["MEASURES", "Measure", "MeasuredPlace", "Side"]
