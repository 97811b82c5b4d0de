"""Parts of scenes made by hand, and their frames compared."""

import numpy as np


def noise_layers(count: int, side: int, seed: int = 0) -> np.ndarray:
    """Patches of white noise, the hardest to reproduce bit for bit."""
    layers = np.random.default_rng(seed).integers(0, 256, (count, side, side, 4), dtype=np.uint8)
    layers[..., 3] = 255
    return layers


def facing(
    camera: object, left_px: float, top_px: float, width_px: float, height_px: float, depth_m: float
) -> np.ndarray:
    """Place the unit square facing the camera so that it covers a rectangle of pixels of the left view."""
    matrix = np.eye(4)
    metre = depth_m / camera.focal_px
    matrix[0, 0], matrix[1, 1] = width_px * metre, height_px * metre
    matrix[:3, 3] = (left_px - 0.5 - camera.cx_left_px) * metre, (top_px - 0.5 - camera.cy_px) * metre, depth_m
    return matrix


def assert_equal(frame, whole, crop):
    assert frame.camera == whole.camera.cropped(crop)
    assert set(frame.arrays()) == set(whole.arrays())
    for role, array in frame.arrays().items():
        expected = whole.arrays()[role][crop.y_px : crop.bottom_px, crop.x_px : crop.right_px]
        np.testing.assert_array_equal(array, expected, err_msg=role)
