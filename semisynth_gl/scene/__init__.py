"""Samples the scene of pair i from (config, seed, i), and prepares the models and patches of all scenes; no OpenGL."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
