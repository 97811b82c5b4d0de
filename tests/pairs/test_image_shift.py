"""Images lie on their truth: neither antialiasing nor motion blur shifts them."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import SQUARE, on_plane, one_model

from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.frame.frame import Frame
from semisynth_gl.pairs.cameras import expose, moments
from semisynth_gl.render.renderer import Renderer

# Patch of the scene that shifts are measured on: waves, (cycles along u, along v) of red, green and blue.
PATCH_PX = 256
WAVES = ((8, 0), (0, 7), (5, -6))
AMPLITUDE = 100.0
# The square lies on the plane normal . p = distance.
NORMAL = np.array([0.2, -0.15, 1.0])
DISTANCE_M = 2.0
SIDE_M = 8.0
REPEATS = 8.0
CAMERA = StereoCamera(480, 320, 500.0, 0.1, 236.0, 247.0, 158.3)


def drawn(mode, backend, poses=()):
    """Draw a slanted plane with a picture of waves; the image is exposed while the camera takes poses, where given."""
    scene = one_model(CAMERA, [on_plane(NORMAL, DISTANCE_M, SIDE_M / 2)], uv_scale=REPEATS)
    texel = (np.arange(PATCH_PX) + 0.5) / PATCH_PX
    layer = np.full((1, PATCH_PX, PATCH_PX, 4), 255, np.uint8)
    layer[0, ..., :3] = np.rint(waves(*np.meshgrid(texel, texel)))
    with Renderer([SQUARE], layer, wrap="repeat", outputs=(), antialias=mode, backend=backend) as renderer:
        frame = renderer.render(scene)
        images = expose(renderer, [replace(scene, camera_from_world=pose) for pose in poses] or [scene], EYES)
        return Frame.from_arrays(frame.camera, frame.arrays() | images)


def truth_shift_px(frame):
    """Measure the shift between an image and the truth at the same pixel, px, the larger of both eyes'.

    The ray through a pixel's centre meets the plane at the point whose disparity the pixel has, and the colour of that
    point follows from the equation of the waves. Contrast and brightness are free, so a blur that is the same on both
    sides counts as no shift.
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
    """Colours (..., 3) of the shift's picture at patch coordinates."""
    return np.stack([127.5 + AMPLITUDE * np.sin(2 * np.pi * (a * u + b * v)) for a, b in WAVES], axis=-1)


@pytest.mark.parametrize("mode", ["none", "edges", "ssaa2", "ssaa3"])
def test_images_lie_on_their_truth(backend, mode):
    assert truth_shift_px(drawn(mode, backend)) < (0.001 if mode == "none" else 0.01)


@pytest.mark.one_backend
def test_motion_blur_leaves_images_on_their_truth(backend):
    # About 7 px sideways, 3 downwards, and a turn: the shift is that of the middle of the exposure.
    poses = []
    for time in moments(1.0, 7):
        poses.append(np.eye(4))
        poses[-1][:2, :3] = [[1, -0.006 * time, 0], [0.006 * time, 1, 0]]
        poses[-1][:3, 3] = 0.028 * time, 0.012 * time, 0.01 * time
    sharp, blurred, late = (drawn("none", backend, each) for each in ((), poses, poses[1:]))
    assert np.abs(blurred.left.image.astype(float) - sharp.left.image).mean() > 1
    assert truth_shift_px(blurred) < 0.01
    # Half a part of the exposure is found where one is missing.
    assert truth_shift_px(late) == pytest.approx(np.hypot(7, 3) / 14, rel=0.3)
