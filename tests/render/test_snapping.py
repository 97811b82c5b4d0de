"""GPUs move the corners of triangles before they interpolate: truth is the pixel's centre's all the same.

The processor's driver does not, so here the vertex shader moves corners as NVIDIA's driver does. Without the
correction, other tests then failed as they did on an H200, most with the same figures.
"""

import numpy as np
import pytest
from scenes import noise_layers

from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.render import programs
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.scene import make_scene

STEPS = 256
CAMERA = StereoCamera(640, 480, 900.0, 0.25, 320.1, 377.4, 230.7)
# Slopes of planes, and half the sides of squares on them before the camera: GPUs clip before they move corners.
PLANES = ((0.5, 0, 2.013), (-0.8, 0.3, 1.613), (0.2, -2.5, 0.613))
MOVE = f"""
    if (gl_Position.w > 0.0) {{
        vec2 size_px = round(2.0 * focal_px / vec2(clip_from_view[0][0], clip_from_view[1][1]));
        precise vec2 place_px = (gl_Position.xy / gl_Position.w * 0.5 + 0.5) * size_px;
        place_px = round(place_px * {STEPS}.0) / {STEPS}.0;
        gl_Position.xy = (place_px / size_px * 2.0 - 1.0) * gl_Position.w;
    }}
}}
"""


@pytest.fixture
def errors(backend, square, monkeypatch):
    """Draw planes through a driver that moves corners, and return errors of an output in px, eye by eye."""
    original = programs.shader_source

    def source(name, defines=None):
        text = original(name, defines)
        return text.rstrip().removesuffix("}") + MOVE if name == "mesh.vert" else text

    monkeypatch.setattr(programs, "shader_source", source)

    def drawn(plane, output, *, corrected):
        normal, half = np.array(plane[:2]), plane[2]
        monkeypatch.setattr(GraphicsContext, "corner_steps", STEPS if corrected else None)
        matrix = np.eye(4)
        for column, direction in enumerate(np.eye(2) * 2 * half):
            matrix[:3, column] = *direction, -(normal @ direction)
        matrix[:3, 3] = -half, -half, 2.0 + half * normal.sum()
        scene = make_scene(CAMERA, model=[0], world_from_model=[matrix], layer=[0])
        with Renderer([square], noise_layers(1, 16), backend=backend, outputs=("depth",)) as renderer:
            frame = renderer.render(scene)
        y, x = np.mgrid[:480, :640].astype(float)
        for eye in EYES:
            along = CAMERA.rays(eye, x, y) @ (*normal, 1)
            with np.errstate(divide="ignore"):
                depth = (2.0 - normal[0] * CAMERA.offset_m(eye)) / along
            found = frame.view(eye)[output]
            with np.errstate(invalid="ignore"):
                expected = {"disparity": CAMERA.disparity_px(depth), "depth": depth}[output]
                known = np.isfinite(found) & (depth > 0.3) & (depth < 7)
            assert known.mean() > 0.2
            scale = 1 if output == "disparity" else CAMERA.focal_baseline / depth[known] ** 2
            yield np.abs(found[known] - expected[known]) * scale

    return drawn


@pytest.mark.parametrize("output", ["disparity", "depth"])
@pytest.mark.parametrize("plane", PLANES)
def test_planes_are_as_exact_as_where_corners_stay(errors, plane, output):
    moved, corrected = (np.concatenate([*errors(plane, output, corrected=each)]) for each in (False, True))
    assert np.median(moved) > 3 * np.median(corrected)
    assert np.median(corrected) < 2e-5
    assert np.quantile(corrected, 0.999) < 1e-4
