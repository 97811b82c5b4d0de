"""The projection from the camera frame (OpenCV's) to OpenGL's clip space, where pixel centres are at half pixels."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Eye, StereoCamera


def clip_from_view(camera: StereoCamera, eye: Eye, near_m: float) -> NDArray[np.float64]:
    """Return the projection of one eye, (4, 4) float64, for clip control ZERO_TO_ONE and a depth test of GREATER.

    A pixel centre at (x, y) has the window coordinates (x + 1/2, y + 1/2). Window y runs downwards like the image's y,
    so the first row that is read back is the top row, and nothing needs to be flipped. Depth is reversed, without a far
    plane: near / Z, which is 1 at the near plane and 0 at infinity.
    """
    w, h = camera.width_px, camera.height_px
    cx, cy, fx, fy = camera.intrinsics_px(eye)
    matrix = np.zeros((4, 4))
    matrix[0, 0] = 2 * fx / w
    matrix[0, 2] = (2 * cx + 1) / w - 1
    matrix[1, 1] = 2 * fy / h
    matrix[1, 2] = (2 * cy + 1) / h - 1
    matrix[2, 3] = near_m
    matrix[3, 2] = 1
    return matrix


def in_view(
    camera: StereoCamera, eye: Eye, near_m: float, centre_m: NDArray[np.float64], radius_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return which of N bounding spheres may reach into an eye's image, (N,) bool.

    Centres (N, 3) are in the eye's frame, radii are (N,). Some spheres near the frustum's edges get True although they
    are outside.
    """
    cx, cy, fx, fy = camera.intrinsics_px(eye)
    x0, x1 = -0.5 - cx, camera.width_px - 0.5 - cx
    y0, y1 = -0.5 - cy, camera.height_px - 0.5 - cy
    # Inward normals of the image's four borders and of the near plane. Inside the right border, x1, is
    # fx X / Z <= x1, so -fx X + x1 Z >= 0.
    planes = np.array([[fx, 0, -x0], [-fx, 0, x1], [0, fy, -y0], [0, -fy, y1], [0, 0, 1.0]])
    planes /= np.linalg.norm(planes, axis=1, keepdims=True)
    distance = centre_m @ planes.T
    distance[:, 4] -= near_m
    inside: NDArray[np.bool_] = (distance > -radius_m[:, None]).all(axis=1)
    return inside
