"""Neither antialiasing nor motion blur shifts images against the truth."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import SQUARE, on_plane, one_model

from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.frame.frame import Frame
from semisynth_gl.pairs.cameras import expose, moments
from semisynth_gl.render.renderer import Renderer

# The patch shows a wave in each of red, green and blue; WAVES has their cycles along u and v.
PATCH_PX = 256
WAVES = ((8, 0), (0, 7), (5, -6))
AMPLITUDE = 100.0
# The square is on the plane normal . p = distance.
NORMAL = np.array([0.2, -0.15, 1.0])
DISTANCE_M = 2.0
SIDE_M = 8.0
REPEATS = 8.0
CAMERA = StereoCamera(480, 320, 500.0, 0.1, 236.0, 247.0, 158.3)


def rendered(mode, backend, poses=()):
    """Render a slanted plane with the waves; with ``poses``, the images are exposed over these camera poses."""
    scene = one_model(CAMERA, [on_plane(NORMAL, DISTANCE_M, SIDE_M / 2)], uv_scale=REPEATS)
    texel = (np.arange(PATCH_PX) + 0.5) / PATCH_PX
    layer = np.full((1, PATCH_PX, PATCH_PX, 4), 255, np.uint8)
    layer[0, ..., :3] = np.rint(waves(*np.meshgrid(texel, texel)))
    with Renderer([SQUARE], layer, wrap="repeat", outputs=(), antialias=mode, backend=backend) as renderer:
        frame = renderer.render(scene)
        images = expose(renderer, [replace(scene, camera_from_world=pose) for pose in poses] or [scene], EYES)
        return Frame.from_arrays(frame.camera, frame.arrays() | images)


def truth_shift_px(frame):
    """Measure the shift between image and truth, px; return the larger of both eyes'.

    The expected colour of a pixel is that of the waves where the ray through its centre hits the plane. The fit also
    adapts contrast and brightness, so a symmetric blur is no shift.
    """
    y, x = np.mgrid[: CAMERA.height_px, : CAMERA.width_px].astype(np.float64)

    def expected(eye, right=0.0, down=0.0):
        eye_m = np.array([CAMERA.offset_m(eye), 0, 0])
        rays = CAMERA.rays(eye, x + right, y + down)
        point = eye_m + rays * ((DISTANCE_M - NORMAL @ eye_m) / (rays @ NORMAL))[..., None]
        u, v = ((point[..., axis] / SIDE_M + 0.5) * REPEATS for axis in (0, 1))
        return waves(u, v)

    shifts = []
    for eye in EYES:
        sought = expected(eye)
        along_x = expected(eye, right=0.5) - expected(eye, right=-0.5)
        along_y = expected(eye, down=0.5) - expected(eye, down=-0.5)
        columns = np.stack([sought, np.ones_like(sought), along_x, along_y], axis=-1).reshape(-1, 4)
        image = frame.view(eye).image.astype(np.float64)
        (contrast, _, x_px, y_px), *_ = np.linalg.lstsq(columns, image.ravel(), rcond=None)
        shifts.append(float(np.hypot(x_px, y_px) / contrast))
    return max(shifts)


def waves(u, v):
    """Return the patch's colours (..., 3) at (u, v)."""
    return np.stack([127.5 + AMPLITUDE * np.sin(2 * np.pi * (a * u + b * v)) for a, b in WAVES], axis=-1)


@pytest.mark.parametrize("mode", ["none", "edges", "ssaa2", "ssaa3"])
def test_images_lie_on_their_truth(backend, mode):
    assert truth_shift_px(rendered(mode, backend)) < (0.001 if mode == "none" else 0.01)


@pytest.mark.one_backend
def test_motion_blur_leaves_images_on_their_truth(backend):
    # The camera moves by about 7 px sideways and 3 px down, and rolls; the truth is that of the middle of the exposure.
    poses = []
    for time in moments(1.0, 7):
        poses.append(np.eye(4))
        poses[-1][:2, :3] = [[1, -0.006 * time, 0], [0.006 * time, 1, 0]]
        poses[-1][:3, 3] = 0.028 * time, 0.012 * time, 0.01 * time
    sharp, blurred, late = (rendered("none", backend, each) for each in ((), poses, poses[1:]))
    assert np.abs(blurred.left.image.astype(float) - sharp.left.image).mean() > 1
    assert truth_shift_px(blurred) < 0.01
    # Without one of the seven poses, the exposure's middle shifts by half a step.
    assert truth_shift_px(late) == pytest.approx(np.hypot(7, 3) / 14, rel=0.3)
