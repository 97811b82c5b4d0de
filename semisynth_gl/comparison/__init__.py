"""A dataset's pairs beside the photographs and disparity maps of the place that they are made for."""

from semisynth_gl.comparison.compare import Comparison, compare_with_place
from semisynth_gl.comparison.place import Place, find_place

__all__ = ["Comparison", "Place", "compare_with_place", "find_place"]
