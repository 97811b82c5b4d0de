"""Parts of hand-made scenes, and a comparison of frames."""

import numpy as np

from semisynth_gl.geometry.mesh import make_mesh
from semisynth_gl.scene.scene import make_scene

# The unit square in x and y, with z = 0 and u, v along x, y.
SQUARE = make_mesh(
    "square", [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 0], [1, 0], [1, 1], [0, 1]], [[0, 1, 2], [0, 2, 3]]
)


def noise_layers(count: int, side: int, seed: int = 0) -> np.ndarray:
    """Make patches of white noise, in which every wrong texel shows."""
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


def posed(turn: np.ndarray, at: np.ndarray | tuple = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Return the (4, 4) pose of a linear map and a translation."""
    return np.block([[np.asarray(turn, float), np.reshape(at, (3, 1))], [0.0, 0.0, 0.0, 1.0]])


def on_plane(normal: np.ndarray | tuple, distance: float, half_m: float) -> np.ndarray:
    """Place the unit square on the plane normal . X = distance, from -half to half in x and y."""
    slope = -np.asarray(normal[:2], float) / normal[2]
    pose = np.diag([2 * half_m, 2 * half_m, 1.0, 1.0])
    pose[2, :2] = 2 * half_m * slope
    pose[:3, 3] = -half_m, -half_m, distance / normal[2] - half_m * slope.sum()
    return pose


def board(camera: object, left_px: float, right_px: float, disparity_px: float) -> np.ndarray:
    """Place the unit square between two columns of the *right* image, over all rows."""
    depth_m = camera.focal_px * camera.baseline_m / (disparity_px + camera.cx_right_px - camera.cx_left_px)
    left_px, width_px = left_px + disparity_px + 0.5, right_px - left_px
    return facing(camera, left_px, -1, width_px, camera.height_px + 2, depth_m)


def one_model(camera: object, poses: object, **options: object) -> object:
    """Make a scene of the first model, with the first patch, at each pose."""
    return make_scene(camera, model=[0] * len(poses), world_from_model=poses, layer=[0] * len(poses), **options)


def assert_equal(frame, whole, crop=None, message=""):
    """Check that a frame equals another frame, or a crop of it, in camera, channels and values."""
    assert frame.camera == (whole.camera if crop is None else whole.camera.cropped(crop))
    assert frame.arrays().keys() == whole.arrays().keys()
    part = (slice(None),) if crop is None else (slice(crop.y_px, crop.bottom_px), slice(crop.x_px, crop.right_px))
    for role, array in frame.arrays().items():
        np.testing.assert_array_equal(array, whole.arrays()[role][part], err_msg=f"{role} {message}", strict=True)
