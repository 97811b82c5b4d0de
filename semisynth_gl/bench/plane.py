"""A slanted plane, rendered and compared with its equation: the quickest measurement of a renderer's accuracy."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.render.backends import Backend
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.background import FACE
from semisynth_gl.scene.scene import make_scene


def plane_error_px(backend: Backend) -> float:
    """Render a slanted plane; return the largest error of the left and right disparity against its equation, px.

    Raises:
        BackendError: where OpenGL cannot be used.
    """
    camera = StereoCamera(320, 240, 400.0, 0.2, 155.5, 163.5, 119.5)
    normal = np.array([0.3, -0.2, 1.0])  # the plane normal . p = 2 m
    corner, along_x, along_y = np.array([-9.0, -9.0]), np.array([18.0, 0.0]), np.array([0.0, 18.0])

    def lifted(xy: NDArray[np.float64], height: float) -> list[float]:
        return [*xy, (height - normal[:2] @ xy) / normal[2]]

    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 3] = lifted(along_x, 0), lifted(along_y, 0), lifted(corner, 2.0)
    layers = np.full((1, 8, 8, 4), 255, np.uint8)
    with Renderer([FACE], layers, backend=backend) as renderer:
        frame = renderer.render(make_scene(camera, model=[0], world_from_model=[matrix], layer=[0]))
    y, x = np.mgrid[:240, :320]
    worst = 0.0
    for eye in EYES:
        origin = normal[0] * camera.offset_m(eye)
        depth = (2.0 - origin) / (camera.rays(eye, x, y) @ normal)
        worst = max(worst, float(np.abs(frame.view(eye).disparity - camera.disparity_px(depth)).max()))
    return worst
