"""The black borders of rectified photographs, beside dark things that are none."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from semisynth_gl.textures.borders import Rectangle, inside_borders
from semisynth_gl.textures.image_files import builtin_photographs
from semisynth_gl.textures.images import read_image


def bright(height=120, width=160):
    return np.random.default_rng(0).integers(40, 256, (height, width, 3), dtype=np.uint8)


@given(st.integers(0, 25), st.integers(0, 25), st.integers(0, 25), st.integers(0, 25))
def test_straight_borders_are_left_out_and_no_more_than_that_and_what_is_mixed(top, bottom, left, right):
    image = bright()
    image[:top] = image[120 - bottom :] = 0
    image[:, :left] = image[:, 160 - right :] = 0
    mixed = [2 * (side > 0) for side in (left, top, right, bottom)]
    inner = (120 - top - bottom) * (160 - left - right)
    inside = inside_borders(image)
    if inner > 0.5 * 120 * 160:
        x, y = left + mixed[0], top + mixed[1]
        assert inside == Rectangle(x, y, 160 - right - mixed[2] - x, 120 - bottom - mixed[3] - y)
    else:
        assert inside == Rectangle(0, 0, 160, 120)


def test_a_curved_border_leaves_hardly_any_black():
    image = bright(240, 320)
    y, x = np.mgrid[:240, :320]
    across, down = np.abs(x - 159.5) / 160, np.abs(y - 119.5) / 120
    image[(across > 0.9 + 0.1 * down**2) | (down > 0.85 + 0.15 * across**2)] = 0
    left, top, width, height = inside_borders(image)
    part = image[top : top + height, left : left + width]
    assert (part == 0).all(axis=2).mean() < 1e-3
    assert width * height > 0.7 * 240 * 320


def test_a_dark_thing_in_a_corner_or_inside_is_no_border():
    image = bright()
    image[90:, 110:] = 1
    image[40:60, 40:60] = 0
    assert inside_borders(image) == Rectangle(0, 0, 160, 120)


@pytest.mark.parametrize("shape", [(6, 6), (3, 100), (1, 1)])
def test_tiny_and_black_images_stay_whole(shape):
    image = np.zeros((*shape, 3), np.uint8)
    assert inside_borders(image) == Rectangle(0, 0, shape[1], shape[0])
    image[shape[0] // 2 :] = 200
    left, top, width, height = inside_borders(image)
    assert min(width, height) >= 1
    assert left + width <= shape[1]
    assert top + height <= shape[0]


def test_photographs_without_a_border_stay_whole():
    for path in builtin_photographs():
        image = read_image(path)
        assert inside_borders(image) == Rectangle(0, 0, image.shape[1], image.shape[0]), path
