"""GPUs move the corners of triangles before they interpolate: truth is the pixel's centre's all the same.

The processor's driver does not, so here the vertex shader moves corners as NVIDIA's driver does. With corners moved and
not corrected, other tests fail here as on an H200, most with the same figures.
"""

from dataclasses import replace

import numpy as np
import pytest
from scenes import assert_equal, noise_layers, on_plane, one_model

from semisynth_gl.frame.camera import EYES, Deviation, StereoCamera
from semisynth_gl.render import programs
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.renderer import Renderer

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
def draw(backend, square, monkeypatch):
    """Draw squares on planes through a driver that moves corners, corrected or not."""
    original = programs.shader_source

    def source(name, defines=None):
        text = original(name, defines)
        return text.rstrip().removesuffix("}") + MOVE if name == "mesh.vert" else text

    monkeypatch.setattr(programs, "shader_source", source)

    def drawn(pose, camera=CAMERA, *, corrected=True, shared=False):
        monkeypatch.setattr(GraphicsContext, "corner_steps", STEPS if corrected else None)
        scene = one_model(camera, [pose])
        rectified = camera.rectified
        with Renderer(
            [square], noise_layers(1, 16), backend=backend, outputs=("depth",), rectified=rectified
        ) as renderer:
            if not shared:
                return renderer.render(scene)
            return renderer.render_rig(scene, [camera, replace(camera, baseline_m=camera.baseline_m / 2)])[0]

    return drawn


def on(plane):
    return on_plane((*plane[:2], 1), 2.0, plane[2])


def errors(frame, plane, output):
    """Errors of a plane's disparity or depth, in px of disparity."""
    normal, camera = plane[:2], frame.camera
    y, x = np.mgrid[:480, :640].astype(float)
    found = []
    for eye in EYES:
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = (2.0 - normal[0] * camera.offset_m(eye)) / (camera.rays(eye, x, y) @ (*normal, 1))
            known = np.isfinite(frame.view(eye)[output]) & (depth > 0.3) & (depth < 7)
            expected = {"disparity": camera.disparity_px(depth), "depth": depth}[output]
        assert known.mean() > 0.2
        scale = 1 if output == "disparity" else camera.focal_baseline / depth[known] ** 2
        found.append(np.abs(frame.view(eye)[output][known] - expected[known]) * scale)
    return np.concatenate(found)


@pytest.mark.parametrize("output", ["disparity", "depth"])
@pytest.mark.parametrize("plane", PLANES)
def test_planes_are_as_exact_as_where_corners_stay(draw, plane, output):
    moved, corrected = (errors(draw(on(plane), corrected=each), plane, output) for each in (False, True))
    assert np.median(moved) > 3 * np.median(corrected)
    assert np.median(corrected) < 2e-5
    assert np.quantile(corrected, 0.999) < 1e-4


@pytest.mark.parametrize("plane", PLANES)
def test_a_deviating_cameras_depth_is_as_exact(draw, plane):
    camera = replace(CAMERA, deviation=Deviation(0.01, -0.01, 3.0, 1.1))
    moved, corrected = (errors(draw(on(plane), camera, corrected=each), plane, "depth") for each in (False, True))
    assert np.median(moved) > 3 * np.median(corrected)
    assert np.quantile(corrected, 0.999) < 1e-4


def test_a_shared_left_view_is_the_pairs(draw):
    alone, shared = draw(on(PLANES[1])), draw(on(PLANES[1]), shared=True)
    assert_equal(shared, alone)


@pytest.mark.parametrize("horizon_px", [230.9985, 230.9995, 231.0, 231.0005, 231.0015])
def test_nothing_lies_beyond_the_horizon(draw, horizon_px):
    ground = np.eye(4)
    ground[:3] = [[2e8, 0, 0, -1e8], [0, 0, 1, 1.5], [0, 1e8, 0, 0.5]]
    # The horizon passes a pixel's centre by less than corners move.
    frame = draw(ground, replace(CAMERA, cy_px=horizon_px))
    for eye in EYES:
        depth = frame.view(eye).depth
        assert np.isfinite(depth).any()
        assert (depth > 0).all()
