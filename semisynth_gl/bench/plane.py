"""A fast measurement of a renderer's accuracy: renders a slanted plane and compares it with the plane's equation."""

import numpy as np

from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.render.backends import Backend
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.background import FACE
from semisynth_gl.scene.scene import make_scene


def plane_error_px(backend: Backend) -> float:
    """Return the largest error, px, of the left and right disparity; raises BackendError if OpenGL cannot be used."""
    camera = StereoCamera(320, 240, 400.0, 0.2, 155.5, 163.5, 119.5)
    # The points p of the plane satisfy normal . p = 2, with x and y from -9 to 9 m.
    normal, matrix = np.array([0.3, -0.2, 1.0]), np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 3] = (18, 0, 18 * -0.3), (0, 18, 18 * 0.2), (-9, -9, 2 + 9 * 0.3 - 9 * 0.2)
    layers = np.full((1, 8, 8, 4), 255, np.uint8)
    with Renderer([FACE], layers, backend=backend) as renderer:
        frame = renderer.render(make_scene(camera, model=[0], world_from_model=[matrix], layer=[0]))
    y, x = np.mgrid[:240, :320]
    worst = 0.0
    for eye in EYES:
        depth = (2.0 - normal[0] * camera.offset_m(eye)) / (camera.rays(eye, x, y) @ normal)
        worst = max(worst, float(np.abs(frame.view(eye).disparity - camera.disparity_px(depth)).max()))
    return worst
