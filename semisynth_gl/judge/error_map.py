"""Pictures of a prediction's errors, in KITTI's colours."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.judge.protocol import PixelComparison

_BOUNDS = np.array([1 / 16, 1 / 8, 1 / 4, 1 / 2, 1, 2, 4, 8, 16], np.float32)
_COLOURS = np.array(
    [
        *((49, 54, 149), (69, 117, 180), (116, 173, 209), (171, 217, 233), (224, 243, 248)),
        *((254, 224, 144), (253, 174, 97), (244, 109, 67), (215, 48, 39), (165, 0, 38)),
    ],
    np.uint8,
)
# The ten colours, the same colours at half brightness for occluded pixels, and black.
_PALETTE = np.concatenate([_COLOURS, _COLOURS // 2, np.zeros((1, 3), np.uint8)])


def draw_error_map(comparison: PixelComparison) -> NDArray[np.uint8]:
    """Draw the errors of a prediction as an image (H, W, 3) uint8 RGB, in ten colours from blue to red.

    Each colour stands for errors twice as large as the previous colour's. Source: ``errorImage`` in io_disp.h and
    log_colormap.h of KITTI's development kit. The colour stands for the smaller of e / 3 px and e / 5 % of the truth.
    Values of 1 and above are the outliers of D1: yellow to red. A pixel without a valid prediction is as bad as the
    worst. Occluded pixels are half as bright. Pixels without truth are black. Unlike the kit, this paints a pixel with
    truth as one pixel, not as 3 x 3.
    """
    error = np.where(comparison.scored, comparison.error, np.float32(np.inf))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # Beside a truth of 0, the relative error is infinite, unless the error is 0 too.
        relative = np.where(error == 0, 0.0, 20.0 * error.astype(np.float64) / np.abs(comparison.truth.disparity))
        magnitude = np.minimum(error / 3.0, relative).astype(np.float32)
    # NaN sorts after all bounds and so gets the worst colour.
    colour = np.searchsorted(_BOUNDS, magnitude, side="right").astype(np.uint8)
    if comparison.truth.visible is not None:
        colour[~comparison.truth.visible] += len(_COLOURS)
    colour[~comparison.judged] = len(_PALETTE) - 1
    return np.asarray(_PALETTE[colour])
