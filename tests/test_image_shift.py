"""Images lie on their truth: no antialiasing mode shifts them."""

import numpy as np
import pytest

from semisynth_gl.bench.antialias import MODES
from semisynth_gl.camera import EYES, StereoCamera
from semisynth_gl.errors import BackendError
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.background import FACE
from semisynth_gl.scene.scene import make_scene

# Patch of the scene that shifts are measured on: waves, (cycles along u, along v) of red, green and blue.
PATCH_PX = 256
WAVES = ((8, 0), (0, 7), (5, -6))
AMPLITUDE = 100.0
# A square whose u and v run along x and y lies on the plane normal . p = distance.
NORMAL = np.array([0.2, -0.15, 1.0])
DISTANCE_M = 2.0
SIDE_M = 8.0
REPEATS = 8.0


def shift_px(image, expected, along_x, along_y):
    """Least-squares shift of an image to the right and downwards, px.

    Contrast and brightness are free, so a blur that is the same on both sides counts as none.
    """
    columns = np.stack([expected, np.ones_like(expected), along_x, along_y], axis=-1)
    (contrast, _, x, y), *_ = np.linalg.lstsq(columns, image, rcond=None)
    return float(-x / contrast), float(-y / contrast)


def truth_shift_px(mode, backend):
    """Measure the shift between an image and the truth at the same pixel, px, the larger of both eyes'.

    A slanted plane with a picture of waves is drawn. The ray through a pixel's centre meets the plane at the point
    whose disparity the pixel has, and the colour of that point follows from the equation of the waves.
    """
    camera = StereoCamera(480, 320, 500.0, 0.1, 236.0, 247.0, 158.3)
    corner = np.array([-SIDE_M / 2, -SIDE_M / 2])
    matrix = np.eye(4)
    for column, edge in enumerate(np.eye(2) * SIDE_M):
        matrix[:3, column] = *edge, -(NORMAL[:2] @ edge) / NORMAL[2]
    matrix[:3, 3] = *corner, (DISTANCE_M - NORMAL[:2] @ corner) / NORMAL[2]
    scene = make_scene(camera, model=[0], world_from_model=[matrix], layer=[0], uv_scale=REPEATS)
    texel = (np.arange(PATCH_PX) + 0.5) / PATCH_PX
    layer = np.full((1, PATCH_PX, PATCH_PX, 4), 255, np.uint8)
    layer[0, ..., :3] = np.rint(waves(*np.meshgrid(texel, texel)))
    with Renderer([FACE], layer, wrap="repeat", outputs=(), antialias=mode, backend=backend) as renderer:
        frame = renderer.render(scene)

    def expected(eye, x, y):
        eye_m = np.array([camera.offset_m(eye), 0, 0])
        rays = camera.rays(eye, x, y)
        point = eye_m + rays * ((DISTANCE_M - NORMAL @ eye_m) / (rays @ NORMAL))[..., None]
        u, v = ((point[..., axis] - corner[axis]) / SIDE_M * REPEATS for axis in (0, 1))
        return waves(u, v)

    y, x = np.mgrid[: camera.height_px, : camera.width_px].astype(np.float64)
    largest = 0.0
    for eye, image in zip(EYES, (frame.left.image, frame.right.image), strict=True):
        shift = shift_px(
            image.astype(np.float64).ravel(),
            expected(eye, x, y).ravel(),
            (expected(eye, x + 0.5, y) - expected(eye, x - 0.5, y)).ravel(),
            (expected(eye, x, y + 0.5) - expected(eye, x, y - 0.5)).ravel(),
        )
        largest = max(largest, float(np.hypot(*shift)))
    return largest


def waves(u, v):
    """Colours (..., 3) of the shift's picture at patch coordinates."""
    return np.stack([127.5 + AMPLITUDE * np.sin(2 * np.pi * (a * u + b * v)) for a, b in WAVES], axis=-1)


def test_the_shift_of_a_shifted_image():
    y, x = np.mgrid[:60, :80].astype(float)

    def image(x, y):
        return 90 + 50 * np.sin(x / 5) * np.cos(y / 7 + x / 40)

    expected = image(x, y)
    gradients = [(image(x + dx, y + dy) - image(x - dx, y - dy)).ravel() for dx, dy in ((0.5, 0), (0, 0.5))]
    moved = 0.9 * image(x - 0.03, y + 0.02) + 4
    assert shift_px(moved.ravel(), expected.ravel(), *gradients) == pytest.approx((0.03, -0.02), abs=1e-3)


@pytest.mark.parametrize("mode", MODES)
def test_images_lie_on_their_truth(backend, mode):
    try:
        shift = truth_shift_px(mode, backend)
    except BackendError as error:
        pytest.skip(str(error))
    assert shift < (0.001 if mode == "none" else 0.01)
