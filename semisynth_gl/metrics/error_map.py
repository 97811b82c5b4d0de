"""Pictures of where a prediction is wrong, in the colours of the benchmarks."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.metrics.protocol import Comparison, Protocol

_KITTI_BOUNDS = np.array([1 / 16, 1 / 8, 1 / 4, 1 / 2, 1, 2, 4, 8, 16], np.float32)
_KITTI_COLOURS = np.array(
    [
        (49, 54, 149),
        (69, 117, 180),
        (116, 173, 209),
        (171, 217, 233),
        (224, 243, 248),
        (254, 224, 144),
        (253, 174, 97),
        (244, 109, 67),
        (215, 48, 39),
        (165, 0, 38),
    ],
    np.uint8,
)
# As they are, half as bright, and black.
_KITTI_PALETTE = np.concatenate([_KITTI_COLOURS, _KITTI_COLOURS // 2, np.zeros((1, 3), np.uint8)])
_GOOD, _BAD, _OCCLUDED, _UNKNOWN = (255, 255, 255), (0, 0, 0), (128, 128, 128), (0, 0, 255)


def draw_error_map(
    compared: Comparison, protocol: Protocol, visible: NDArray[np.bool_] | None = None
) -> NDArray[np.uint8]:
    """Draw where a prediction is wrong.

    Args:
        compared: the prediction against its truth.
        protocol: by which; it decides between `kitti_error_map` and `bad_pixel_map`.
        visible: (H, W) bool, where a pixel is not occluded; None where nothing says so.

    Returns:
        (H, W, 3) uint8 RGB.
    """
    if protocol.map_px is None:
        return kitti_error_map(compared, visible)
    return bad_pixel_map(compared, protocol, visible)


def kitti_error_map(compared: Comparison, visible: NDArray[np.bool_] | None = None) -> NDArray[np.uint8]:
    """Draw KITTI's map of errors: ten colours from blue to red, each for errors twice as large as the one before.

    Source: ``errorImage`` in io_disp.h and log_colormap.h of KITTI's development kit. The colour is that of the smaller
    of e / 3 px and e / 5 % of the truth; from 1 on, the outliers of D1, it is yellow to red. What is occluded is half
    as bright. The kit paints each pixel with truth as 3 x 3 pixels, so that sparse truth can be seen; here so too, but
    never over another pixel with truth, and up to the borders.

    Args:
        compared: a prediction against its truth.
        visible: (H, W) bool, where a pixel is not occluded; None where nothing says so.

    Returns:
        (H, W, 3) uint8 RGB, black where there is no truth near.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        magnitude = np.minimum(
            compared.error / 3.0, 20.0 * compared.error.astype(np.float64) / np.abs(compared.truth)
        ).astype(np.float32)
    # NaN sorts after all bounds, as the worst.
    colour = np.searchsorted(_KITTI_BOUNDS, magnitude, side="right").astype(np.uint8)
    if visible is not None:
        colour[~visible] += len(_KITTI_COLOURS)
    height, width = compared.judged.shape
    padded, judged = np.pad(colour, 1), np.pad(compared.judged, 1)
    painted = np.full(colour.shape, len(_KITTI_PALETTE) - 1, np.uint8)
    # In the kit's order, row by row, a later pixel paints over an earlier one; its own pixel comes last here.
    for dy, dx in (*np.ndindex(3, 3), (1, 1)):
        here = slice(dy, dy + height), slice(dx, dx + width)
        np.copyto(painted, padded[here], where=judged[here])
    picture: NDArray[np.uint8] = _KITTI_PALETTE[painted]
    return picture


def bad_pixel_map(
    compared: Comparison, protocol: Protocol, visible: NDArray[np.bool_] | None = None
) -> NDArray[np.uint8]:
    """Draw which pixels are bad: black, grey where occluded; white where good, blue where no figure counts the pixel.

    Source of the colours: src/main.cc of github.com/ETH3D/two-view-evaluation. Pixels that it leaves out of every
    figure it paints white; here they are blue, like those without truth.

    Args:
        compared: a prediction against its truth.
        protocol: its `map_px` is the error above which a pixel is bad; not scored is bad where it says so.
        visible: (H, W) bool, where a pixel is not occluded; None where nothing says so.

    Returns:
        (H, W, 3) uint8 RGB.
    """
    threshold = np.inf if protocol.map_px is None else protocol.map_px
    bad = compared.scored & (compared.error > threshold)
    known = compared.scored
    if protocol.invalid_is_bad:
        bad |= compared.judged & ~compared.scored
        known = compared.judged
    picture = np.empty((*bad.shape, 3), np.uint8)
    picture[:] = _UNKNOWN
    picture[known & ~bad] = _GOOD
    picture[bad] = _BAD
    if visible is not None:
        picture[bad & ~visible] = _OCCLUDED
    return picture
