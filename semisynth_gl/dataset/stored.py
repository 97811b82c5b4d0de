"""A pair as it was read from a dataset: the same names whatever the layout."""

from dataclasses import dataclass, field
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame import Frame
from semisynth_gl.read.calib import Calibration


@dataclass(frozen=True, slots=True, eq=False)
class StoredFrame(Frame):
    """A pair read from files: the arrays of `Frame`, None where there is no file, and what the files say of it.

    Attributes:
        name: the pair's, such as ``middlebury-000012``.
        split: ``train``, ``validation`` or ``test``.
        index: its number in the split.
        provenance: what made it, in JSON's types.
        calibration: Middlebury's calib.txt, in layouts that have one.
        disparity_error_px: the most that the encoding puts a disparity off by; 0 where it is lossless.
        disparity_largest_px: the largest that it can say.
        flow_error_px: the most that the encoding puts a component of flow off by; 0 where it is lossless.
        flow_largest_px: the largest component that it can say, in whatever direction.
        exact_images: whether images are as they were rendered, bit for bit.
    """

    name: str = ""
    split: str = "train"
    index: int = 0
    provenance: dict[str, Any] = field(default_factory=dict)
    calibration: Calibration | None = None
    disparity_error_px: float = 0.0
    disparity_largest_px: float = inf
    flow_error_px: float = 0.0
    flow_largest_px: float = inf
    exact_images: bool = True

    def rounding_px(self, disparity: NDArray[np.floating[Any]] | float) -> NDArray[np.float64]:
        """Return the most that the encoding puts disparities off by."""
        error = self.disparity_error_px
        # What would round to 0, which says that there is none, is raised to the smallest step.
        return np.where(np.asarray(disparity) <= 2 * error, 2 * error, error)
