"""A dataset's pairs beside the photographs and disparity maps of the place that they are made for."""

from semisynth_gl.comparison.compare import Comparison, compare_with_place
from semisynth_gl.comparison.measures import MEASURES, Measure
from semisynth_gl.comparison.place import PlaceFiles, find_place
from semisynth_gl.comparison.sides import MeasuredPlace, Side

__all__ = [
    "MEASURES",
    "Comparison",
    "Measure",
    "MeasuredPlace",
    "PlaceFiles",
    "Side",
    "compare_with_place",
    "find_place",
]
